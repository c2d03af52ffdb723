#include "sim/travel_axis.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace celadon::sim {
namespace {

constexpr std::int64_t kRemembered_ns = 10'000'000;  // of a plan that was replaced: samples are up to 1 ms old

}  // namespace

TravelAxisConfig elevation_drive() {
  constexpr double kDegree = std::numbers::pi / 180;
  TravelAxisConfig c;
  c.lowest = -10 * kDegree;
  c.highest = 70 * kDegree;
  c.beyond = 2 * kDegree;
  c.max_speed = 30 * kDegree;
  c.max_acceleration = 60 * kDegree;
  c.homing_speed = 15 * kDegree;
  c.quantum = 0.001 * kDegree;
  return c;
}

TravelAxisConfig lift_drive() {
  TravelAxisConfig c;
  c.lowest = -150;
  c.highest = 150;
  c.beyond = 5;
  c.max_speed = 40;
  c.max_acceleration = 100;
  c.homing_speed = 20;
  c.quantum = 0.005;
  return c;
}

TravelAxis::TravelAxis(const TravelAxisConfig& config)
    : config_(config), segments_{{INT64_MIN / 2, config.start, 0, 0}}, encoder_offset_(-config.start) {}

TravelAxis::Segment TravelAxis::after(const Segment& s, std::int64_t now_ns) {
  if (s.speed == 0 && s.acceleration == 0) return {now_ns, s.position, 0, 0};
  const double t = static_cast<double>(now_ns - s.begin_ns) * 1e-9;
  return {now_ns, s.position + t * (s.speed + t * s.acceleration / 2), s.speed + t * s.acceleration, s.acceleration};
}

TravelAxis::Segment TravelAxis::state(std::int64_t now_ns) const {
  std::size_t i = segments_.size();
  while (i > 1 && segments_[i - 1].begin_ns > now_ns) --i;
  return after(segments_[i - 1], now_ns);
}

// A hard end stops it at once; a homing that has come to its end counts from there.
void TravelAxis::advance(std::int64_t now_ns) {
  const double at = state(now_ns).position;
  const double inside = std::clamp(at, config_.lowest - config_.beyond, config_.highest + config_.beyond);
  if (at != inside) {
    halt(now_ns, inside);
    at_end_ = true;
  }
  if (homing_ && now_ns >= end_ns()) {
    homing_ = false;
    homed_ = true;
    encoder_offset_ = 0;
  }
}

double TravelAxis::position(std::int64_t now_ns) {
  advance(now_ns);
  return state(now_ns).position;
}

double TravelAxis::speed(std::int64_t now_ns) {
  advance(now_ns);
  return state(now_ns).speed;
}

double TravelAxis::encoder(std::int64_t now_ns) {
  return std::round((position(now_ns) + encoder_offset_) / config_.quantum) * config_.quantum;
}

TravelAxis::Phase TravelAxis::phase(std::int64_t now_ns) {
  advance(now_ns);
  if (now_ns < end_ns()) return Phase::moving;
  const bool settles =
      segments_.size() > 1 && now_ns < end_ns() + static_cast<std::int64_t>(config_.settle_time_s * 1e9);
  return settles ? Phase::settling : Phase::standing;
}

bool TravelAxis::index_found(std::int64_t now_ns) {
  advance(now_ns);
  return homed_;
}

// Cuts the plan at this instant. @returns whether the axis can move
bool TravelAxis::start(std::int64_t now_ns) {
  advance(now_ns);
  const Segment s = state(now_ns);
  while (segments_.size() > 1 && segments_.back().begin_ns >= now_ns) segments_.pop_back();
  while (segments_.size() > 1 && segments_[1].begin_ns < now_ns - kRemembered_ns) segments_.erase(segments_.begin());
  homing_ = false;
  segments_.push_back({now_ns, s.position, s.speed, 0});
  stalled_ = stalled_ || blocked_;
  return !blocked_;
}

void TravelAxis::append(double duration_s, double acceleration) {
  Segment& last = segments_.back();
  last.acceleration = acceleration;
  Segment next = after(last, last.begin_ns + std::llround(duration_s * 1e9));
  next.acceleration = 0;
  segments_.push_back(next);
}

// Exactly there, exactly standing, from the end of the plan on.
void TravelAxis::stand_at(double position) {
  segments_.back() = {segments_.back().begin_ns, position, 0, 0};
}

void TravelAxis::halt(std::int64_t now_ns, double position) {
  while (segments_.size() > 1 && segments_.back().begin_ns >= now_ns) segments_.pop_back();
  segments_.push_back({now_ns, position, 0, 0});
  homing_ = false;
}

// From standing over a distance: up, along, down; a triangle if it is short.
void TravelAxis::append_trapezoid(double distance, double speed, double acceleration) {
  if (distance == 0) return;
  const double sign = distance < 0 ? -1 : 1, length = std::abs(distance), target = segments_.back().position + distance;
  const double peak = std::min(speed, std::sqrt(length * acceleration));
  const double ramp = peak / acceleration, along = std::max(0.0, length / peak - ramp);
  append(ramp, sign * acceleration);
  if (along > 0) append(along, 0);
  append(ramp, -sign * acceleration);
  stand_at(target);
}

void TravelAxis::move(double target, double speed, double acceleration, std::int64_t now_ns) {
  if (!start(now_ns)) return;
  append_trapezoid(target - encoder_offset_ - segments_.back().position, speed, acceleration);
}

void TravelAxis::home(std::int64_t now_ns) {
  homed_ = false;
  if (!start(now_ns)) return;
  const double v = config_.homing_speed, a = config_.max_acceleration, overrun = v * v / (2 * a);
  // The mark is left downwards at full speed, then met upwards and slowly: always from the same side.
  const double at = segments_.back().position;
  append_trapezoid(-overrun - at, v, a);
  append_trapezoid(-segments_.back().position, 0.25 * v, a);
  stand_at(0);
  homing_ = true;
}

void TravelAxis::stop(std::int64_t now_ns) {
  if (now_ns >= end_ns()) return;
  (void)start(now_ns);
  const double v = segments_.back().speed, a = config_.max_acceleration;
  if (v == 0) return;
  append(std::abs(v) / a, v > 0 ? -a : a);
  stand_at(segments_.back().position);
}

void TravelAxis::release(std::int64_t now_ns) {
  stop(now_ns);
  at_end_ = false;
}

void TravelAxis::block(bool blocked, std::int64_t now_ns) {
  advance(now_ns);
  blocked_ = blocked;
  if (!blocked || now_ns >= end_ns()) return;
  halt(now_ns, state(now_ns).position);
  stalled_ = true;
}

void TravelAxis::shift(double by, std::int64_t now_ns) {
  advance(now_ns);
  for (Segment& segment : segments_) segment.position += by;
}

}  // namespace celadon::sim
