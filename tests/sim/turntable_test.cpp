#include "sim/turntable.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace celadon::sim {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr std::int64_t kSecond = 1'000'000'000;

TurntableConfig rigid() {
  TurntableConfig c;
  c.damping_time_s = 0;
  return c;
}

// 90 degrees at 1 rad/s with 2 rad/s^2: ramps of 0.5 s and 0.25 rad.
TEST(Turntable, FollowsTheTrapezoid) {
  Turntable t(rigid());
  t.move(kPi / 2, 1, 2, 0);
  const double along = kPi / 2 - 0.5;
  EXPECT_NEAR(t.table_angle_rad(kSecond / 4), 1 + 0.5 * 2 * 0.0625, 1e-9);
  EXPECT_NEAR(t.table_speed_rad_per_s(kSecond / 4), 0.5, 1e-9);
  EXPECT_NEAR(t.table_angle_rad(kSecond), 1 + 0.25 + 0.5, 1e-9);
  EXPECT_NEAR(t.table_speed_rad_per_s(kSecond), 1, 1e-9);
  const auto end = static_cast<std::int64_t>((1 + along) * 1e9);
  EXPECT_EQ(t.phase(end - 1'000'000), Turntable::Phase::moving);
  EXPECT_EQ(t.phase(end + 1'000'000), Turntable::Phase::settling);
  EXPECT_EQ(t.phase(end + kSecond), Turntable::Phase::standing);
  EXPECT_NEAR(t.table_angle_rad(end + kSecond), 1 + kPi / 2, 1e-12);
}

TEST(Turntable, ShortMovesAreTriangles) {
  Turntable t(rigid());
  t.move(-0.02, 1, 2, 0);  // peak sqrt(0.04) = 0.2 rad/s after 0.1 s
  EXPECT_NEAR(t.table_speed_rad_per_s(kSecond / 10), -0.2, 1e-9);
  EXPECT_NEAR(t.table_angle_rad(kSecond / 10), 1 - 0.01, 1e-9);
  EXPECT_NEAR(t.table_angle_rad(kSecond), 1 - 0.02, 1e-12);
}

TEST(Turntable, EncoderCountsInQuanta) {
  Turntable t(rigid());
  const double q = t.encoder_quantum_rad();
  EXPECT_NEAR(q * 180 / kPi, 0.0025, 1e-12);
  t.move(0.1, 1, 2, 0);
  for (std::int64_t ns = 0; ns < kSecond; ns += 7'777'777) {
    const double e = t.encoder_rad(ns), counts = e / q;
    EXPECT_NEAR(counts, std::round(counts), 1e-6);
    EXPECT_LE(std::abs(e - (t.table_angle_rad(ns) - 1)), 0.5 * q + 1e-12);
  }
}

TEST(Turntable, HomingEndsOnTheIndex) {
  for (const double start : {0.001, 1.0, 3.0, 6.2}) {
    TurntableConfig c;
    c.start_angle_rad = start;
    Turntable t(c);
    EXPECT_FALSE(t.index_found(0));
    t.home(0);
    EXPECT_FALSE(t.index_found(kSecond / 100));
    std::int64_t now = 0;
    while (t.phase(now) != Turntable::Phase::standing) now += 1'000'000;
    EXPECT_TRUE(t.index_found(now));
    const double turns = t.table_angle_rad(now) / (2 * kPi);
    EXPECT_NEAR(turns, std::round(turns), 1e-6);
    EXPECT_NEAR(t.encoder_rad(now), 0, t.encoder_quantum_rad());
  }
}

TEST(Turntable, StopDeceleratesAndKeepsThePosition) {
  Turntable t(rigid());
  t.move(100, 1, 2, 0);
  t.stop(kSecond);
  const double a = TurntableConfig().max_acceleration_rad_per_s2;
  EXPECT_NEAR(t.table_angle_rad(3 * kSecond), 1 + 0.75 + 1 / (2 * a), 1e-9);
  EXPECT_EQ(t.phase(3 * kSecond), Turntable::Phase::standing);
  t.stop(4 * kSecond);
  EXPECT_EQ(t.phase(4 * kSecond), Turntable::Phase::standing);
}

