// The device front over real Modbus links: what it does, what it refuses, what it says, in device time.

#include "firmware_bridge/scanner_device.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <map>
#include <numbers>

#include "tests/firmware_bridge/modbus_machine.h"

namespace celadon::test {
namespace {

using Kind = DeviceError::Kind;
using Link = ModbusServer::Link;
constexpr double kDeg = std::numbers::pi / 180;

struct Rig {
  explicit Rig(Link link = Link::tcp, const ControllerConfig& config = test_config())
      : machine(config), server(machine, link), clock(machine) {}

  tl::expected<std::unique_ptr<ScannerDevice>, DeviceError> try_open(const std::string& options = "timeout_ms=2000") {
    auto transport = open_transport(server.url(options));
    if (!transport) return tl::unexpected(transport.error());
    return ScannerDevice::open(std::move(*transport), clock);
  }
  void open(const std::string& options = "timeout_ms=2000") {
    auto opened = try_open(options);
    ASSERT_TRUE(opened) << opened.error().message();
    device = std::move(*opened);
  }
  void home() {
    const auto homed = device->home();
    ASSERT_TRUE(homed) << homed.error().message();
  }

  Machine machine;
  ModbusServer server;
  MachineClock clock;
  std::unique_ptr<ScannerDevice> device;
};

class OnBothLinks : public testing::TestWithParam<Link> {
 protected:
  Rig s{GetParam()};
};

INSTANTIATE_TEST_SUITE_P(Modbus, OnBothLinks, testing::Values(Link::tcp, Link::rtu),
                         [](const auto& p) { return p.param == Link::tcp ? "Tcp" : "Rtu"; });

// ---- open ----

TEST_P(OnBothLinks, OpensWithIdentityAndCapabilities) {
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
  EXPECT_NE(opened.error().cause.find("1.2"), std::string::npos) << opened.error().cause;
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

// ---- motion ----

TEST_P(OnBothLinks, HomesRotatesAndSweeps) {
  s.open();
  s.home();
  auto at = s.device->rotate_to(90 * kDeg, 90 * kDeg);
  ASSERT_TRUE(at) << at.error().message();
  EXPECT_NEAR(at->angle_rad, 90 * kDeg, 1e-9);
  EXPECT_EQ(at->motion, MotionState::standstill);
  EXPECT_TRUE(at->homed);
  EXPECT_TRUE(s.device->rotate_to(-450 * kDeg, 180 * kDeg));
  EXPECT_NEAR(s.device->poll()->angle_rad, -450 * kDeg, 1e-9);

  // A sweep's samples lie on the closed form: 36 degrees/s after 0.4 s of ramp at 90 degrees/s2.
  ASSERT_TRUE(s.device->start_sweep(0, 36 * kDeg));
  auto status = s.device->poll();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->motion, MotionState::moving);
  EXPECT_NEAR(status->target_rad, 0, 1e-9);
  s.machine.advance_ms(600);
  const auto first = s.device->poll(), second = s.device->poll();
  ASSERT_TRUE(first && second);
  EXPECT_GT(second->position_time_us, first->position_time_us);
  EXPECT_GT(second->position_counter, first->position_counter);
  EXPECT_NEAR(second->angle_rad - first->angle_rad,
              36 * kDeg * static_cast<double>(second->position_time_us - first->position_time_us) * 1e-6, 1e-8);
  EXPECT_NEAR(first->speed_rad_per_s, 36 * kDeg, 1e-8);
  EXPECT_LE(first->host_before_ns, first->host_after_ns);
  EXPECT_TRUE(s.device->stop());
  EXPECT_EQ(s.device->poll()->motion, MotionState::standstill);
}

TEST(Motion, WaitsOnlyOnTheClockAndNotLongerThanTheMove) {
  Rig s;
  s.open();
  s.home();
  const std::uint64_t start_us = s.machine.now_us();
  ASSERT_TRUE(s.device->rotate_to(180 * kDeg, 90 * kDeg));
  // 3 s of trapezoid and 50 ms of settling, seen by the next poll 20 ms later at most (and a few requests).
  const double took_s = static_cast<double>(s.machine.now_us() - start_us) * 1e-6;
  EXPECT_GE(took_s, 3.05);
  EXPECT_LE(took_s, 3.05 + 0.03);
}

TEST(Motion, ImpossibleMovesAreRefusedHere) {
  Rig s;
  s.open();
  s.home();
  const int writes = s.machine.writes;
  for (const double speed : {0.0, -1.0, 181 * kDeg, std::nan(""), HUGE_VAL})
    EXPECT_EQ(s.device->rotate_to(1, speed).error().kind, Kind::refused) << speed;
  for (const double angle : {std::nan(""), HUGE_VAL, 1e12})
    EXPECT_EQ(s.device->start_sweep(angle, 1).error().kind, Kind::refused) << angle;
  EXPECT_EQ(s.machine.writes, writes);
}

TEST(Motion, ATableThatStandsElsewhereIsAFault) {
  Rig s;
  s.open();
  s.home();
  s.machine.with([](TestPlant& p, ControllerCore&) { p.slip_udeg = 190'000; });
  const auto moved = s.device->rotate_to(30 * kDeg, 90 * kDeg);
  ASSERT_FALSE(moved);
  EXPECT_EQ(moved.error().kind, Kind::fault);
  EXPECT_NE(moved.error().cause.find("0.190 deg away"), std::string::npos) << moved.error().cause;
}

TEST(Motion, APositionThatJumpsIsToldOnceAndHomedAgain) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->poll()->homed);
  s.machine.with([](TestPlant& p, ControllerCore&) { p.slip_udeg = 5'000'000; });
  const auto told = s.device->poll();
  ASSERT_FALSE(told);
  EXPECT_EQ(told.error().kind, Kind::fault);
  EXPECT_NE(told.error().cause.find("jumped by 5.000 deg"), std::string::npos) << told.error().cause;
  const auto later = s.device->poll();
  ASSERT_TRUE(later) << later.error().message();
  EXPECT_FALSE(later->homed);
  s.home();
  EXPECT_TRUE(s.device->poll()->homed);
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

TEST(Motion, HomingFailureNamesTheFaultAndTheWayOut) {
  Rig s;
  s.open();
  s.machine.with([](TestPlant& p, ControllerCore&) { p.index_exists = false; });
  const auto homed = s.device->home();
  ASSERT_FALSE(homed);
  EXPECT_EQ(homed.error().kind, Kind::fault);
  EXPECT_NE(homed.error().cause.find("homing_failed (code 18): the index was not found"), std::string::npos);
  EXPECT_EQ(s.device->poll()->fault_text, "the index was not found");
  EXPECT_EQ(s.device->home().error().kind, Kind::fault);
  s.machine.with([](TestPlant& p, ControllerCore&) { p.index_exists = true; });
  ASSERT_TRUE(s.device->clear_fault());
  EXPECT_TRUE(s.device->home());
}

TEST(Motion, AMoveThatDoesNotEndMeetsItsDeadlineAndIsStopped) {
  Rig s;
  s.open();
  s.home();
  s.machine.with([](TestPlant& p, ControllerCore&) { p.drag = 100; });
  const std::uint64_t start_us = s.machine.now_us();
  const auto moved = s.device->rotate_to(90 * kDeg, 90 * kDeg);
  ASSERT_FALSE(moved);
  EXPECT_EQ(moved.error().kind, Kind::timed_out);
  EXPECT_NE(moved.error().left.find("motor standing"), std::string::npos) << moved.error().message();
  EXPECT_LT(s.machine.now_us() - start_us, 20'000'000u);
  EXPECT_EQ(s.device->poll()->motion, MotionState::standstill);
}

TEST(Motion, AnInterruptionStopsHomingAndRotation) {
  Rig s;
  s.open();
  int polls = 0;
  s.device->set_interrupt([&] { return ++polls == 5 ? std::optional<std::string>("enough") : std::nullopt; });
  const auto homed = s.device->home();
  ASSERT_FALSE(homed);
  EXPECT_EQ(homed.error().kind, Kind::interrupted);
  EXPECT_EQ(s.device->poll()->motion, MotionState::unhomed);
  s.home();  // the wish is asked for anew each time
  polls = 0;
  const auto moved = s.device->rotate_to(90 * kDeg, 10 * kDeg);
  ASSERT_FALSE(moved);
  EXPECT_EQ(moved.error().kind, Kind::interrupted);
  EXPECT_NE(moved.error().left.find("motor standing (standstill at"), std::string::npos) << moved.error().message();
  EXPECT_EQ(s.device->poll()->motion, MotionState::standstill);
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

TEST(LinkQuality, CountsWhatHappenedOnTheWire) {
  Rig s(Link::rtu);
  s.open("timeout_ms=60");
  const LinkQuality before = s.device->link_quality();
  EXPECT_EQ(before.retries + before.time_outs + before.broken_replies, 0u);
  s.server.mishap(Mishap::drop);
  ASSERT_TRUE(s.device->poll());
  s.server.mishap(Mishap::garble);
  ASSERT_TRUE(s.device->poll());
  s.server.mishap(Mishap::busy);
  ASSERT_TRUE(s.device->poll());
  const LinkQuality& after = s.device->link_quality();
  EXPECT_EQ(after.requests - before.requests, 6u);
  EXPECT_EQ(after.retries, 3u);
  EXPECT_EQ(after.time_outs, 1u);
  EXPECT_EQ(after.broken_replies, 1u);
  EXPECT_EQ(after.exceptions, 1u);
  EXPECT_EQ(after.reconnects, 0u);
  EXPECT_GT(after.round_trip_ns, 0);
  EXPECT_GE(after.longest_round_trip_ns, after.round_trip_ns);
}

/// The machine's clock, on which something happens at a time.
class EventClock final : public Clock {
 public:
  EventClock(Machine& machine, std::function<void()> event) : clock_(machine), event_(std::move(event)) {}
  std::int64_t now_ns() override { return clock_.now_ns(); }
  void sleep_until(std::int64_t time_ns) override {
    clock_.sleep_until(time_ns);
    if (armed_ns > 0 && clock_.now_ns() >= armed_ns) {
      armed_ns = 0;
      event_();
    }
  }
  std::int64_t armed_ns = 0;

 private:
  MachineClock clock_;
  std::function<void()> event_;
};

// A cable that was out for a moment: connections are tried with growing pauses.
TEST(LinkQuality, ALinkThatComesBackWithinHalfASecondIsMadeGood) {
  Machine machine;
  ModbusServer server(machine, Link::tcp);
  EventClock clock(machine, [&] { server.start(); });
  auto transport = open_transport(server.url("timeout_ms=2000"));
  ASSERT_TRUE(transport);
  auto device = ScannerDevice::open(std::move(*transport), clock);
  ASSERT_TRUE(device) << device.error().message();
  server.stop();
  clock.armed_ns = clock.now_ns() + 250'000'000;
  const auto polled = (*device)->poll();
  ASSERT_TRUE(polled) << polled.error().message();
  EXPECT_GE((*device)->link_quality().reconnects, 1u);
  server.stop();
  clock.armed_ns = clock.now_ns() + 1'000'000'000;  // too late: the controller has stopped by itself
  const auto lost = (*device)->poll();
  ASSERT_FALSE(lost);
  EXPECT_EQ(lost.error().kind, Kind::lost);
  server.start();
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

// ---- broken links ----

TEST_P(OnBothLinks, MishapsOfOneReplyAreRetriedUnseen) {
  s.open("timeout_ms=200");
  for (const Mishap m :
       {Mishap::drop, Mishap::ignore, Mishap::truncate, Mishap::garble, Mishap::busy, Mishap::close_link}) {
    s.server.mishap(m);
    const auto status = s.device->poll();
    EXPECT_TRUE(status) << static_cast<int>(m) << ": " << status.error().message();
  }
}

TEST_P(OnBothLinks, CommandWhoseReplyIsLostIsExecutedOnce) {
  s.open("timeout_ms=200");
  s.home();
  ASSERT_TRUE(s.device->poll());
  s.server.mishap(Mishap::none);  // the poll before the command
  s.server.mishap(Mishap::drop);
  const auto moved = s.device->rotate_to(45 * kDeg, 90 * kDeg);
  ASSERT_TRUE(moved) << moved.error().message();
  s.machine.with([](TestPlant& p, ControllerCore&) { EXPECT_EQ(p.moves, 1); });
}

TEST_P(OnBothLinks, RetriesAreBounded) {
  s.open("timeout_ms=50");
  s.server.mishap(Mishap::ignore, 3);
  const auto status = s.device->poll();
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().kind, Kind::timed_out);
  EXPECT_NE(status.error().left.find("the link is down; the controller turns the lasers off within 500 ms"),
            std::string::npos)
      << status.error().message();
  tl::expected<DeviceStatus, DeviceError> again = s.device->poll();
  for (int i = 0; i < 20 && !again; ++i) again = s.device->poll();
  EXPECT_TRUE(again);
}

TEST(BrokenLink, ServerVanishingInAMoveIsALostLinkAndTheDeviceComesBack) {
  Rig s;
  s.open("timeout_ms=500");
  s.home();
  ASSERT_TRUE(s.device->start_sweep(3600 * kDeg, 36 * kDeg));
  ASSERT_TRUE(s.device->renew_laser(0, 500));
  s.server.stop();
  const auto gone = s.device->poll();
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, Kind::lost);
  EXPECT_NE(gone.error().message().find("its state unknown: the link is down"), std::string::npos);
  const SafeReport unsafe = s.device->make_safe();
  EXPECT_FALSE(unsafe.lasers_off);
  EXPECT_FALSE(unsafe.motor_stopped);
  EXPECT_EQ(unsafe.lasers_were_on, 0);  // as last polled, before the grant
  s.machine.advance_ms(2000);
  s.server.start();
  const SafeReport safe = s.device->make_safe();
  EXPECT_TRUE(safe.lasers_off) << safe.text;
  EXPECT_TRUE(safe.motor_stopped) << safe.text;
  EXPECT_EQ(s.device->poll()->motion, MotionState::stopped);
  EXPECT_TRUE(s.device->home());
}

TEST(BrokenLink, MakeSafeIsTriedAgainUntilItGetsThrough) {
  for (const Mishap m : {Mishap::ignore, Mishap::drop, Mishap::garble, Mishap::close_link, Mishap::busy}) {
    Rig s;
    s.open("timeout_ms=100");
    s.home();
    ASSERT_TRUE(s.device->start_sweep(3600 * kDeg, 36 * kDeg));
    ASSERT_TRUE(s.device->renew_laser(0, 500));
    s.server.mishap(m, 2);
    const SafeReport report = s.device->make_safe();
    EXPECT_TRUE(report.lasers_off && report.motor_stopped) << static_cast<int>(m) << ": " << report.text;
    s.machine.with([](TestPlant& p, ControllerCore& core) {
      EXPECT_EQ(p.lasers, 0);
      EXPECT_EQ(core.motion(0), MotionState::standstill);
    });
  }
}

TEST(BrokenLink, DestroyingTheDeviceMakesSafe) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(3600 * kDeg, 36 * kDeg));
  ASSERT_TRUE(s.device->renew_laser(0, 500));
  s.device.reset();
  s.machine.with([](TestPlant& p, ControllerCore& core) {
    EXPECT_EQ(p.lasers, 0);
    EXPECT_EQ(core.motion(0), MotionState::standstill);
  });
}

TEST(Restart, OfTheControllerIsToldOnceAndResumesNothing) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(3600 * kDeg, 36 * kDeg));
  s.machine.restart();
  const auto told = s.device->poll();
  ASSERT_FALSE(told);
  EXPECT_EQ(told.error().kind, Kind::fault);
  EXPECT_NE(told.error().cause.find("restarted"), std::string::npos);
  const auto after = s.device->poll();
  ASSERT_TRUE(after);
  EXPECT_EQ(after->motion, MotionState::unhomed);
  EXPECT_EQ(after->speed_rad_per_s, 0);
  EXPECT_FALSE(after->homed);
  EXPECT_TRUE(s.device->home());
}

