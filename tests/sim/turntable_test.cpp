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

// ---- S-curves ----

struct SCurve {
  double distance, speed, acceleration, jerk;
  double time_s;  // by the textbook's cases, see below
};

// v j >= a^2 and a long way: D/v + v/a + a/j. v j < a^2 and long: D/v + 2 sqrt(v/j). Short of the speed, not of the
// acceleration: a/j + sqrt((a/j)^2 + 4 D/a). Short of both: 4 cbrt(D / 2j).
const SCurve kSCurves[] = {
    {10, 1, 2, 8, 10 + 0.5 + 0.25},
    {-10, 1, 4, 8, 10 + 2 * std::sqrt(0.125)},
    {0.3, 1, 2, 40, 0.05 + std::sqrt(0.0025 + 0.6)},
    {-0.01, 1, 2, 8, 4 * std::cbrt(0.01 / 16)},
};

TEST(Turntable, SCurvesTakeTheTimeThatTheFormulasSay) {
  for (const SCurve& c : kSCurves) {
    Turntable t(rigid());
    t.move(c.distance, c.speed, c.acceleration, 0, c.jerk);
    const std::int64_t end = std::llround(c.time_s * 1e9);
    EXPECT_EQ(t.phase(end - 1000), Turntable::Phase::moving) << c.distance;
    EXPECT_NE(t.phase(end + 1000), Turntable::Phase::moving) << c.distance;
    EXPECT_NEAR(t.table_angle_rad(end + 1000) - 1, c.distance, 1e-12);
    EXPECT_EQ(t.motor_speed_rad_per_s(end + 1000), 0.0);
  }
}

TEST(Turntable, SCurvesKeepJerkAccelerationAndSpeed) {
  for (const SCurve& c : kSCurves) {
    Turntable t(rigid());
    t.move(c.distance, c.speed, c.acceleration, 0, c.jerk);
    const double sign = c.distance < 0 ? -1 : 1;
    // At first the acceleration is jt: the way j t^3 / 6.
    EXPECT_NEAR((t.table_angle_rad(20'000'000) - 1) * sign, c.jerk * 8e-6 / 6, 1e-12);
    // It is the same backwards in time.
    EXPECT_NEAR(t.table_angle_rad(std::llround(c.time_s * 0.5e9)) - 1, c.distance / 2, 1e-8);
    Turntable again(rigid());  // calls must not go back in time
    again.move(c.distance, c.speed, c.acceleration, 0, c.jerk);
    constexpr double kStep_s = 1e-3;
    double fastest = 0, hardest = 0, steepest = 0, before = 0, before_a = 0;
    for (std::int64_t i = 1; static_cast<double>(i) * kStep_s < c.time_s + 0.1; ++i) {
      const double v = again.motor_speed_rad_per_s(i * 1'000'000), a = (v - before) / kStep_s;
      fastest = std::max(fastest, std::abs(v));
      hardest = std::max(hardest, std::abs(a));
      steepest = std::max(steepest, std::abs(a - before_a) / kStep_s);
      before = v;
      before_a = a;
    }
    EXPECT_LE(fastest, c.speed * (1 + 1e-6));
    EXPECT_LE(hardest, c.acceleration * (1 + 1e-6));
    EXPECT_LE(steepest, c.jerk * (1 + 1e-3));
    EXPECT_GE(steepest, c.jerk * 0.9);
  }
}

// The table's swing against the oscillator integrated by Runge and Kutta: y'' + 2 y'/tau + w0^2 y = a(t).
TEST(Turntable, TheTableFollowsAnSCurveAsItsOscillatorSays) {
  TurntableConfig config;
  Turntable t(config);
  const SCurve c{2, 1, 5, 60, 0};
  t.move(1 + c.distance, c.speed, c.acceleration, 0, c.jerk);  // the encoder counts from 0, the table from 1
  const double tau = config.damping_time_s, w = 2 * kPi * config.resonance_hz, w0_squared = w * w + 1 / (tau * tau);
  const double rise = c.acceleration / c.jerk;
  const auto acceleration = [&](double s) {  // of the first 0.28 s: up, along, down to constant speed
    if (s < rise) return c.jerk * s;
    if (s < c.speed / c.acceleration) return c.acceleration;
    return std::max(0.0, c.acceleration - c.jerk * (s - c.speed / c.acceleration));
  };
  const auto slope = [&](double s, double y, double v) { return acceleration(s) - 2 * v / tau - w0_squared * y; };
  double y = 0, v = 0;
  constexpr double kStep_s = 1e-5;
  for (int i = 0; i < 28'000; ++i) {
    const double s = i * kStep_s, h = kStep_s;
    const double k1 = slope(s, y, v), v2 = v + h / 2 * k1, k2 = slope(s + h / 2, y + h / 2 * v, v2),
                 v3 = v + h / 2 * k2, k3 = slope(s + h / 2, y + h / 2 * v2, v3), v4 = v + h * k3,
                 k4 = slope(s + h, y + h * v3, v4);
    y += h / 6 * (v + 2 * v2 + 2 * v3 + v4);
    v += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
    if (i % 1000 != 999) continue;
    const std::int64_t now = (i + 1) * 10'000;
    EXPECT_NEAR(t.motor_speed_rad_per_s(now) - t.table_speed_rad_per_s(now), v, 1e-6 * c.speed) << now;
  }
}

TEST(Turntable, AnSCurveShakesTheTableLessAndIsForgotten) {
  TurntableConfig config;
  const auto swing = [&](double jerk) {
    Turntable t(config);
    t.move(2, 1, 5, 0, jerk);
    std::int64_t end = 0;
    while (t.phase(end) == Turntable::Phase::moving) end += 100'000;
    double most = 0;
    for (std::int64_t ns = end; ns < end + 100'000'000; ns += 100'000)
      most = std::max(most, std::abs(t.table_speed_rad_per_s(ns)));
    static_cast<void>(t.table_angle_rad(end + 3'000'000'000));
    EXPECT_EQ(t.table_speed_rad_per_s(end + 3'000'000'000), 0.0);
    return most;
  };
  EXPECT_LT(swing(60), 0.3 * swing(0));
}

TEST(Turntable, AStopInTheMiddleOfAnSCurve) {
  for (const double after_s : {0.05, 0.2, 0.26, 1.0}) {
    TurntableConfig config;
    Turntable t(config);
    t.move(3, 1, 5, 0, 60);
    const auto at = static_cast<std::int64_t>(after_s * 1e9);
    const double speed = t.motor_speed_rad_per_s(at);
    t.stop(at);
    const std::int64_t stands = at + std::llround(speed / config.max_acceleration_rad_per_s2 * 1e9);
    EXPECT_EQ(t.phase(stands - 10'000), Turntable::Phase::moving);
    EXPECT_EQ(t.motor_speed_rad_per_s(stands + 10'000), 0.0);
    static_cast<void>(t.table_angle_rad(stands + 3'000'000'000));
    EXPECT_EQ(t.table_speed_rad_per_s(stands + 3'000'000'000), 0.0);
  }
}

}  // namespace
}  // namespace celadon::sim
