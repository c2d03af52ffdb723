#pragma once
// A turntable in closed form: every position is a formula of time, so the tests know the truth without stepping.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "firmware_bridge/controller_core.h"

namespace celadon::test {

/// Ramp up, cruise, ramp down, from rest or from a speed (then only the ramp down).
struct Trapezoid {
  double start_us = 0, from = 0, sign = 1, peak = 0, acceleration = 1;  // udeg, udeg/s
  double up_s = 0, cruise_s = 0, down_s = 0;

  static Trapezoid to_target(double now_us, double from, double target, double speed, double acceleration) {
    Trapezoid t{now_us, from, target < from ? -1.0 : 1.0, speed, acceleration};
    const double distance = std::abs(target - from);
    t.peak = std::min(speed, std::sqrt(distance * acceleration));
    t.up_s = t.down_s = t.peak / acceleration;
    t.cruise_s = t.peak > 0 ? distance / t.peak - t.up_s : 0;
    return t;
  }
  static Trapezoid to_rest(double now_us, double from, double speed, double acceleration) {
    Trapezoid t{now_us, from, speed < 0 ? -1.0 : 1.0, std::abs(speed), acceleration};
    t.down_s = t.peak / acceleration;
    return t;
  }
  double end_us() const { return start_us + (up_s + cruise_s + down_s) * 1e6; }
  double speed(double now_us) const {
    double t = (now_us - start_us) / 1e6;
    if (t < up_s) return sign * acceleration * t;
    t -= up_s;
    if (t < cruise_s) return sign * peak;
    t -= cruise_s;
    return t < down_s ? sign * (peak - acceleration * t) : 0;
  }
  double position(double now_us) const {
    const double t = (now_us - start_us) / 1e6;
    const double a = std::min(t, up_s), b = std::clamp(t - up_s, 0.0, cruise_s),
                 c = std::clamp(t - up_s - cruise_s, 0.0, down_s);
    return from + sign * (acceleration * a * a / 2 + peak * b + peak * c - acceleration * c * c / 2);
  }
};

/// One axis, `lasers` lasers; every call of the core is recorded.
class TestPlant final : public Plant {
 public:
  static constexpr double kAcceleration = 90e6, kHomingSpeed = 30e6, kIndexAt = 75e6;
  static constexpr std::uint64_t kSettling_us = 50'000;

  // What the tests set.
  bool interlock_closed = true, emergency_stop = false, button = false, remote_enabled = true;
  std::uint16_t stuck_lasers = 0;  // emit whatever is commanded
  std::uint16_t dead_lasers = 0;   // emit nothing
  FaultCode input_fault = FaultCode::none, axis_fault = FaultCode::none;
  bool index_exists = true;
  double drag = 1;              // moves take so many times longer than asked for
  std::uint32_t last_jerk = 0;  // of the last move; it moves by trapezoids all the same
  double slip_udeg = 0;         // the table stands this far from where the motor thinks

  // What the tests look at.
  std::uint16_t lasers = 0;
  LampPattern lamp = LampPattern::off;
  std::vector<std::pair<std::uint64_t, std::uint16_t>> laser_log;
  std::uint64_t first_start_us = 0;  // of a motion
  int homes = 0, moves = 0, stops = 0, releases = 0, starts_outside_write = 0;
  bool inside_write = false;

  PlantInputs inputs(std::uint64_t) override {
    PlantInputs in;
    in.interlock_closed = interlock_closed;
    in.emergency_stop = emergency_stop;
    in.button = button;
    in.remote_enabled = remote_enabled;
    in.lasers_measured = static_cast<std::uint16_t>((lasers | stuck_lasers) & ~dead_lasers);
    in.fault = input_fault;
    return in;
  }
  AxisSample axis(int, std::uint64_t now_us) override {
    const double now = static_cast<double>(now_us);
    AxisSample s;
    s.time_us = now_us;
    s.counter = ++samples_;
    s.fault = axis_fault;
    if (homing_ && now >= motion_.end_us()) {
      homing_ = false;
      index_found_ = index_exists;
      if (index_exists) motion_ = Trapezoid{motion_.end_us(), 0};
    }
    s.index_found = index_found_;
    s.position_udeg = std::llround(motion_.position(now) + slip_udeg);
    s.speed_udeg_per_s = static_cast<std::int32_t>(std::lround(motion_.speed(now)));
    s.phase = now < motion_.end_us()                                                           ? AxisPhase::moving
              : now < motion_.end_us() + static_cast<double>(kSettling_us) && motion_.peak > 0 ? AxisPhase::settling
                                                                                               : AxisPhase::standing;
    return s;
  }
  void home(int, std::uint64_t now_us) override {
    note_start();
    if (homes + moves == 0) first_start_us = now_us;
    ++homes;
    homing_ = true;
    index_found_ = false;
    const double now = static_cast<double>(now_us), from = motion_.position(now);
    motion_ = Trapezoid::to_target(now, from, from + kIndexAt, kHomingSpeed, kAcceleration);
  }
  void move(int, std::int64_t target_udeg, std::uint32_t speed, std::uint32_t acceleration, std::uint32_t jerk,
            std::uint64_t now_us) override {
    last_jerk = jerk;
    note_start();
    if (homes + moves == 0) first_start_us = now_us;
    ++moves;
    const double now = static_cast<double>(now_us);
    motion_ =
        Trapezoid::to_target(now, motion_.position(now), static_cast<double>(target_udeg), speed / drag, acceleration);
  }
  void stop(int, std::uint64_t now_us) override {
    ++stops;
    homing_ = false;
    const double now = static_cast<double>(now_us);
    if (now < motion_.end_us())
      motion_ = Trapezoid::to_rest(now, motion_.position(now), motion_.speed(now), kAcceleration);
  }
  void release(int, std::uint64_t now_us) override {
    ++releases;
    homing_ = false;
    motion_ = Trapezoid{static_cast<double>(now_us), motion_.position(static_cast<double>(now_us))};
  }
  void set_lasers(std::uint16_t mask, std::uint64_t now_us) override {
    if (mask & ~lasers) note_start();
    lasers = mask;
    laser_log.emplace_back(now_us, mask);
  }
  void set_lamp(LampPattern pattern, std::uint64_t) override { lamp = pattern; }

  double speed_udeg(std::uint64_t now_us) const { return motion_.speed(static_cast<double>(now_us)); }

 private:
  void note_start() {
    if (!inside_write) ++starts_outside_write;
  }

  Trapezoid motion_;
  bool homing_ = false, index_found_ = false;
  std::uint32_t samples_ = 0;
};

inline ControllerConfig test_config() {
  ControllerConfig config;
  config.vendor = "Celadon";
  config.model = "test table";
  config.serial = "0001";
  config.firmware_version = 7;
  config.simulated = true;
  config.lasers = 2;
  config.locked_at_start = false;
  config.axis[0].encoder_resolution_ndeg = 1'000'000;
  config.axis[0].max_speed_udeg_per_s = 180'000'000;
  config.axis[0].max_acceleration_udeg_per_s2 = 90'000'000;
  return config;
}

}  // namespace celadon::test
