// The device front over real Modbus links: opening, session, laser, button; what it refuses, what it says, in device
// time.

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <map>
#include <string>

#include "tests/firmware_bridge/scanner_rig.h"

namespace celadon::test {
namespace {

using Rig = ScannerRig;

class OpenOnBothLinks : public OnALink {};
INSTANTIATE_ON_BOTH_LINKS(OpenOnBothLinks);

// ---- open ----

TEST_P(OpenOnBothLinks, OpensWithIdentityAndCapabilities) {
  s.open();
  EXPECT_EQ(s.device->identity().machine, "Celadon test table 0001");
  EXPECT_EQ(s.device->identity().protocol_major, 1);
  EXPECT_EQ(s.device->identity().firmware_version, 7);
  EXPECT_TRUE(s.device->identity().simulated);
  const DeviceCapabilities& c = s.device->capabilities();
  EXPECT_EQ(c.axes, 1);
  EXPECT_EQ(c.lasers, 2);
  EXPECT_TRUE(c.endless_rotation);
  EXPECT_EQ(c.laser_class, 2);
  EXPECT_EQ(c.lease_ms, 500);
  EXPECT_EQ(c.heartbeat_timeout_ms, 1000);
  EXPECT_NEAR(c.max_speed_rad_per_s, 180 * kDeg, 1e-12);
  EXPECT_NEAR(c.max_acceleration_rad_per_s2, 90 * kDeg, 1e-12);
  EXPECT_NEAR(c.encoder_resolution_rad, 0.001 * kDeg, 1e-15);
  EXPECT_EQ(s.device->found_at_open().motion_was, MotionState::unhomed);
  EXPECT_TRUE(s.device->found_at_open().lasers_off);
  EXPECT_TRUE(s.device->found_at_open().motor_stopped);
}

TEST(Open, MakesARunningMachineSafeAndSaysWhatItFound) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(720 * kDeg, 36 * kDeg));
  ASSERT_TRUE(s.device->renew_laser(1, 500));
  // Another owner comes while it turns: the first was killed without a word.
  auto second = s.try_open();
  ASSERT_TRUE(second) << second.error().message();
  const SafeReport& found = (*second)->found_at_open();
  EXPECT_EQ(found.lasers_were_on, 2);
  EXPECT_EQ(found.motion_was, MotionState::moving);
  EXPECT_TRUE(found.lasers_off);
  EXPECT_TRUE(found.motor_stopped);
  EXPECT_NE(found.text.find("found it active"), std::string::npos) << found.text;
  s.machine.with([&](TestPlant& p, ControllerCore& core) {
    EXPECT_EQ(p.lasers, 0);
    EXPECT_EQ(core.motion(0), MotionState::standstill);
  });
}

TEST(Open, AnotherProtocolVersionIsNamedAndLeftAlone) {
  ControllerConfig config = test_config();
  config.protocol_major = 2;
  config.protocol_minor = 3;
  Rig s(Link::tcp, config);
  const auto opened = s.try_open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().kind, Kind::wrong_protocol);
  EXPECT_NE(opened.error().cause.find("2.3"), std::string::npos) << opened.error().cause;
  EXPECT_NE(opened.error().cause.find("1.3"), std::string::npos) << opened.error().cause;
  EXPECT_EQ(s.machine.writes, 0);
}

TEST(Open, LaterMinorVersionIsWelcome) {
  ControllerConfig config = test_config();
  config.protocol_minor = 9;
  Rig s(Link::tcp, config);
  s.open();
  EXPECT_EQ(s.device->identity().protocol_minor, 9);
}

TEST(Open, DangerousLaserClassIsRefused) {
  for (const std::uint16_t laser_class : std::initializer_list<std::uint16_t>{0, 4, 5}) {
    ControllerConfig config = test_config();
    config.laser_class = laser_class;
    Rig s(Link::tcp, config);
    const auto opened = s.try_open();
    ASSERT_FALSE(opened) << laser_class;
    EXPECT_EQ(opened.error().kind, Kind::refused);
    EXPECT_NE(opened.error().cause.find("laser class"), std::string::npos);
  }
  ControllerConfig config = test_config();
  config.laser_class = protocol::kClass3R;
  Rig s(Link::tcp, config);
  s.open();
}

