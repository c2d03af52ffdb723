#include "sim/turntable.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace celadon::sim {
namespace {

constexpr double kTwoPi = 2 * std::numbers::pi;

double seconds(std::int64_t ns) {
  return static_cast<double>(ns) * 1e-9;
}

}  // namespace

Turntable::Turntable(const TurntableConfig& config) : config_(config) {
  segments_.push_back({INT64_MIN / 2, config.start_angle_rad, 0, 0});
  encoder_offset_ = -config.start_angle_rad;  // counts from 0 at power-on, wherever the table stands
}

double Turntable::encoder_quantum_rad() const {
  return kTwoPi / config_.encoder_counts;
}

Turntable::State Turntable::motor(std::int64_t now_ns) const {
  std::size_t i = segments_.size();
  while (i > 1 && segments_[i - 1].begin_ns > now_ns) --i;
  return after(segments_[i - 1], now_ns);
}

Turntable::State Turntable::after(const Segment& s, std::int64_t now_ns) const {
  if (s.speed == 0 && s.acceleration == 0 && s.jerk == 0) return {s.position, 0, 0};
  const double t = seconds(now_ns - s.begin_ns);
  return {s.position + t * (s.speed + t * (s.acceleration / 2 + t * s.jerk / 6)),
          s.speed + t * (s.acceleration + t * s.jerk / 2), s.acceleration + t * s.jerk};
}

// The table lags its motor by y, y'' + 2 d y' + w0^2 y = motor's acceleration: the sum of the step responses to the
// jumps of that, s(t) = (1 - exp(-d t) (cos wt + d/w sin wt)) / w0^2, and of their integrals for the jumps of its
// slope.
Turntable::State Turntable::deflection(std::int64_t now_ns) const {
  if (config_.damping_time_s <= 0) return {0, 0, 0};
  const double d = 1 / config_.damping_time_s, w = kTwoPi * config_.resonance_hz, w0_squared = w * w + d * d;
  State y{settled_jolts_ / w0_squared, 0, 0};
  const auto each = [&](const std::vector<Change>& changes, auto add) {
    for (const Change& change : changes) {
      if (now_ns <= change.at_ns) continue;
      const double t = seconds(now_ns - change.at_ns), e = std::exp(-d * t);
      add(change.by, t, e * std::cos(w * t), e * std::sin(w * t));
    }
  };
  each(jolts_, [&](double by, double, double c, double s) {
    y.position += by / w0_squared * (1 - c - d / w * s);
    y.speed += by / w * s;
  });
  each(ramps_, [&](double by, double t, double c, double s) {
    y.position += by / w0_squared * (t - (2 * d - 2 * d * c + (w - d * d / w) * s) / w0_squared);
    y.speed += by / w0_squared * (1 - c - d / w * s);
  });
  return y;
}

// Forgets what has died out; follows the play.
void Turntable::advance(std::int64_t now_ns) {
  const std::int64_t old = now_ns - 1'000'000'000 - static_cast<std::int64_t>(20e9 * config_.damping_time_s);
  while (segments_.size() > 1 && segments_[1].begin_ns <= old) segments_.erase(segments_.begin());
  while (!jolts_.empty() && jolts_.front().at_ns <= old) {  // their oscillation is over
    settled_jolts_ += jolts_.front().by;
    jolts_.erase(jolts_.begin());
  }
  // Slopes end before they are forgotten; what they leave is an acceleration.
  if (!ramps_.empty() && ramps_.back().at_ns <= old) {
    for (const Change& ramp : ramps_) settled_jolts_ += ramp.by * seconds(ramps_.back().at_ns - ramp.at_ns);
    ramps_.clear();
  }
  if (jolts_.empty() && ramps_.empty()) settled_jolts_ = 0;  // rounding left over from changes that cancel
  if (homing_ && now_ns >= end_ns()) {
    homing_ = false;
    homed_ = true;
    encoder_offset_ = -pending_zero_;
  }
  if (config_.backlash_rad > 0) {
    // The table is dragged along once the play is used up.
    const double speed = motor(now_ns).speed, half = 0.5 * config_.backlash_rad;
    if (speed > 0) play_ = -half;
    if (speed < 0) play_ = half;
  }
}

