// The device front over real Modbus links: the table's motion and its limits.

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "tests/firmware_bridge/scanner_rig.h"

namespace celadon::test {
namespace {

using Rig = ScannerRig;

class MotionOnBothLinks : public OnALink {};
INSTANTIATE_ON_BOTH_LINKS(MotionOnBothLinks);

// ---- motion ----

TEST_P(MotionOnBothLinks, HomesRotatesAndSweeps) {
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
