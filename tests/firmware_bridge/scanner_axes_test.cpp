// Elevation axis and lift through the device front, over real Modbus links.

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "tests/firmware_bridge/scanner_rig.h"

namespace celadon::test {
namespace {

using Rig = ScannerRig;

struct AxesRig : ScannerRig {
  explicit AxesRig(Link link = Link::tcp, const ControllerConfig& config = three_axes()) : ScannerRig(link, config) {}
  void open_homed() {
    open();
    for (const AxisKind kind : {AxisKind::turntable, AxisKind::elevation, AxisKind::lift}) {
      const auto homed = device->home_axis(kind);
      ASSERT_TRUE(homed) << homed.error().message();
    }
  }
  /// A move begins, in the words of another client, and nobody waits for it.
  void begin_move(int block, std::int32_t target, std::uint32_t speed) {
    std::uint16_t words[10] = {};
    protocol::put_s32(words, target);
    protocol::put_u32(words + 4, speed);
    words[9] = protocol::kMove;
    ASSERT_EQ(machine.write(protocol::groups::axis_command.address(block), 10, words), protocol::Exception::none);
  }
};

ControllerConfig without_session(ControllerConfig config) {
  config.session_timeout_ms = 0;
  return config;
}

class AxesOnBothLinks : public testing::TestWithParam<Link> {
 protected:
  AxesRig s{GetParam()};
};
INSTANTIATE_ON_BOTH_LINKS(AxesOnBothLinks);

TEST_P(AxesOnBothLinks, HomeMoveAndTellWhereTheyAre) {
  s.open_homed();
  EXPECT_TRUE(s.device->has_axis(AxisKind::elevation));
  const AxisLimits e = s.device->limits(AxisKind::elevation), l = s.device->limits(AxisKind::lift);
  EXPECT_NEAR(e.lowest, -20 * kDeg, 1e-12);
  EXPECT_NEAR(e.highest, 160 * kDeg, 1e-12);
  EXPECT_NEAR(e.max_speed, 60 * kDeg, 1e-12);
  EXPECT_NEAR(e.max_acceleration, 90 * kDeg, 1e-12);
  EXPECT_NEAR(e.resolution, 1e-6 * kDeg, 1e-18);
  EXPECT_NEAR(l.lowest, -10, 1e-12);
  EXPECT_NEAR(l.highest, 160, 1e-12);
  EXPECT_NEAR(l.max_speed, 60, 1e-12);
  EXPECT_NEAR(l.resolution, 1e-3, 1e-15);
  const auto raised = s.device->move_axis(AxisKind::elevation, 40 * kDeg);
  ASSERT_TRUE(raised) << raised.error().message();
  ASSERT_TRUE(s.device->move_axis(AxisKind::lift, -7.25));
  ASSERT_TRUE(s.device->move_axis(AxisKind::turntable, 30 * kDeg));
  const auto status = s.device->poll();
  ASSERT_TRUE(status && status->elevation && status->lift);
  EXPECT_NEAR(status->elevation->position, 40 * kDeg, 1e-9);
  EXPECT_NEAR(status->lift->position, -7.25, 1e-9);
  EXPECT_NEAR(status->angle_rad, 30 * kDeg, 1e-9);
  EXPECT_EQ(status->lift->motion, MotionState::standstill);
  EXPECT_TRUE(status->lift->homed);
  EXPECT_NEAR(status->lift->target, -7.25, 1e-9);
  // The ends of the travel are part of it.
  EXPECT_TRUE(s.device->move_axis(AxisKind::lift, l.highest));
  EXPECT_TRUE(s.device->move_axis(AxisKind::elevation, e.lowest));
}

TEST(ScannerAxes, PositionsHaveTheInstantOfTheirSample) {
  AxesRig s(Link::tcp, without_session(three_axes()));
  s.open_homed();
  s.begin_move(2, 100'000, 30'000);
  s.machine.advance_ms(600);
  const auto first = s.device->poll();
  s.machine.advance_ms(100);
  const auto second = s.device->poll();
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->lift->motion, MotionState::moving);
  EXPECT_NEAR(first->lift->speed, 30, 1e-9);
  EXPECT_GT(second->lift->position_counter, first->lift->position_counter);
  const double seconds = static_cast<double>(second->lift->position_time_us - first->lift->position_time_us) * 1e-6;
  EXPECT_GE(seconds, 0.1);
  EXPECT_NEAR(second->lift->position - first->lift->position, 30 * seconds, 2e-3);
}

// Which block holds which kind is the machine's affair.
TEST(ScannerAxes, ALiftMayComeFirstAndAlone) {
  ControllerConfig config = three_axes();
  std::swap(config.axis[1], config.axis[2]);
  config.axes = 2;
  AxesRig s(Link::tcp, config);
  s.open();
  EXPECT_FALSE(s.device->has_axis(AxisKind::elevation));
  ASSERT_TRUE(s.device->has_axis(AxisKind::lift));
  EXPECT_NEAR(s.device->limits(AxisKind::lift).highest, 160, 1e-12);
  // The plant behind block 1 moves in the other unit; what matters is which block was commanded.
  s.machine.with([](TestPlant& p, ControllerCore&) { p.drag = 1; });
  const auto refused = s.device->home_axis(AxisKind::elevation);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, Kind::refused);
  EXPECT_NE(refused.error().cause.find("no axis of the kind elevation"), std::string::npos) << refused.error().cause;
  (void)s.device->home_axis(AxisKind::lift);
  s.machine.with([](TestPlant& p, ControllerCore&) {
    EXPECT_EQ(p.motor(1).homes, 1);
    EXPECT_EQ(p.motor(0).homes, 0);
  });
}