TEST(Open, WrongUnitSaysSo) {
  Rig s(Link::rtu);
  const auto opened = s.try_open("unit=5&timeout_ms=40");
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().kind, Kind::timed_out);
  EXPECT_NE(opened.error().remedy.find("unit"), std::string::npos);
  EXPECT_NE(opened.error().left.find("unknown"), std::string::npos);
}

TEST(Open, ALaserThatCannotBeTurnedOffRefusesToOpen) {
  Rig s;
  s.machine.with([](TestPlant& p, ControllerCore&) { p.stuck_lasers = 1; });
  const auto opened = s.try_open();
  ASSERT_FALSE(opened);
  EXPECT_NE(opened.error().message().find("NOT SAFE"), std::string::npos) << opened.error().message();
}

// ---- session ----

TEST(Session, ASecondClientCannotCommandWhileTheFirstPolls) {
  Rig s;
  s.open();
  s.home();
  const auto try_all = [&](protocol::Exception expected) {
    const std::uint16_t lease = 100;
    const std::uint16_t home[] = {0, 0, 0, 0, 0, 0, 0, 0, 0, protocol::kHome};
    EXPECT_EQ(s.machine.write(protocol::reg::control::laser_lease.address(), 1, &lease), expected);
    EXPECT_EQ(s.machine.write(protocol::groups::axis_command.base, 10, home), expected);
  };
  for (int k = 0; k < 300; ++k) {  // longer than a session lasts without its token
    ASSERT_TRUE(s.device->poll());
    s.machine.advance_ms(20);
  }
  try_all(protocol::Exception::refused);
  ASSERT_TRUE(s.device->renew_laser(1, 200));
  ASSERT_TRUE(s.device->rotate_to(5 * kDeg, 90 * kDeg));
  s.device.reset();  // lets go
  try_all(protocol::Exception::none);
}

TEST(Session, AKilledHostsMachineIsMadeSafeAtOnceAndTakenWhenItsSessionIsOver) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(720 * kDeg, 36 * kDeg));
  ASSERT_TRUE(s.device->renew_laser(0, 500));
  const std::uint64_t killed_us = s.machine.now_us();
  auto second = s.try_open();
  ASSERT_TRUE(second) << second.error().message();
  const std::uint64_t dark_us = s.machine.with([](TestPlant& p, ControllerCore&) { return p.laser_log.back().first; });
  EXPECT_LE(dark_us - killed_us, 50'000u);
  EXPECT_LE(s.machine.now_us() - killed_us, 3'300'000u);
  const auto late = s.device->renew_laser(0, 100);  // the first one was not dead after all
  ASSERT_FALSE(late);
  EXPECT_EQ(late.error().kind, Kind::refused);
  EXPECT_NE(late.error().cause.find("another host holds"), std::string::npos) << late.error().cause;
}

TEST(Session, AControllerWithoutSessionsIsCommandedWithoutToken) {
  ControllerConfig config = test_config();
  config.protocol_minor = 0;
  config.session_timeout_ms = 0;
  Rig s(Link::tcp, config);
  s.open();
  s.home();
  EXPECT_TRUE(s.device->renew_laser(1, 200));
  EXPECT_FALSE(s.machine.with([](TestPlant&, ControllerCore& core) {
    std::uint16_t flags = 0;
    (void)core.read_input(0, protocol::reg::status::flags.address(), 1, &flags);
    return (flags & protocol::kSessionHeld) != 0;
  }));
}

TEST(Session, IsTakenAgainFromAControllerThatRestarted) {
  Rig s;
  s.open();
  s.machine.restart();
  EXPECT_FALSE(s.device->poll());  // told once
  ASSERT_TRUE(s.device->poll());
  s.home();
  const std::uint16_t lease = 100;
  EXPECT_EQ(s.machine.write(protocol::reg::control::laser_lease.address(), 1, &lease), protocol::Exception::refused);
}

// ---- every call in every state ----

enum class State { unhomed, homing, standstill, moving, stopped, fault, interlock_open, emergency_stop, locked };