TEST(Restart, InARotationEndsTheCall) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(30 * kDeg, 36 * kDeg));
  s.machine.restart();
  const auto stopped = s.device->stop();
  ASSERT_FALSE(stopped);
  EXPECT_NE(stopped.error().cause.find("restarted"), std::string::npos);
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

// ---- soft limits and jerk ----

ControllerConfig jerk_config() {
  ControllerConfig config = test_config();
  config.axis[0].features |= protocol::kTakesJerk;
  return config;
}

TEST(MotionLimits, TargetsBeyondSoftLimitsAreRefusedHereByValueAndRemedy) {
  Rig rig;
  rig.open();
  rig.home();
  ASSERT_TRUE(rig.device->set_motion_limits({-10 * kDeg, 400 * kDeg, 0}));
  ASSERT_TRUE(rig.device->rotate_to(-9 * kDeg, 90 * kDeg));
  const int writes = rig.machine.writes;
  for (const double deg : {400.5, 1e6, -10.001}) {
    const auto refused = rig.device->rotate_to(deg * kDeg, 90 * kDeg);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().kind, Kind::refused);
    const std::string text = refused.error().message();
    EXPECT_NE(text.find(deg > 0 ? "beyond the soft limit of 400.000 deg" : "below the soft limit of -10.000 deg"),
              std::string::npos)
        << text;
    EXPECT_NE(text.find("stay between -10.000 deg and 400.000 deg"), std::string::npos) << text;
    EXPECT_FALSE(rig.device->start_sweep(deg * kDeg, 90 * kDeg));
  }
  EXPECT_EQ(rig.machine.writes, writes);
  EXPECT_TRUE(rig.device->rotate_to(400 * kDeg, 90 * kDeg));
}

