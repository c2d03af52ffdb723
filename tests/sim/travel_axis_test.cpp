#include "sim/travel_axis.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <cstdint>

namespace celadon::sim {
namespace {

constexpr std::int64_t kOneSecond = 1'000'000'000;

TravelAxisConfig ruler(double start) {
  TravelAxisConfig c;
  c.lowest = -20;
  c.highest = 100;
  c.beyond = 3;
  c.max_speed = 40;
  c.max_acceleration = 80;
  c.homing_speed = 20;
  c.quantum = 0.01;
  c.start = start;
  return c;
}

/// Until it stands, a millisecond at a time as the device does. @returns when
std::int64_t stand(TravelAxis& axis, std::int64_t from_ns) {
  std::int64_t now = from_ns;
  do {
    now += 1'000'000;
  } while (axis.phase(now) != TravelAxis::Phase::standing && now < from_ns + 100 * kOneSecond);
  return now;
}

// 30 at 10 a second with ramps of 0.5 s and 2.5: 3.5 s.
TEST(TravelAxis, FollowsTheTrapezoid) {
  TravelAxis axis(ruler(7));
  axis.move(30, 10, 20, 0);  // from power-on, where the encoder says 0
  EXPECT_NEAR(axis.position(kOneSecond / 4), 7 + 0.625, 1e-9);
  EXPECT_NEAR(axis.speed(kOneSecond / 4), 5, 1e-9);
  EXPECT_NEAR(axis.position(2 * kOneSecond), 7 + 2.5 + 15, 1e-9);
  EXPECT_NEAR(axis.position(13 * kOneSecond / 4), 7 + 30 - 0.625, 1e-9);
  EXPECT_EQ(axis.phase(7 * kOneSecond / 2 - 1), TravelAxis::Phase::moving);
  EXPECT_EQ(axis.phase(7 * kOneSecond / 2), TravelAxis::Phase::settling);
  EXPECT_EQ(axis.phase(18 * kOneSecond / 5), TravelAxis::Phase::standing);
  EXPECT_EQ(axis.position(4 * kOneSecond), 37);
  EXPECT_EQ(axis.speed(4 * kOneSecond), 0);
}

RC_GTEST_PROP(TravelAxisProperties, HomesFromAnywhereFromBelowAndThenGoesWhereItIsSent, ()) {
  TravelAxis axis(ruler(*rc::gen::inRange(-2000, 10000) * 0.01));
  axis.home(0);
  std::int64_t now = 0;
  double before = axis.position(0);
  bool upwards_at_last = false;
  while (axis.phase(now) == TravelAxis::Phase::moving) {
    now += 1'000'000;
    const double at = axis.position(now);
    RC_ASSERT(at > -20 - 1e-9 && at < 100 + 1e-9);
    RC_ASSERT(std::abs(at - before) <= 20e-3 + 1e-9);
    if (at != before) upwards_at_last = at > before;
    before = at;
  }
  RC_ASSERT(upwards_at_last);
  RC_ASSERT(axis.index_found(now));
  now = stand(axis, now);
  RC_ASSERT(axis.position(now) == 0);
  RC_ASSERT(axis.encoder(now) == 0);
  const double to = *rc::gen::inRange(-2000, 10000) * 0.01;
  axis.move(to, 40, 80, now);
  now = stand(axis, now);
  RC_ASSERT(std::abs(axis.position(now) - to) < 1e-9);
  RC_ASSERT(std::abs(axis.encoder(now) - to) < 1e-9);
}

TEST(TravelAxis, EncoderCountsInSteps) {
  TravelAxis axis(ruler(0.123));
  axis.move(10, 10, 20, 0);
  for (std::int64_t ns = 0; ns < kOneSecond; ns += 7'777'777) {
    const double steps = axis.encoder(ns) / 0.01;
    EXPECT_NEAR(steps, std::round(steps), 1e-6);
    EXPECT_LE(std::abs(axis.encoder(ns) - (axis.position(ns) - 0.123)), 0.005 + 1e-9);
  }
}

// From 10 a second at 80 a second^2: 0.125 s and 0.625.
TEST(TravelAxis, StopsWithItsGreatestDeceleration) {
  TravelAxis axis(ruler(0));
  axis.move(90, 10, 20, 0);
  axis.stop(kOneSecond);
  EXPECT_NEAR(axis.position(2 * kOneSecond), 2.5 + 5 + 0.625, 1e-9);
  EXPECT_EQ(axis.phase(kOneSecond + kOneSecond / 8 - 1000), TravelAxis::Phase::moving);
  EXPECT_NE(axis.phase(kOneSecond + kOneSecond / 8), TravelAxis::Phase::moving);
  EXPECT_FALSE(axis.index_found(2 * kOneSecond));
}

TEST(TravelAxis, AHardEndStopsWhatTheEncoderWouldLetGoOn) {
  TravelAxis axis(ruler(0));
  axis.home(0);
  std::int64_t now = stand(axis, 0);
  axis.slip_encoder(-10);  // it believes to be ten lower than it is
  axis.move(100, 40, 80, now);
  now = stand(axis, now);
  EXPECT_TRUE(axis.at_end());
  EXPECT_EQ(axis.position(now), 103);
  axis.release(now);
  EXPECT_FALSE(axis.at_end());
  axis.home(now);
  now = stand(axis, now);
  EXPECT_EQ(axis.position(now), 0);
  EXPECT_EQ(axis.encoder(now), 0);
  EXPECT_FALSE(axis.at_end());
}

TEST(TravelAxis, StallsAndSinks) {
  TravelAxis axis(ruler(0));
  axis.move(50, 10, 20, 0);
  axis.block(true, kOneSecond);
  EXPECT_TRUE(axis.stalled());
  const double at = axis.position(kOneSecond);
  EXPECT_NEAR(at, 7.5, 1e-9);
  EXPECT_EQ(axis.position(3 * kOneSecond), at);
  axis.block(false, 3 * kOneSecond);
  axis.clear_stall();
  axis.shift(-2, 3 * kOneSecond);
  EXPECT_EQ(axis.position(3 * kOneSecond), at - 2);
  EXPECT_NEAR(axis.encoder(3 * kOneSecond), at - 2, 0.005 + 1e-9) << "the encoder sees it";
  axis.block(true, 4 * kOneSecond);
  EXPECT_FALSE(axis.stalled()) << "nothing was demanded";
  axis.move(60, 10, 20, 4 * kOneSecond);
  EXPECT_TRUE(axis.stalled());
}

}  // namespace
}  // namespace celadon::sim