void bring(Rig& s, State state) {
  const auto with = [&](auto f) { s.machine.with(f); };
  s.open();
  if (state == State::unhomed) return;
  if (state == State::homing) {
    // Another client's command: the call of this one would wait for the end.
    const std::uint16_t words[] = {0, 0, 0, 0, 0, 0, 0, 0, 0, protocol::kHome};
    ASSERT_EQ(s.machine.write(protocol::groups::axis_command.base, 10, words), protocol::Exception::none);
    return;
  }
  s.home();
  if (state == State::moving) {
    ASSERT_TRUE(s.device->start_sweep(3000 * kDeg, 30 * kDeg));
  }
  if (state == State::stopped) {
    ASSERT_TRUE(s.device->start_sweep(3000 * kDeg, 30 * kDeg));
    s.machine.advance_ms(4000);  // the host is silent
  }
  if (state == State::fault) with([](TestPlant& p, ControllerCore&) { p.axis_fault = FaultCode::motor_stalled; });
  if (state == State::fault) with([](TestPlant& p, ControllerCore&) { p.axis_fault = FaultCode::none; });
  if (state == State::interlock_open || state == State::locked)
    with([](TestPlant& p, ControllerCore&) { p.interlock_closed = false; });
  if (state == State::locked) with([](TestPlant& p, ControllerCore&) { p.interlock_closed = true; });
  if (state == State::emergency_stop) with([](TestPlant& p, ControllerCore&) { p.emergency_stop = true; });
}

struct Call {
  const char* name;
  std::function<tl::expected<void, DeviceError>(ScannerDevice&)> run;
};

const Call kCalls[] = {
    {"home", [](ScannerDevice& d) { return d.home(); }},
    {"rotate", [](ScannerDevice& d) { return d.rotate_to(5 * kDeg, 10 * kDeg).map([](const DeviceStatus&) {}); }},
    {"sweep", [](ScannerDevice& d) { return d.start_sweep(5 * kDeg, 10 * kDeg); }},
    {"laser", [](ScannerDevice& d) { return d.renew_laser(0, 100); }},
    {"laser off", [](ScannerDevice& d) { return d.laser_off(); }},
    {"stop", [](ScannerDevice& d) { return d.stop(); }},
    {"lamp", [](ScannerDevice& d) { return d.set_lamp(LampPattern::busy); }},
};

// 0: done; otherwise the kind of the refusal.
constexpr int kOk = -1;
int k(Kind kind) {
  return static_cast<int>(kind);
}

TEST(EveryCallInEveryState, IsDoneOrRefusedBeforeItReachesTheController) {
  const int wrong = k(Kind::wrong_state), fault = k(Kind::fault), locked = k(Kind::interlock);
  const std::map<State, std::vector<int>> table = {
      //                       home    rotate  sweep   laser   off  stop lamp
      {State::unhomed, {kOk, wrong, wrong, kOk, kOk, kOk, kOk}},
      {State::homing, {wrong, wrong, wrong, kOk, kOk, kOk, kOk}},
      {State::standstill, {kOk, kOk, kOk, kOk, kOk, kOk, kOk}},
      {State::moving, {wrong, wrong, wrong, kOk, kOk, kOk, kOk}},
      {State::stopped, {kOk, wrong, wrong, wrong, kOk, kOk, kOk}},
      {State::fault, {fault, fault, fault, fault, kOk, kOk, kOk}},
      {State::interlock_open, {locked, locked, locked, locked, kOk, kOk, kOk}},
      {State::emergency_stop, {locked, locked, locked, locked, kOk, kOk, kOk}},
      {State::locked, {locked, locked, locked, locked, kOk, kOk, kOk}},
  };
  for (const auto& [state, expected] : table) {
    for (std::size_t i = 0; i < std::size(kCalls); ++i) {
      SCOPED_TRACE(std::string(kCalls[i].name) + " in state " + std::to_string(static_cast<int>(state)));
      ControllerConfig config = test_config();
      if (state == State::homing) config.session_timeout_ms = 0;  // another client commands it
      Rig s(Link::tcp, config);
      bring(s, state);
      ASSERT_TRUE(s.device->poll());
      const int writes = s.machine.writes;
      const auto result = kCalls[i].run(*s.device);
      if (expected[i] == kOk) {
        EXPECT_TRUE(result) << result.error().message();
        EXPECT_GT(s.machine.writes, writes);
      } else {
        ASSERT_FALSE(result);
        EXPECT_EQ(static_cast<int>(result.error().kind), expected[i]) << result.error().message();
        EXPECT_EQ(s.machine.writes, writes) << "it reached the controller";
        EXPECT_NE(result.error().left, "");
        EXPECT_NE(result.error().remedy + result.error().cause, "");
      }
    }
  }
}

// ---- laser ----