double Turntable::after_backlash(double motor_rad) const {
  return motor_rad * gear_ + slip_ + play_;
}

double Turntable::table_angle_rad(std::int64_t now_ns) {
  advance(now_ns);
  const double angle = after_backlash(motor(now_ns).position) - deflection(now_ns).position;
  if (config_.encoder_eccentricity_rad == 0) return angle;
  return angle +
         config_.encoder_eccentricity_rad * (std::sin(angle + kEccentricPhase_rad) - std::sin(kEccentricPhase_rad));
}

double Turntable::table_speed_rad_per_s(std::int64_t now_ns) {
  const double speed = gear_ * motor(now_ns).speed - deflection(now_ns).speed;
  if (config_.encoder_eccentricity_rad == 0) return speed;
  const double angle = after_backlash(motor(now_ns).position) - deflection(now_ns).position;
  return speed * (1 + config_.encoder_eccentricity_rad * std::cos(angle + kEccentricPhase_rad));
}

double Turntable::encoder_rad(std::int64_t now_ns) {
  advance(now_ns);
  // A stiff motor shaft with the encoder on the table's flange: it sees the oscillation, not the play.
  const double position = motor(now_ns).position - deflection(now_ns).position + encoder_offset_;
  return std::floor(position / encoder_quantum_rad() + 0.5) * encoder_quantum_rad();
}

double Turntable::encoder_speed_rad_per_s(std::int64_t now_ns) {
  return motor(now_ns).speed - deflection(now_ns).speed;
}

Turntable::Phase Turntable::phase(std::int64_t now_ns) {
  if (now_ns < end_ns()) return Phase::moving;
  const bool moved = segments_.size() > 1;
  return moved && now_ns < end_ns() + static_cast<std::int64_t>(config_.settle_time_s * 1e9) ? Phase::settling
                                                                                             : Phase::standing;
}

bool Turntable::index_found(std::int64_t now_ns) {
  advance(now_ns);
  return homed_;
}

// A new plan begins: the motion up to now stays known for pictures whose exposure began earlier.
void Turntable::start(std::int64_t now_ns) {
  advance(now_ns);
  const State s = motor(now_ns);
  while (segments_.size() > 1 && segments_.back().begin_ns >= now_ns) segments_.pop_back();
  double jerk = 0;
  for (std::vector<Change>* changes : {&jolts_, &ramps_}) {
    while (!changes->empty() && changes->back().at_ns > now_ns) changes->pop_back();
  }
  for (const Change& ramp : ramps_) jerk += ramp.by;
  if (s.acceleration != 0) jolts_.push_back({now_ns, -s.acceleration});
  if (jerk != 0) ramps_.push_back({now_ns, -jerk});
  segments_.push_back({now_ns, s.position, s.speed, 0});
}

void Turntable::append(double duration_s, double acceleration, double jerk) {
  Segment& last = segments_.back();
  const double jump = acceleration - last.acceleration;
  const std::int64_t end = last.begin_ns + std::llround(duration_s * 1e9);
  last.acceleration = acceleration;
  last.jerk = jerk;
  if (jump != 0) jolts_.push_back({last.begin_ns, jump});
  if (jerk != 0) {
    ramps_.push_back({last.begin_ns, jerk});
    ramps_.push_back({end, -jerk});
  }
  const State next = after(last, end);
  segments_.push_back({end, next.position, next.speed, next.acceleration});
}

// Exactly there, exactly standing, from the end of the plan on.
void Turntable::stand_at(double position) {
  Segment& last = segments_.back();
  if (last.acceleration != 0) jolts_.push_back({last.begin_ns, -last.acceleration});
  last = {last.begin_ns, position, 0, 0};
}

// From standing over a distance: up, along, down; a triangle if it is short.
void Turntable::append_trapezoid(double distance, double speed, double acceleration) {
  if (distance == 0) return;
  const double sign = distance < 0 ? -1 : 1, length = std::abs(distance), target = segments_.back().position + distance;
  const double peak = std::min(speed, std::sqrt(length * acceleration));
  const double ramp = peak / acceleration, along = std::max(0.0, length / peak - ramp);
  append(ramp, sign * acceleration);
  if (along > 0) append(along, 0);
  append(ramp, -sign * acceleration);
  stand_at(target);
}