TEST(ScannerAxes, AMachineWithoutThemSaysSo) {
  Rig s;
  s.open();
  EXPECT_FALSE(s.device->has_axis(AxisKind::elevation));
  EXPECT_FALSE(s.device->has_axis(AxisKind::lift));
  EXPECT_FALSE(s.device->poll()->elevation);
  const auto moved = s.device->move_axis(AxisKind::lift, 1);
  ASSERT_FALSE(moved);
  EXPECT_EQ(moved.error().kind, Kind::refused);
  EXPECT_EQ(s.device->limits(AxisKind::turntable).highest, std::numeric_limits<double>::infinity());
}

TEST(ScannerAxes, TwoAxesOfOneKindAreNoMachine) {
  ControllerConfig config = three_axes();
  config.axis[1] = config.axis[2];
  Rig s(Link::tcp, config);
  const auto opened = s.try_open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().kind, Kind::wrong_protocol);
  EXPECT_NE(opened.error().cause.find("axis 2 of kind 3"), std::string::npos) << opened.error().cause;
}

TEST(ScannerAxes, AKindOfALaterVersionIsLeftAlone) {
  ControllerConfig config = three_axes();
  config.axis[1].kind = 9;
  AxesRig s(Link::tcp, config);
  s.open();
  EXPECT_FALSE(s.device->has_axis(AxisKind::elevation));
  EXPECT_TRUE(s.device->home_axis(AxisKind::lift));
}

TEST(ScannerAxes, IllegalMovesAreRefusedBeforeTheyReachTheController) {
  AxesRig s;
  s.open();
  const auto writes = [&] { return s.machine.writes.load(); };
  int before = writes();
  auto moved = s.device->move_axis(AxisKind::elevation, 0.1);
  ASSERT_FALSE(moved);
  EXPECT_EQ(moved.error().kind, Kind::wrong_state);
  EXPECT_NE(moved.error().message().find("the axis is not homed"), std::string::npos) << moved.error().message();
  EXPECT_EQ(writes(), before);
  ASSERT_TRUE(s.device->home_axis(AxisKind::elevation));
  ASSERT_TRUE(s.device->home_axis(AxisKind::lift));
  before = writes();
  for (const auto& [kind, to] : {std::pair{AxisKind::elevation, 160.01 * kDeg},
                                 {AxisKind::elevation, -20.01 * kDeg},
                                 {AxisKind::lift, 160.01},
                                 {AxisKind::lift, -10.01},
                                 {AxisKind::lift, std::nan("")}}) {
    moved = s.device->move_axis(kind, to);
    ASSERT_FALSE(moved) << to;
    EXPECT_EQ(moved.error().kind, Kind::refused);
  }
  EXPECT_NE(moved.error().remedy.find("-10.000 mm and 160.000 mm"), std::string::npos) << moved.error().remedy;
  EXPECT_EQ(writes(), before);
}

TEST(ScannerAxes, OneMovesWhileAnotherTurns) {
  AxesRig s;
  s.open_homed();
  ASSERT_TRUE(s.device->start_sweep(720 * kDeg, 36 * kDeg));
  const auto moved = s.device->move_axis(AxisKind::elevation, 20 * kDeg);
  ASSERT_TRUE(moved) << moved.error().message();
  EXPECT_EQ(s.device->poll()->motion, MotionState::moving);
  ASSERT_TRUE(s.device->stop());
  EXPECT_EQ(s.device->poll()->motion, MotionState::standstill);
}

TEST(ScannerAxes, MakeSafeAndStopStopThemAll) {
  for (const bool make_safe : {true, false}) {
    AxesRig s(Link::tcp, without_session(three_axes()));
    s.open_homed();
    s.begin_move(1, 150'000'000, 60'000'000);
    s.begin_move(2, 150'000, 60'000);
    s.machine.advance_ms(700);
    if (make_safe) {
      const SafeReport report = s.device->make_safe();
      EXPECT_TRUE(report.motor_stopped) << report.text;
      EXPECT_NE(report.text.find("lift standing (standstill"), std::string::npos) << report.text;
    } else {
      ASSERT_TRUE(s.device->stop());
    }
    s.machine.with([&](TestPlant& p, ControllerCore& core) {
      for (int axis = 0; axis < 3; ++axis) EXPECT_EQ(core.motion(axis), MotionState::standstill) << axis;
      EXPECT_EQ(p.motor(1).stops, 2) << "one when the core started";
      EXPECT_EQ(p.motor(2).stops, 2);
    });
  }
}

