#include "firmware_bridge/firmware_example/stepper_plant.h"

#include "firmware_bridge/firmware_example/board.h"

namespace celadon::example {
namespace {

constexpr std::uint64_t kPeriod_us = 50;  // of the planner
constexpr std::int64_t kPeriodsPerSecond = 1'000'000 / kPeriod_us;
constexpr std::int64_t kMilli = 1'000;
constexpr std::int64_t kWholeStep = 1'000'000'000;
constexpr std::uint64_t kSettling_us = 50'000;
constexpr std::int64_t kSlowest = 50 * kMilli;  // no slower than that before the last step
constexpr std::uint32_t kHomingSpeed_udeg_per_s = 30'000'000, kHomingAcceleration_udeg_per_s2 = 90'000'000;

std::int64_t magnitude(std::int64_t value) {
  return value < 0 ? -value : value;
}

std::int64_t nearest_step(std::int64_t udeg) {
  const std::int64_t half = udeg < 0 ? -kUdegPerStep / 2 : kUdegPerStep / 2;
  return (udeg + half) / kUdegPerStep;
}

}  // namespace

void StepperPlant::advance(std::uint64_t now_us) {
  board::set_lamp(protocol::lamp_lit(lamp_, now_us));
  if (task_ == Task::none || task_ == Task::settle) {
    planned_us_ = now_us;
    if (task_ == Task::settle && now_us - standing_since_us_ >= kSettling_us) task_ = Task::none;
    return;
  }
  // What was missed is made up for, a period at a time.
  while (planned_us_ + kPeriod_us <= now_us) {
    planned_us_ += kPeriod_us;
    change_speed();
    way_ += magnitude(speed_) * (kWholeStep / kMilli) / kPeriodsPerSecond;
    if (way_ >= kWholeStep) {
      way_ -= kWholeStep;
      make_step();
    }
    if (task_ == Task::none || task_ == Task::settle) return;
  }
}

/// One period of the trapezoid: towards the target as fast as allowed, and never faster than can be stopped before it.
void StepperPlant::change_speed() {
  const bool stopping = task_ == Task::stop;
  const std::int64_t left = target_ - position_;
  const std::int64_t towards = left < 0 ? -1 : 1;
  const std::int64_t along = speed_ * towards;  // negative: away from the target
  // v^2 / 2a in steps: change_ millisteps/s a period are change_ * kPeriodsPerSecond millisteps/s^2.
  const std::int64_t stopping_steps = speed_ * speed_ / (2 * change_ * kPeriodsPerSecond * kMilli) + 1;
  if (stopping || along < 0 || stopping_steps >= magnitude(left)) {
    const std::int64_t least = stopping || along < 0 ? 0 : kSlowest;
    std::int64_t slower = magnitude(speed_) - change_;
    if (slower < least) slower = least;
    speed_ = along < 0 ? -towards * slower : towards * slower;
    if (stopping && slower == 0) end_motion();
    return;
  }
  std::int64_t faster = along + change_;
  if (faster > top_speed_) faster = along - change_ > top_speed_ ? along - change_ : top_speed_;
  speed_ = towards * faster;
}

void StepperPlant::make_step() {
  const bool forward = speed_ >= 0;
  board::step_motor(forward);
  position_ += forward ? 1 : -1;
  const bool seen = board::index_seen();
  if (task_ == Task::leave_index && !seen) {
    task_ = Task::seek_index;
    sought_from_ = position_;
  } else if (task_ == Task::seek_index && seen && !index_was_seen_) {
    // Its edge is position 0; the table runs past it and comes back.
    position_ = 0;
    homed_ = true;
    task_ = Task::move;
    target_ = 0;
  } else if (magnitude(position_ - sought_from_) > kStepsPerTurn + kStepsPerTurn / 8 &&
             (task_ == Task::seek_index || task_ == Task::leave_index)) {
    fault_ = FaultCode::homing_failed;
    task_ = Task::stop;
  }
  index_was_seen_ = seen;
  if (task_ == Task::move && position_ == target_ && magnitude(speed_) <= kSlowest + change_) end_motion();
}

void StepperPlant::end_motion() {
  speed_ = way_ = 0;
  task_ = Task::settle;
  standing_since_us_ = planned_us_;
}

PlantInputs StepperPlant::inputs(std::uint64_t) {
  PlantInputs in;
  in.interlock_closed = board::interlock_closed();
  in.emergency_stop = board::emergency_stop_pressed();
  in.button = board::button_down();
  in.lasers_measured = board::laser_emits() ? 1 : 0;
  return in;
}

AxisSample StepperPlant::axis(int, std::uint64_t now_us) {
  AxisSample sample;
  sample.time_us = now_us;
  sample.counter = ++samples_;
  sample.position_udeg = position_ * kUdegPerStep;
  sample.speed_udeg_per_s = static_cast<std::int32_t>(speed_ * kUdegPerStep / kMilli);
  sample.phase = task_ == Task::none     ? AxisPhase::standing
                 : task_ == Task::settle ? AxisPhase::settling
                                         : AxisPhase::moving;
  sample.index_found = homed_;
  sample.fault = fault_;
  return sample;
}

void StepperPlant::begin(Task task, std::int64_t target_steps, std::uint32_t speed, std::uint32_t acceleration,
                         std::uint64_t now_us) {
  if (!powered_) board::set_motor(true);
  powered_ = true;
  task_ = task;
  target_ = target_steps;
  top_speed_ = std::int64_t{speed} * kMilli / kUdegPerStep;
  change_ = std::int64_t{acceleration} * kMilli / kUdegPerStep / kPeriodsPerSecond;
  if (top_speed_ < kSlowest) top_speed_ = kSlowest;
  if (change_ < 1) change_ = 1;
  planned_us_ = now_us;
}

void StepperPlant::home(int, std::uint64_t now_us) {
  fault_ = FaultCode::none;
  homed_ = false;
  index_was_seen_ = board::index_seen();
  sought_from_ = position_;
  // Farther than it can be: a search ends at the index or by its own limit.
  begin(index_was_seen_ ? Task::leave_index : Task::seek_index, position_ + 2 * kStepsPerTurn, kHomingSpeed_udeg_per_s,
        kHomingAcceleration_udeg_per_s2, now_us);
}

void StepperPlant::move(int, std::int64_t target_udeg, std::uint32_t speed_udeg_per_s,
                        std::uint32_t acceleration_udeg_per_s2, std::uint32_t /*jerk_mdeg_per_s3*/,
                        std::uint64_t now_us) {
  begin(Task::move, nearest_step(target_udeg), speed_udeg_per_s, acceleration_udeg_per_s2, now_us);
  if (position_ == target_) end_motion();
}

void StepperPlant::stop(int, std::uint64_t) {
  if (task_ != Task::none && task_ != Task::settle) task_ = Task::stop;
}

void StepperPlant::release(int, std::uint64_t) {
  board::set_motor(false);
  powered_ = homed_ = false;
  if (task_ != Task::none) end_motion();
}

void StepperPlant::set_lasers(std::uint16_t mask, std::uint64_t) {
  board::set_laser((mask & 1) != 0);
}

void StepperPlant::set_lamp(LampPattern pattern, std::uint64_t) {
  lamp_ = pattern;
}

}  // namespace celadon::example