// From standing over a distance: the acceleration rises and falls with the jerk; a short way reaches neither the speed
// nor, shorter still, the acceleration.
void Turntable::append_s_curve(double distance, double speed, double acceleration, double jerk) {
  if (distance == 0) return;
  const double sign = distance < 0 ? -1 : 1, length = std::abs(distance), target = segments_.back().position + distance;
  // Rising takes `rise`, getting to speed `ramp` = 2 rise + the time at the greatest acceleration.
  double rise = speed * jerk >= acceleration * acceleration ? acceleration / jerk : std::sqrt(speed / jerk);
  double ramp = rise + speed / (jerk * rise);
  double along = length / speed - ramp;
  if (along < 0) {
    along = 0;
    rise = acceleration / jerk;
    ramp = 0.5 * rise + std::sqrt(0.25 * rise * rise + length / acceleration);
    if (ramp < 2 * rise) {
      rise = std::cbrt(0.5 * length / jerk);
      ramp = 2 * rise;
    }
  }
  const double top = sign * jerk * rise, slope = sign * jerk, flat = ramp - 2 * rise;
  append(rise, 0, slope);
  if (flat > 0) append(flat, top);
  append(rise, top, -slope);
  if (along > 0) append(along, 0);
  append(rise, 0, -slope);
  if (flat > 0) append(flat, -top);
  append(rise, -top, slope);
  stand_at(target);
}

void Turntable::move(double target_rad, double speed_rad_per_s, double acceleration_rad_per_s2, std::int64_t now_ns,
                     double jerk_rad_per_s3) {
  start(now_ns);
  if (blocked_) {
    stalled_ = true;
    return;
  }
  const double distance = target_rad - encoder_offset_ - segments_.back().position;
  if (jerk_rad_per_s3 > 0) {
    append_s_curve(distance, speed_rad_per_s, acceleration_rad_per_s2, jerk_rad_per_s3);
  } else {
    append_trapezoid(distance, speed_rad_per_s, acceleration_rad_per_s2);
  }
}

void Turntable::home(std::int64_t now_ns) {
  start(now_ns);
  decelerate();
  homed_ = false;
  if (blocked_) {
    stalled_ = true;
    return;
  }
  homing_ = true;
  const double at = segments_.back().position;
  const double v = config_.homing_speed_rad_per_s, a = config_.homing_acceleration_rad_per_s2;
  const double overrun = 0.5 * v * v / a;
  // Forwards until the mark has passed at full speed, then back onto it.
  pending_zero_ = std::ceil((at + overrun) / kTwoPi) * kTwoPi;
  append_trapezoid(pending_zero_ + overrun - at, v, a);
  append_trapezoid(-overrun, 0.25 * v, a);
  segments_.back().position = pending_zero_;
}

void Turntable::stop(std::int64_t now_ns) {
  if (now_ns >= end_ns()) return;
  start(now_ns);
  homing_ = false;
  decelerate();
}

// Appends the way from the present speed to standing.
void Turntable::decelerate() {
  const double v = segments_.back().speed, a = config_.max_acceleration_rad_per_s2;
  if (v == 0) return;
  append(std::abs(v) / a, v > 0 ? -a : a);
  stand_at(segments_.back().position);
}

void Turntable::set_gear_error(double factor, std::int64_t now_ns) {
  // The table stays where it is: only what it turns from now on is wrong.
  slip_ += (gear_ - factor) * motor(now_ns).position;
  gear_ = factor;
}

void Turntable::set_backlash(double play_rad) {
  config_.backlash_rad = play_rad;
  play_ = 0;
}

void Turntable::block(bool blocked, std::int64_t now_ns) {
  blocked_ = blocked;
  if (!blocked || now_ns >= end_ns()) return;
  start(now_ns);
  segments_.back().speed = 0;
  homing_ = false;
  stalled_ = true;
}

}  // namespace celadon::sim