TEST(ScannerAxes, ALiftThatMovesWhenTheHostComesIsStoppedAndTold) {
  AxesRig s(Link::tcp, without_session(three_axes()));
  s.open_homed();
  s.device.reset();
  s.begin_move(2, 150'000, 60'000);
  s.machine.advance_ms(500);
  s.open();
  const SafeReport& found = s.device->found_at_open();
  EXPECT_EQ(found.motion_was, MotionState::moving);
  EXPECT_TRUE(found.motor_stopped) << found.text;
  EXPECT_NE(found.text.find("found it active"), std::string::npos) << found.text;
}

TEST(ScannerAxes, AStalledLiftIsNamedAndForbidsLight) {
  AxesRig s;
  s.open_homed();
  s.machine.with([](TestPlant& p, ControllerCore&) {
    p.faulty_axis = 2;
    p.axis_fault = FaultCode::motor_stalled;
  });
  const auto moved = s.device->move_axis(AxisKind::lift, 20);
  ASSERT_FALSE(moved);
  EXPECT_EQ(moved.error().kind, Kind::fault);
  EXPECT_NE(moved.error().cause.find("the motor stalled (lift)"), std::string::npos) << moved.error().cause;
  EXPECT_EQ(s.device->renew_laser(0, 100).error().kind, Kind::fault);
}

// It hangs on its spindle: what it does when that gives way is seen at the next poll.
TEST(ScannerAxes, ALiftThatSinksIsToldOnceAndHomedAgain) {
  AxesRig s;
  s.open_homed();
  s.machine.with([](TestPlant& p, ControllerCore&) { p.lift_slip_um = -1'500; });
  const auto told = s.device->poll();
  ASSERT_FALSE(told);
  EXPECT_EQ(told.error().kind, Kind::fault);
  EXPECT_NE(told.error().cause.find("of the lift jumped by -1.500 mm"), std::string::npos) << told.error().cause;
  const auto later = s.device->poll();
  ASSERT_TRUE(later) << later.error().message();
  EXPECT_FALSE(later->lift->homed);
  EXPECT_TRUE(later->elevation->homed);
  EXPECT_TRUE(later->homed);
  s.machine.with([](TestPlant& p, ControllerCore&) { p.lift_slip_um = 0; });
  (void)s.device->poll();
  ASSERT_TRUE(s.device->home_axis(AxisKind::lift));
  EXPECT_TRUE(s.device->poll()->lift->homed);
}

TEST(ScannerAxes, AnAxisThatStandsElsewhereIsAFault) {
  AxesRig s;
  s.open_homed();
  s.machine.with([](TestPlant& p, ControllerCore&) { p.lift_slip_um = 120; });
  const auto moved = s.device->move_axis(AxisKind::lift, 20);
  ASSERT_FALSE(moved);
  EXPECT_NE(moved.error().cause.find("0.120 mm away"), std::string::npos) << moved.error().cause;
}

TEST(ScannerAxes, AnInterruptionStopsAMove) {
  AxesRig s;
  s.open_homed();
  int polls = 0;
  s.device->set_interrupt([&] { return ++polls == 5 ? std::optional<std::string>("enough") : std::nullopt; });
  const auto moved = s.device->move_axis(AxisKind::lift, 150);
  ASSERT_FALSE(moved);
  EXPECT_EQ(moved.error().kind, Kind::interrupted);
  const auto status = s.device->poll();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->lift->motion, MotionState::standstill);
  EXPECT_LT(status->lift->position, 100);
}

TEST(ScannerAxes, ACommandWhoseReplyIsLostIsExecutedOnce) {
  AxesRig s;
  s.open("timeout_ms=60");
  ASSERT_TRUE(s.device->home_axis(AxisKind::lift));
  s.machine.with([](TestPlant& p, ControllerCore&) { EXPECT_EQ(p.motor(2).homes, 1); });
  // Polls before the command go through; the reply to the command itself gets lost.
  ASSERT_TRUE(s.device->poll());
  s.server.mishap(Mishap::none);
  s.server.mishap(Mishap::drop);
  const auto moved = s.device->move_axis(AxisKind::lift, 20);
  ASSERT_TRUE(moved) << moved.error().message();
  s.machine.with([](TestPlant& p, ControllerCore&) { EXPECT_EQ(p.motor(2).moves, 1); });
}

}  // namespace
}  // namespace celadon::test
