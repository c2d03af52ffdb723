// Every fault of the virtual scanner in every state of a scan, in lock-step with the scan service. Exit code 1 if a
// cell does not hold. Usage: fault_matrix [seed = 1] [only the orders that begin with this]
#include <spdlog/spdlog.h>

#include <cstdio>
#include <cstdlib>
#include <string>

#include "tests/integration/fault_matrix.h"

int main(int argc, char** argv) {
  using namespace celadon::testing;
  spdlog::set_level(spdlog::level::off);
  const auto seed = static_cast<std::uint64_t>(argc > 1 ? std::atoll(argv[1]) : 1);
  const std::string only = argc > 2 ? argv[2] : "", at = argc > 3 ? argv[3] : "";
  int tried = 0, held = 0;
  std::printf(
      "Outcome; milliseconds of device time from the fault to the laser's going out, where it shone and the scan\n"
      "failed; + the cause was named, - it was not; ! the cell did not hold.\n\n| fault |");
  for (const FaultMoment& moment : fault_moments()) std::printf(" %s |", moment.name);
  std::printf("\n|---|");
  for (std::size_t k = 0; k < fault_moments().size(); ++k) std::printf("---|");
  std::printf("\n");
  for (const FaultCase& fault : fault_cases()) {
    if (std::string(fault.order).rfind(only, 0) != 0) continue;
    std::printf("| %s |", fault.order);
    for (const FaultMoment& moment : fault_moments()) {
      if (std::string(moment.name).find(at) == std::string::npos) continue;
      const CellResult cell = try_cell(fault, moment, seed);
      ++tried;
      held += cell.bad.empty() ? 1 : 0;
      std::printf(" %s", cell.outcome.c_str());
      if (cell.dark_ms >= 0) std::printf(" %.0f", cell.dark_ms);
      if (cell.named == "yes") std::printf(" +");
      if (cell.named == "no") std::printf(" -");
      std::printf("%s |", cell.bad.empty() ? "" : " !");
      std::fflush(stdout);
      for (const std::string& what : cell.bad)
        std::fprintf(stderr, "%s, %s: %s\n", fault.order, moment.name, what.c_str());
    }
    std::printf("\n");
  }
  std::printf("\n%d cells tried, %d held.\n", tried, held);
  return held == tried ? 0 : 1;
}
