#include "sim/turntable.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace celadon::sim {
namespace {

constexpr double kTwoPi = 2 * std::numbers::pi;
constexpr double kEccentric_rad = 0.8;  // where the encoder disc lies off its centre

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
  const Segment& s = segments_[i - 1];
  if (s.speed == 0 && s.acceleration == 0) return {s.position, 0, 0};
  const double t = seconds(now_ns - s.begin_ns);
  return {s.position + t * (s.speed + 0.5 * t * s.acceleration), s.speed + t * s.acceleration, s.acceleration};
}

// The table lags its motor by y, y'' + 2/tau y' + w0^2 y = motor's acceleration: the sum of the step responses to its
// jumps.
Turntable::State Turntable::deflection(std::int64_t now_ns) const {
  if (config_.damping_time_s <= 0) return {0, 0, 0};
  const double decay = 1 / config_.damping_time_s, w = kTwoPi * config_.resonance_hz,
               w0_squared = w * w + decay * decay;
  State y{settled_jolts_ / w0_squared, 0, 0};
  for (const auto& [at, jump] : jolts_) {
    if (now_ns <= at) continue;
    const double t = seconds(now_ns - at), e = std::exp(-decay * t), c = std::cos(w * t), s = std::sin(w * t);
    y.position += jump / w0_squared * (1 - e * (c + decay / w * s));
    y.speed += jump / w * e * s;
  }
  return y;
}

// Forgets what has died out; follows the play.
void Turntable::advance(std::int64_t now_ns) {
  const std::int64_t old = now_ns - 1'000'000'000 - static_cast<std::int64_t>(20e9 * config_.damping_time_s);
  while (segments_.size() > 1 && segments_[1].begin_ns <= old) segments_.erase(segments_.begin());
  while (!jolts_.empty() && jolts_.front().first <= old) {  // their oscillation is over
    settled_jolts_ += jolts_.front().second;
    jolts_.erase(jolts_.begin());
  }
  if (jolts_.empty()) settled_jolts_ = 0;  // rounding left over from jumps that cancel
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
  return angle + config_.encoder_eccentricity_rad * (std::sin(angle + kEccentric_rad) - std::sin(kEccentric_rad));
}

double Turntable::table_speed_rad_per_s(std::int64_t now_ns) {
  const double speed = gear_ * motor(now_ns).speed - deflection(now_ns).speed;
  if (config_.encoder_eccentricity_rad == 0) return speed;
  const double angle = after_backlash(motor(now_ns).position) - deflection(now_ns).position;
  return speed * (1 + config_.encoder_eccentricity_rad * std::cos(angle + kEccentric_rad));
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
  while (!jolts_.empty() && jolts_.back().first > now_ns) jolts_.pop_back();
  if (s.acceleration != 0) jolts_.emplace_back(now_ns, -s.acceleration);
  segments_.push_back({now_ns, s.position, s.speed, 0});
}

void Turntable::append(double duration_s, double acceleration) {
  Segment& last = segments_.back();
  const auto duration_ns = std::llround(duration_s * 1e9);
  last.acceleration = acceleration;
  const std::int64_t end = last.begin_ns + duration_ns;
  if (acceleration != 0) {
    jolts_.emplace_back(last.begin_ns, acceleration);
    jolts_.emplace_back(end, -acceleration);
  }
  const double t = duration_s;
  const Segment next{end, last.position + t * (last.speed + 0.5 * t * acceleration), last.speed + t * acceleration, 0};
  segments_.push_back(next);
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
  segments_.back() = {segments_.back().begin_ns, target, 0, 0};  // exactly there, exactly standing
}

void Turntable::move(double target_rad, double speed_rad_per_s, double acceleration_rad_per_s2, std::int64_t now_ns) {
  start(now_ns);
  if (blocked_) {
    stalled_ = true;
    return;
  }
  append_trapezoid(target_rad - encoder_offset_ - segments_.back().position, speed_rad_per_s, acceleration_rad_per_s2);
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
  segments_.back().speed = 0;
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