// After the motor stands the table swings at the resonance and dies out with the damping time; the amplitude is that of
// an oscillator driven by a step of acceleration.
TEST(Turntable, SwingsAfterAMoveAndSettles) {
  TurntableConfig c;
  Turntable t(c);
  t.move(1, 1, 5, 0);
  std::int64_t end = 0;
  while (t.phase(end) == Turntable::Phase::moving) end += 100'000;
  const double w = 2 * kPi * c.resonance_hz, amplitude = 5 / (w * w + 1 / (c.damping_time_s * c.damping_time_s));
  double most = 0, late = 0;
  for (std::int64_t ns = end; ns < end + 200'000'000; ns += 100'000) {
    const double off = std::abs(t.table_angle_rad(ns) - 2);
    most = std::max(most, off);
    if (ns > end + 100'000'000) late = std::max(late, off);
  }
  EXPECT_GT(most, 0.4 * amplitude);
  EXPECT_LT(most, 1.2 * amplitude);
  EXPECT_LT(late, 0.02 * amplitude);
}

// A damped oscillator never stands: when the drive reports standstill, the motor has speed 0 to the last bit and the
// table swings with what is left of two jolts of acceleration, exp(-t / damping time) each; then that is forgotten.
TEST(Turntable, AfterAStopTheMotorStandsAtOnceAndTheTableSwingsOut) {
  TurntableConfig c;
  Turntable t(c);
  t.move(100, 0.3, c.max_acceleration_rad_per_s2, 0);
  t.stop(kSecond);
  std::int64_t now = kSecond;
  while (t.phase(now) != Turntable::Phase::standing) now += 1'000'000;
  EXPECT_EQ(t.motor_speed_rad_per_s(now), 0.0);
  const double jolt = c.max_acceleration_rad_per_s2 / (2 * kPi * c.resonance_hz),
               left = std::exp(-c.settle_time_s / c.damping_time_s);
  double fastest = 0;
  for (std::int64_t ns = now; ns < now + 40'000'000; ns += 100'000) {
    fastest = std::max(fastest, std::abs(t.table_speed_rad_per_s(ns)));
  }
  EXPECT_LT(fastest, 2 * jolt * left);
  EXPECT_GT(fastest, 0.1 * jolt * left);
  static_cast<void>(t.table_angle_rad(now + 1'500'000'000));
  EXPECT_EQ(t.table_speed_rad_per_s(now + 1'500'000'000), 0.0);
}

// Speeds are the derivative of angles, through every phase.
TEST(Turntable, SpeedIsTheDerivativeOfTheAngle) {
  Turntable t(TurntableConfig{});
  t.move(2, 1, 5, 0);
  for (std::int64_t ns = 1'234'567; ns < 3 * kSecond; ns += 31'234'567) {
    constexpr std::int64_t h = 20'000;
    const double numeric = (t.table_angle_rad(ns + h) - t.table_angle_rad(ns - h)) / (2e-9 * static_cast<double>(h));
    EXPECT_NEAR(numeric, t.table_speed_rad_per_s(ns), 2e-4);
  }
}

TEST(Turntable, BacklashHoldsTheTableBack) {
  TurntableConfig c = rigid();
  c.backlash_rad = 0.01;
  Turntable t(c);
  t.move(1, 1, 5, 0);
  for (std::int64_t ns = 0; ns < 3 * kSecond; ns += 1'000'000) t.table_angle_rad(ns);
  const double forwards = t.table_angle_rad(3 * kSecond) - t.encoder_rad(3 * kSecond);
  t.move(0.5, 1, 5, 3 * kSecond);
  for (std::int64_t ns = 3 * kSecond; ns < 6 * kSecond; ns += 1'000'000) t.table_angle_rad(ns);
  const double backwards = t.table_angle_rad(6 * kSecond) - t.encoder_rad(6 * kSecond);
  EXPECT_NEAR(backwards - forwards, 0.01, 2 * t.encoder_quantum_rad());
}

TEST(Turntable, ABlockedMotorStallsWhereItIs) {
  Turntable t(rigid());
  t.move(10, 1, 5, 0);
  t.block(true, kSecond);
  EXPECT_TRUE(t.stalled());
  const double at = t.table_angle_rad(kSecond);
  EXPECT_NEAR(t.table_angle_rad(2 * kSecond), at, 1e-12);
  t.block(false, 2 * kSecond);
  t.clear_stall();
  t.move(1, 1, 5, 2 * kSecond);
  EXPECT_NEAR(t.encoder_rad(20 * kSecond), 1, t.encoder_quantum_rad());
}

}  // namespace
}  // namespace celadon::sim
