#pragma once
// A turntable in closed form: every position is a formula of time, so the tests know the truth without stepping.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
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

/// Up to three axes that are alike but for the third, a lift, whose numbers are thousandths of the others'; `lasers`
/// lasers; every call of the core is recorded.
class TestPlant final : public Plant {
 public:
  static constexpr double kAcceleration = 90e6, kHomingSpeed = 30e6, kIndexAt = 75e6;
  static constexpr std::uint64_t kSettling_us = 50'000;

  // What the tests set.
  bool interlock_closed = true, emergency_stop = false, button = false, remote_enabled = true;
  std::uint16_t stuck_lasers = 0;  // emit whatever is commanded
  std::uint16_t dead_lasers = 0;   // emit nothing
  FaultCode input_fault = FaultCode::none, axis_fault = FaultCode::none;
  std::size_t faulty_axis = 0;  // has axis_fault
  bool index_exists = true;
  double drag = 1;              // moves take so many times longer than asked for
  std::uint32_t last_jerk = 0;  // of the last move; it moves by trapezoids all the same
  double slip_udeg = 0;         // the table stands this far from where the motor thinks
  double lift_slip_um = 0;      // and axis 2 from where its motor thinks

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
  AxisSample axis(int number, std::uint64_t now_us) override {
    Motor& m = motor(number);
    const double now = static_cast<double>(now_us);
    AxisSample s;
    s.time_us = now_us;
    s.counter = ++m.samples;
    if (number == static_cast<int>(faulty_axis)) s.fault = axis_fault;
    if (m.homing && now >= m.motion.end_us()) {
      m.homing = false;
      m.index_found = index_exists;
      if (index_exists) m.motion = Trapezoid{m.motion.end_us(), 0};
    }
    s.index_found = m.index_found;
    s.position_udeg = std::llround(m.motion.position(now) + (number == 0 ? slip_udeg : number == 2 ? lift_slip_um : 0));
    s.speed_udeg_per_s = static_cast<std::int32_t>(std::lround(m.motion.speed(now)));
    s.phase = now < m.motion.end_us()                                                            ? AxisPhase::moving
              : now < m.motion.end_us() + static_cast<double>(kSettling_us) && m.motion.peak > 0 ? AxisPhase::settling
                                                                                                 : AxisPhase::standing;
    return s;
  }
  void home(int number, std::uint64_t now_us) override {
    Motor& m = motor(number);
    note_start();
    if (homes + moves == 0) first_start_us = now_us;
    ++homes;
    ++m.homes;
    m.homing = true;
    m.index_found = false;
    const double now = static_cast<double>(now_us), from = m.motion.position(now);
    m.motion = Trapezoid::to_target(now, from, from + scale(number) * kIndexAt, scale(number) * kHomingSpeed,
                                    scale(number) * kAcceleration);
  }
  void move(int number, std::int64_t target_udeg, std::uint32_t speed, std::uint32_t acceleration, std::uint32_t jerk,
            std::uint64_t now_us) override {
    Motor& m = motor(number);
    last_jerk = jerk;
    note_start();
    if (homes + moves == 0) first_start_us = now_us;
    ++moves;
    ++m.moves;
    const double now = static_cast<double>(now_us);
    m.motion =
        Trapezoid::to_target(now, m.motion.position(now), static_cast<double>(target_udeg), speed / drag, acceleration);
  }
  void stop(int number, std::uint64_t now_us) override {
    Motor& m = motor(number);
    ++stops;
    ++m.stops;
    m.homing = false;
    const double now = static_cast<double>(now_us);
    if (now < m.motion.end_us())
      m.motion = Trapezoid::to_rest(now, m.motion.position(now), m.motion.speed(now), scale(number) * kAcceleration);
  }
  void release(int number, std::uint64_t now_us) override {
    Motor& m = motor(number);
    ++releases;
    ++m.releases;
    m.homing = false;
    m.motion = Trapezoid{static_cast<double>(now_us), m.motion.position(static_cast<double>(now_us))};
  }
  void set_lasers(std::uint16_t mask, std::uint64_t now_us) override {
    if (mask & ~lasers) note_start();
    lasers = mask;
    laser_log.emplace_back(now_us, mask);
  }
  void set_lamp(LampPattern pattern, std::uint64_t) override { lamp = pattern; }

  struct Motor {
    Trapezoid motion;
    bool homing = false, index_found = false;
    std::uint32_t samples = 0;
    int homes = 0, moves = 0, stops = 0, releases = 0;
  };
  Motor& motor(int number) { return motors_[static_cast<std::size_t>(number)]; }
  double speed_udeg(std::uint64_t now_us, int number = 0) {
    return motor(number).motion.speed(static_cast<double>(now_us));
  }

  static double scale(int number) { return number == 2 ? 1e-3 : 1; }

 private:
  void note_start() {
    if (!inside_write) ++starts_outside_write;
  }

  std::array<Motor, protocol::kMaxAxes> motors_;
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

/// The same with an elevation axis in block 1 and a lift in block 2: -20 to 160 degrees and -10 to 160 mm, 60 units a
/// second.
inline ControllerConfig three_axes() {
  ControllerConfig config = test_config();
  config.axes = 3;
  for (int i = 1; i < 3; ++i) {
    ControllerConfig::Axis& axis = config.axis[i];
    const bool lift = i == 2;
    const std::int32_t unit = lift ? 1'000 : 1'000'000;  // micrometres, microdegrees
    axis.kind = lift ? protocol::kLift : protocol::kElevation;
    axis.features = protocol::kHasIndex | protocol::kClosedLoop;
    axis.travel_min_udeg = (lift ? -10 : -20) * unit;
    axis.travel_max_udeg = 160 * unit;
    axis.encoder_resolution_ndeg = 1'000;
    axis.max_speed_udeg_per_s = static_cast<std::uint32_t>(60 * unit);
    axis.max_acceleration_udeg_per_s2 = static_cast<std::uint32_t>(90 * unit);
  }
  return config;
}

}  // namespace celadon::test
