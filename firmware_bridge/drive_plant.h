#pragma once
// Motor, lasers and inputs behind a drive and an I/O device: what the core wants is kept and carried out by exchanges
// that may fail and are then repeated.

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "firmware_bridge/clock.h"
#include "firmware_bridge/controller_core.h"
#include "firmware_bridge/foreign_drive.h"
#include "firmware_bridge/transport.h"

namespace celadon {

class DrivePlant final : public Plant {
 public:
  /// @pre the machine was checked by open_foreign_machine
  DrivePlant(const ForeignMachine& machine, Transport& drive, Transport& io, Clock& clock);

  /// Time since it was made: the core's clock.
  std::uint64_t now_us() { return static_cast<std::uint64_t>((clock_.now_ns() - start_ns_) / 1000); }

  // Exchanges. Outputs go first, so that a laser or motor that must be off never waits for a drive.
  /// Writes the outputs, which feeds the watchdog, and reads the inputs.
  tl::expected<void, LinkError> observe_inputs();
  /// Position, state and alarm of the drive.
  tl::expected<void, LinkError> observe_drive();
  /// What the core asked for since: outputs, stop, release, reset, then a motion that waits for the drive to be ready.
  tl::expected<void, LinkError> carry_out();
  /// Reads one register's time. @pre its unit is ms
  tl::expected<double, LinkError> read_time_ms(const DriveRegister& r, WordOrder order, Transport& from);

  void reset_alarm();  ///< at the next carry_out()
  /// Of the drive's newest alarm; empty without one.
  std::string alarm_text(std::uint16_t code) const;

  // Plant: they only note what is wanted.
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
  enum class Motion : std::uint8_t {
    none,
    wanted,   ///< not sent yet: the drive is not ready, or the exchange failed
    sent,     ///< and not yet seen moving
    running,  ///< seen moving
    settling
  };
  struct Values {
    std::int64_t target = 0, speed = 0, acceleration = 0;  ///< counts of their registers
  };

  tl::expected<void, LinkError> exchanged(tl::expected<void, LinkError> result) const;
  tl::expected<void, LinkError> run(const DriveAction& action);
  tl::expected<void, LinkError> write_outputs();
  tl::expected<void, LinkError> begin_motion();
  bool holds(const DriveCondition& condition) const;
  bool holds_input(const DriveCondition& condition) const;
  std::int64_t count(std::size_t reg) const { return counts_[reg]; }
  std::uint32_t outputs_now() const;
  void follow_motion(std::uint64_t now_us);
  double udeg_per_step() const { return udeg_per_step_; }

  const ForeignMachine machine_;
  Transport& drive_;
  Transport& io_;
  Clock& clock_;
  const std::int64_t start_ns_;
  const double steps_per_turn_;  ///< of the motor
  const double udeg_per_step_;   ///< of the table, signed
  const std::vector<RegisterBlock> drive_blocks_, io_blocks_;

  std::vector<std::int64_t> counts_, io_counts_;  ///< newest, by register
  AxisSample sample_;

  std::uint16_t lasers_ = 0;
  LampPattern lamp_ = LampPattern::off;
  bool motor_enabled_ = false;
  std::optional<std::uint32_t> outputs_written_;

  bool stop_wanted_ = false, release_wanted_ = false, reset_wanted_ = false;
  Motion motion_ = Motion::none;
  bool homing_ = false, enable_sent_ = false;
  bool lost_ = false;  ///< never became ready, or lost its torque on the way: a fault until reset_alarm()
  std::uint64_t motion_since_us_ = 0;  ///< of its present stage
  Values values_;
};

}  // namespace celadon