TEST(MotionLimits, LimitsThatCannotBeAreRefused) {
  Rig rig;
  rig.open();
  EXPECT_FALSE(rig.device->set_motion_limits({1, 1, 0}));
  EXPECT_FALSE(rig.device->set_motion_limits({std::nan(""), 1, 0}));
  EXPECT_FALSE(rig.device->set_motion_limits({0, 1, -1}));
  EXPECT_FALSE(rig.device->set_motion_limits({0, 1, std::nan("")}));
  const auto old = rig.device->set_motion_limits({0, 1, 5});
  ASSERT_FALSE(old);
  EXPECT_NE(old.error().message().find("by trapezoids only"), std::string::npos) << old.error().message();
}

TEST(MotionLimits, JerkGoesWithEachMoveAndOnlyWhereItIsWanted) {
  Rig rig(Link::tcp, jerk_config());
  rig.open();
  rig.home();
  const auto last_jerk = [&] { return rig.machine.with([](TestPlant& p, ControllerCore&) { return p.last_jerk; }); };
  ASSERT_TRUE(rig.device->rotate_to(10 * kDeg, 90 * kDeg));
  EXPECT_EQ(last_jerk(), 0u);
  ASSERT_TRUE(rig.device->set_motion_limits({-10, 10, 1500 * kDeg}));
  ASSERT_TRUE(rig.device->rotate_to(20 * kDeg, 90 * kDeg));
  EXPECT_EQ(last_jerk(), 1'500'000u);
  ASSERT_TRUE(rig.device->set_motion_limits({}));
  ASSERT_TRUE(rig.device->rotate_to(10 * kDeg, 90 * kDeg));
  EXPECT_EQ(last_jerk(), 0u);
}

TEST(MotionLimits, TheRunUpIsTheWayToSpeed) {
  Rig rig(Link::tcp, jerk_config());
  rig.open();
  EXPECT_NEAR(rig.device->run_up_rad(45 * kDeg), 11.25 * kDeg, 1e-9);
  // 45 deg/s at 90 deg/s^2 and 360 deg/s^3: 0.25 s up, 0.25 s along, 0.25 s down, on average half the speed.
  ASSERT_TRUE(rig.device->set_motion_limits({-10, 10, 360 * kDeg}));
  EXPECT_NEAR(rig.device->run_up_rad(45 * kDeg), 22.5 * 0.75 * kDeg, 1e-9);
  // 10 deg/s: the acceleration is never reached; 2 sqrt(10 / 360) s.
  EXPECT_NEAR(rig.device->run_up_rad(-10 * kDeg), 5 * 2 * std::sqrt(10. / 360) * kDeg, 1e-9);
}

}  // namespace
}  // namespace celadon::test
