#pragma once
// A turntable on a stepper motor with an index: the machine below the controller core. It plans the trapezoid and finds
// the index; every decision is the core's.

#include <cstdint>

#include "firmware_bridge/controller_core.h"

namespace celadon::example {

/// 200 full steps, 16 microsteps, a belt of 1 : 10.
inline constexpr std::int64_t kStepsPerTurn = 32'000;
inline constexpr std::int64_t kUdegPerStep = protocol::kTurn_udeg / kStepsPerTurn;
static_assert(kUdegPerStep * kStepsPerTurn == protocol::kTurn_udeg);

class StepperPlant final : public Plant {
 public:
  /// Makes the steps that are due. Call it as often as possible: a step is late by at most the time between two calls.
  void advance(std::uint64_t now_us);

  PlantInputs inputs(std::uint64_t now_us) override;
  AxisSample axis(int axis, std::uint64_t now_us) override;
  void home(int axis, std::uint64_t now_us) override;
  void move(int axis, std::int64_t target_udeg, std::uint32_t speed_udeg_per_s, std::uint32_t acceleration_udeg_per_s2,
            std::uint32_t jerk_mdeg_per_s3, std::uint64_t now_us) override;
  void stop(int axis, std::uint64_t now_us) override;
  void release(int axis, std::uint64_t now_us) override;
  void set_lasers(std::uint16_t mask, std::uint64_t now_us) override;
  void set_lamp(LampPattern pattern, std::uint64_t now_us) override;

 private:
  enum class Task : std::uint8_t { none, move, stop, leave_index, seek_index, settle };

  void begin(Task task, std::int64_t target_steps, std::uint32_t speed, std::uint32_t acceleration,
             std::uint64_t now_us);
  void change_speed();
  void make_step();
  void end_motion();

  Task task_ = Task::none;
  bool powered_ = false, homed_ = false;
  bool index_was_seen_ = false;
  FaultCode fault_ = FaultCode::none;
  LampPattern lamp_ = LampPattern::off;

  std::int64_t position_ = 0, target_ = 0;  ///< steps
  std::int64_t sought_from_ = 0;
  // Speeds in millisteps a second, so that one period of the planner changes them by a whole number.
  std::int64_t speed_ = 0, top_speed_ = 0, change_ = 1;  ///< speed_ is signed; change_ in one period
  std::int64_t way_ = 0;                                 ///< towards the next step, in units of 1e-9 step
  std::uint64_t planned_us_ = 0, standing_since_us_ = 0;
  std::uint32_t samples_ = 0;
};

}  // namespace celadon::example
