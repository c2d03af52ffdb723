#pragma once
// The whole firmware but for the board: a loop that never waits.

#include <cstdint>

#include "firmware_bridge/controller_core.h"
#include "firmware_bridge/firmware_example/modbus_slave.h"
#include "firmware_bridge/firmware_example/stepper_plant.h"

namespace celadon::example {

/// Identity and limits of the example's machine.
ControllerConfig machine_config(bool simulated);

class Firmware {
 public:
  /// @param boot_id differs from the last start's
  Firmware(const ControllerConfig& config, std::uint16_t boot_id, std::uint64_t now_us)
      : core_(config, plant_, boot_id, now_us), slave_(core_, 1) {}

  /// One turn of the loop: some microseconds of work, nothing that blocks.
  void run_once(std::uint64_t now_us);

 private:
  StepperPlant plant_;
  ControllerCore core_;
  ModbusSlave slave_;
  std::uint64_t next_step_us_ = 0;
};

}  // namespace celadon::example
