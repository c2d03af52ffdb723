// Two polls that can both be true, and two that cannot: against motions in closed form.

#include "firmware_bridge/status_check.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <numbers>

#include "tests/firmware_bridge/test_plant.h"

namespace celadon {
namespace {

using test::Trapezoid;
constexpr double kDeg = std::numbers::pi / 180;
constexpr double kAcceleration_udeg = 1000e6;

DeviceCapabilities capabilities() {
  DeviceCapabilities c;
  c.max_acceleration_rad_per_s2 = kAcceleration_udeg * 1e-6 * kDeg;
  return c;
}

DeviceStatus at(const Trapezoid& motion, std::uint64_t time_us, std::int64_t round_trip_us = 500) {
  DeviceStatus s;
  const auto now = static_cast<double>(time_us);
  s.homed = true;
  s.motion = now < motion.end_us() ? MotionState::moving : MotionState::standstill;
  s.position_time_us = s.uptime_us = time_us;
  s.angle_rad = motion.position(now) * 1e-6 * kDeg;
  s.speed_rad_per_s = motion.speed(now) * 1e-6 * kDeg;
  s.host_before_ns = static_cast<std::int64_t>(time_us) * 1000 + 7'000'000'000;
  s.host_after_ns = s.host_before_ns + round_trip_us * 1000;
  return s;
}

struct Pair {
  DeviceStatus before, now;
  double possible_deg;  ///< a T^2 / 4 and the slack
};

Pair any_pair() {
  const double speed = *rc::gen::inRange(1, 181) * 1e6;
  const auto motion =
      Trapezoid::to_target(1e6, 5e6, *rc::gen::inRange(-360, 360) * 1e6, speed, *rc::gen::inRange(10, 1001) * 1e6);
  const auto first = static_cast<std::uint64_t>(*rc::gen::inRange(0, 4'000'000));
  const auto later = static_cast<std::uint64_t>(*rc::gen::inRange(1'000, 60'000));
  const double seconds = static_cast<double>(later) * 1e-6;
  return {at(motion, first), at(motion, first + later), 0.2 + kAcceleration_udeg * 1e-6 * seconds * seconds / 4};
}

RC_GTEST_PROP(StatusCheck, NoMotionOfTheDriveIsTakenForAJump, ()) {
  const Pair pair = any_pair();
  RC_ASSERT(!contradiction(pair.before, pair.now, true, capabilities()));
}

RC_GTEST_PROP(StatusCheck, AJumpBeyondWhatTheDriveCanIsSeenAndMeasured, ()) {
  Pair pair = any_pair();
  // At constant speed the expectation is exact; while it changes, half of what the drive can is used up already.
  pair.now.angle_rad += 2.01 * pair.possible_deg * kDeg;
  const auto found = contradiction(pair.before, pair.now, true, capabilities());
  RC_ASSERT(found.has_value());
  RC_ASSERT(found->position);
}

TEST(StatusCheck, AtRestTwoTenthsOfADegreeAreTold) {
  const Trapezoid still{0, 30e6};
  const DeviceStatus before = at(still, 1'000'000);
  DeviceStatus now = at(still, 60'000'000);
  EXPECT_FALSE(contradiction(before, now, false, capabilities()));
  now.angle_rad += 0.25 * kDeg;
  const auto found = contradiction(before, now, false, capabilities());
  ASSERT_TRUE(found);
  EXPECT_NE(found->cause.find("0.250 deg"), std::string::npos) << found->cause;
  EXPECT_FALSE(contradiction(before, now, true, capabilities()));  // it may have moved there and come to rest
  now.homed = false;
  EXPECT_FALSE(contradiction(before, now, false, capabilities()));
}

TEST(StatusCheck, ClocksMayDriftButNotJump) {
  const Trapezoid still{0, 0};
  for (const std::int64_t interval_us : std::initializer_list<std::int64_t>{1'000, 1'000'000, 3'600'000'000}) {
    const auto later = static_cast<std::uint64_t>(1'000'000 + interval_us);
    const DeviceStatus before = at(still, 1'000'000, 30'000);
    for (const double drift : {-100e-6, 100e-6}) {
      DeviceStatus now = at(still, later, 30'000);
      now.uptime_us += static_cast<std::uint64_t>(static_cast<double>(interval_us) * (1 + drift)) -
                       static_cast<std::uint64_t>(interval_us);
      EXPECT_FALSE(contradiction(before, now, false, capabilities())) << interval_us;
    }
    for (const std::int64_t jump_us : {-60'000 - interval_us / 900, 60'000 + interval_us / 900}) {
      DeviceStatus now = at(still, later, 30'000);
      now.host_before_ns -= jump_us * 1000;
      now.host_after_ns -= jump_us * 1000;
      const auto found = contradiction(before, now, false, capabilities());
      ASSERT_TRUE(found) << interval_us << " " << jump_us;
      EXPECT_FALSE(found->position);
      EXPECT_NE(found->cause.find(jump_us > 0 ? "ahead of" : "behind"), std::string::npos) << found->cause;
    }
  }
}

}  // namespace
}  // namespace celadon
