#pragma once
// A drive of another maker in place of a controller: the controller's core runs here, on the host, in front of it.

#include <memory>
#include <string>

#include <tl/expected.hpp>

#include "firmware_bridge/clock.h"
#include "firmware_bridge/drive_profile.h"
#include "firmware_bridge/transport.h"

namespace celadon {

/// What turns a drive and an I/O device into one machine.
struct ForeignMachine {
  DriveProfile drive;
  IoProfile io;
  std::string serial;               ///< vendor, model and serial together name the machine in calibration files
  double steps_per_turn = 0;        ///< of the motor; 0: as the profile says
  double motor_turns_per_turn = 1;  ///< of the table; negative where the motor turns the other way
  double max_speed_deg_per_s = 0;   ///< of the table
  double max_acceleration_deg_per_s2 = 0;
  bool homes_at_mark = false;  ///< home() takes the place where the table stands for 0, an operator's mark
};

/// Something that answers as a controller does (PROTOCOL.md), made of a drive and an I/O device, so that everything
/// above is the same. States, refusals, leases and the lock after a start are ControllerCore's; what protects when this
/// process hangs or dies is the watchdog of the I/O device, whose time is the lease and heartbeat that it declares.
/// Position samples are stamped by this host, in the middle of the exchange that brought them, and say so.
/// @returns refused, before anything is written, where a register that motion or safety needs is not confirmed, where
/// lasers or the motor's enable go through nothing that has a watchdog, or where the speeds do not fit the registers
tl::expected<std::unique_ptr<Transport>, DeviceError> open_foreign_machine(const ForeignMachine& machine,
                                                                           std::unique_ptr<Transport> drive,
                                                                           std::unique_ptr<Transport> io, Clock& clock);

}  // namespace celadon