TEST(Laser, LeaseRunsOutInDeviceTimeWhenTheClientVanishes) {
  Rig s;
  s.open();
  ASSERT_TRUE(s.device->renew_laser(0, 500));
  const std::uint64_t granted_us =
      s.machine.with([](TestPlant& p, ControllerCore&) { return p.laser_log.back().first; });
  s.server.stop();  // the client is gone: no write, no read reaches the controller any more
  s.machine.advance_ms(10'000);
  s.machine.with([&](TestPlant& p, ControllerCore&) {
    EXPECT_EQ(p.lasers, 0);
    EXPECT_EQ(p.laser_log.back().second, 0);
    EXPECT_EQ(p.laser_log.back().first - granted_us, 500'000u);
  });
}

// The replies are lost, the requests are not: repeating them must not keep the laser on.
TEST(Laser, ALeaseRepeatedOnABadLinkEndsWhenTheFirstWouldHave) {
  Rig s;
  s.open("timeout_ms=60");
  const std::uint64_t called_us = s.machine.now_us();
  s.server.mishap(Mishap::drop, 3);
  EXPECT_FALSE(s.device->renew_laser(0, 500));
  s.machine.advance_ms(1000);
  s.machine.with([&](TestPlant& p, ControllerCore&) {
    ASSERT_GE(p.laser_log.size(), 2u);
    EXPECT_EQ(p.laser_log.back().second, 0);
    EXPECT_LE(p.laser_log.back().first - called_us, 502'000u);  // with the bus time of the first request
    EXPECT_GT(p.laser_log.back().first - called_us, 490'000u);
  });
}

TEST(Laser, IsRenewedByTheLoopAndEndedByCommand) {
  Rig s;
  s.open();
  for (int i = 0; i < 20; ++i) {
    ASSERT_TRUE(s.device->renew_laser(0, 200));
    s.machine.advance_ms(150);
    const auto status = s.device->poll();
    ASSERT_TRUE(status);
    EXPECT_EQ(status->lasers_on, 1);
    EXPECT_LE(status->lease_left_ms, 50u);
  }
  EXPECT_TRUE(s.device->laser_off());
  EXPECT_EQ(s.device->poll()->lasers_on, 0);
  EXPECT_EQ(s.device->renew_laser(2, 100).error().kind, Kind::refused);
  EXPECT_EQ(s.device->renew_laser(-1, 100).error().kind, Kind::refused);
  EXPECT_EQ(s.device->renew_laser(0, 501).error().kind, Kind::refused);
  EXPECT_EQ(s.device->renew_laser(0, 0).error().kind, Kind::refused);
}

TEST(Laser, ThatStaysOnIsTold) {
  Rig s;
  s.open();
  ASSERT_TRUE(s.device->renew_laser(0, 200));
  s.machine.with([](TestPlant& p, ControllerCore&) { p.stuck_lasers = 1; });
  const auto off = s.device->laser_off();
  ASSERT_FALSE(off);
  EXPECT_NE(off.error().remedy.find("cut the power"), std::string::npos);
  EXPECT_NE(off.error().left.find("a laser on"), std::string::npos) << off.error().left;
  EXPECT_EQ(s.device->poll()->fault_code, static_cast<std::uint16_t>(FaultCode::laser_stuck_on));
}

TEST(Laser, GrantOnAnOutdatedPollIsJudgedByTheController) {
  Rig s;
  s.open();
  ASSERT_TRUE(s.device->poll());
  s.machine.with([](TestPlant& p, ControllerCore&) { p.interlock_closed = false; });
  const auto granted = s.device->renew_laser(0, 100);
  ASSERT_FALSE(granted);
  EXPECT_EQ(granted.error().kind, Kind::interlock);
  EXPECT_NE(granted.error().cause.find("interlock is open"), std::string::npos) << granted.error().cause;
  // And the other way round: closed and pressed since the last poll.
  s.machine.with([](TestPlant& p, ControllerCore&) { p.interlock_closed = true; });
  s.machine.press_button();
  EXPECT_TRUE(s.device->renew_laser(0, 100));
}

// ---- interlock, heartbeat ----

TEST(Interlock, OpeningInASweepEndsLightAndMotionForGood) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(360 * kDeg, 36 * kDeg));
  ASSERT_TRUE(s.device->renew_laser(0, 500));
  s.machine.with([](TestPlant& p, ControllerCore&) { p.interlock_closed = false; });
  s.machine.with([](TestPlant& p, ControllerCore&) { p.interlock_closed = true; });
  for (int i = 0; i < 100; ++i) {
    s.machine.advance_ms(50);
    const auto status = s.device->poll();
    ASSERT_TRUE(status);
    ASSERT_EQ(status->lasers_on, 0);
    ASSERT_EQ(status->motion, MotionState::stopped);
    ASSERT_TRUE(status->local_action_needed);
    ASSERT_EQ(status->lamp, LampPattern::attention);
  }
  s.machine.press_button();
  const auto status = s.device->poll();
  EXPECT_EQ(status->motion, MotionState::standstill);
  EXPECT_EQ(status->lasers_on, 0);
  EXPECT_EQ(s.device->take_button_presses(), 1);
  EXPECT_TRUE(s.device->rotate_to(0, 36 * kDeg));
}

TEST(Heartbeat, SilenceInAMoveStopsTheMotorAndIsNamedAfterwards) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(3600 * kDeg, 36 * kDeg));
  ASSERT_TRUE(s.device->poll());
  const std::uint64_t last_us = s.machine.now_us();
  s.machine.advance_to_us(last_us + 999'000);
  s.machine.with([](TestPlant&, ControllerCore& core) { EXPECT_EQ(core.motion(0), MotionState::moving); });
  s.machine.advance_to_us(last_us + 1'000'000);
  s.machine.with([](TestPlant&, ControllerCore& core) { EXPECT_EQ(core.motion(0), MotionState::stopped); });
  s.machine.advance_ms(500);  // 36 degrees/s at 90 degrees/s2 takes 400 ms, settling 50
  s.machine.with([&](TestPlant& p, ControllerCore&) { EXPECT_EQ(p.speed_udeg(last_us + 1'400'000), 0); });
  const auto status = s.device->poll();
  EXPECT_EQ(status->fault_code, static_cast<std::uint16_t>(FaultCode::heartbeat_lost));
  EXPECT_NE(status->fault_text.find("silent"), std::string::npos);
  EXPECT_FALSE(s.device->rotate_to(0, 1));
  EXPECT_TRUE(s.device->clear_fault());
  EXPECT_TRUE(s.device->rotate_to(0, 1));
}

// ---- button ----

TEST(Button, NoPressIsLostOrDoubledAcrossPollsAndReconnects) {
  Rig s;
  s.machine.press_button();  // before the device is opened: nobody asked for anything then
  s.open("timeout_ms=500");
  EXPECT_EQ(s.device->take_button_presses(), 0);
  for (int i = 0; i < 3; ++i) s.machine.press_button(30);
  ASSERT_TRUE(s.device->poll());
  ASSERT_TRUE(s.device->poll());
  EXPECT_EQ(s.device->take_button_presses(), 3);
  EXPECT_EQ(s.device->take_button_presses(), 0);

  s.server.stop();
  s.machine.press_button();
  EXPECT_FALSE(s.device->poll());
  s.machine.press_button();
  s.server.start();
  ASSERT_TRUE(s.device->poll());
  EXPECT_EQ(s.device->take_button_presses(), 2);

  s.machine.press_button();
  s.server.mishap(Mishap::close_link);  // this reply, with the press in it, is lost
  ASSERT_TRUE(s.device->poll());
  EXPECT_EQ(s.device->take_button_presses(), 1);

  s.machine.restart();
  s.machine.press_button();
  EXPECT_FALSE(s.device->poll());  // tells the restart
  ASSERT_TRUE(s.device->poll());
  EXPECT_EQ(s.device->take_button_presses(), 1);
}

TEST(Button, CounterWrapsWithoutLoss) {
  ControllerConfig config = test_config();
  config.debounce_ms = 0;
  Rig s(Link::tcp, config);
  // 65530 presses before open(), ten after.
  const auto press = [&](int times) {
    s.machine.with([times](TestPlant& p, ControllerCore& core) {
      for (int i = 0; i < times; ++i) {
        p.button = true;
        core.step(0);
        p.button = false;
        core.step(0);
      }
    });
  };
  press(65530);
  s.open();
  press(10);
  const auto status = s.device->poll();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->button_presses, 4);
  EXPECT_EQ(s.device->take_button_presses(), 10);
}

TEST(Lamp, ShowsWhatTheHostWants) {
  Rig s;
  s.open();
  for (const LampPattern pattern : {LampPattern::ready, LampPattern::busy, LampPattern::done, LampPattern::warning}) {
    ASSERT_TRUE(s.device->set_lamp(pattern));
    EXPECT_EQ(s.device->poll()->lamp, pattern);
  }
}

}  // namespace
}  // namespace celadon::test
