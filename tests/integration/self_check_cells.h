#pragma once
// Which faults of the virtual scanner a scan finds out about by itself, object by object; daemon, simulator and command
// line as processes.

#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <string>

namespace celadon::testing {

struct CheckedObject {
  const char* scene;
  const char* what;
};
std::span<const CheckedObject> checked_objects();

struct CheckedFault {
  const char* order;  ///< NAME ARGUMENT [when], as the control socket takes it; empty: none
  const char* name;
};
std::span<const CheckedFault> checked_faults();

struct CheckedCell {
  int exit_code = -1;
  nlohmann::json checks;  ///< of the report
  std::string out, err;
  /// "passed", "failed", "not verifiable"; "-": there is no such check.
  std::string verdict(const std::string& check) const;
  /// Names of those of a verdict, in their order, with blanks between; the eccentricity, which is never verified,
  /// apart.
  std::string names_of(const std::string& verdict) const;
};

struct CheckedMachine {
  int lasers = 1;
  bool datum = false;  ///< with fiducials on the platter's rim, in light that shows them
};

/// One scan on a new machine. @param order of a fault, before the scan begins; "calibration WHAT" changes what the
/// daemon believes instead: laser-moved, lasers-swapped, frames-late
CheckedCell try_self_checks(const std::string& scene, const std::string& order, std::uint64_t seed, int profiles,
                            const CheckedMachine& machine = {});

}  // namespace celadon::testing
