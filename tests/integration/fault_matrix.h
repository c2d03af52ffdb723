#pragma once
// Every fault of the virtual scanner in every state of a scan: what becomes of the scan, of laser and motor, of what
// was measured already, and of the next scan. Virtual scanner and scan service in one process, in lock-step.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace celadon::testing {

struct FaultCase {
  const char* order;  ///< NAME [ARGUMENT], as the control socket takes it
  enum class Known : std::uint8_t {
    named,   ///< the device can know it: a scan that needs the machine ends and names it, or is warned of it
    passes,  ///< the device can know it, but a scan may go on without a word: it was made good
    no       ///< only a measurement reveals it: injected and recorded
  } known;
  std::vector<std::string> names;  ///< one of these words names it
  bool never_continues = false;    ///< nothing goes on after it without a person or a new command
  bool breaks_link = false;        ///< the host cannot reach the controller: the lease ends the laser
  bool serial = false;             ///< over RTU
  bool homing_heals = false;       ///< the index makes it good
};
std::span<const FaultCase> fault_cases();

struct FaultMoment {
  const char* name;   ///< scan state and what happens in it
  const char* state;  ///< at whose beginning the order is given; empty: before the scan
  const char* when;   ///< of the order, e.g. "angle 90"
  bool machine_in_use = true, profiles_taken = false, step = false;
};
std::span<const FaultMoment> fault_moments();

struct CellResult {
  std::string outcome;  ///< done, continued (with a warning or losses), failed, cancelled, refused
  std::string reason;   ///< of its end, or its warnings
  double dark_ms =
      -1;  ///< device time from the fault to the laser's going out; -1: it was out, or the scan ended as usual
  std::string named;             ///< "yes", "no", or "-": there was nothing to name
  std::vector<std::string> bad;  ///< what did not hold; empty: all did
};

/// One cell on a new machine and a new service.
CellResult try_cell(const FaultCase& fault, const FaultMoment& moment, std::uint64_t seed);

}  // namespace celadon::testing
