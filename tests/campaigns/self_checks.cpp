// Faults of the virtual scanner against objects: which self-checks of a scan fail; and scans without a fault, of which
// none may. Exit code 1 where one does. Usage: self_checks [seeds = 12] [profiles = 400]
#include <cstdio>
#include <cstdlib>

#include "tests/integration/self_check_cells.h"

int main(int argc, char** argv) {
  using namespace celadon::testing;
  const int seeds = argc > 1 ? std::atoi(argv[1]) : 12, profiles = argc > 2 ? std::atoi(argv[2]) : 400;
  std::printf("Checks that failed; \"-\": none did. In brackets: not verifiable.\n\n| fault |");
  for (const CheckedObject& object : checked_objects()) std::printf(" %s (%s) |", object.scene, object.what);
  std::printf("\n|---|");
  for (std::size_t k = 0; k < checked_objects().size(); ++k) std::printf("---|");
  std::printf("\n");
  for (const CheckedFault& fault : checked_faults()) {
    std::printf("| %s |", fault.name);
    for (const CheckedObject& object : checked_objects()) {
      const CheckedCell cell = try_self_checks(object.scene, fault.order, 1, profiles);
      const std::string failed = cell.names_of("failed"), unknown = cell.names_of("not verifiable");
      std::printf(" %s%s |",
                  cell.exit_code > 1 ? "NO SCAN"
                  : failed.empty()   ? "-"
                                     : failed.c_str(),
                  unknown.empty() ? "" : (" (" + unknown + ")").c_str());
      std::fflush(stdout);
      for (const auto& check : cell.checks)
        std::fprintf(stderr, "%s, %s: %s\n", fault.order, object.scene, check.dump().c_str());
      if (cell.exit_code > 1) std::fprintf(stderr, "%s\n", cell.err.c_str());
    }
    std::printf("\n");
  }
  int scans = 0, alarms = 0;
  for (int seed = 1; seed <= seeds; ++seed) {
    for (const CheckedObject& object : checked_objects()) {
      const CheckedCell cell = try_self_checks(object.scene, "", static_cast<std::uint64_t>(seed), profiles);
      ++scans;
      if (cell.exit_code == 0 && !cell.checks.empty()) continue;
      ++alarms;
      std::printf("seed %d, %s: %s%s\n", seed, object.scene, cell.names_of("failed").c_str(), cell.err.c_str());
      std::fflush(stdout);
    }
  }
  std::printf("\n%d scans without a fault, %d alarms.\n", scans, alarms);
  return alarms == 0 ? 0 : 1;
}
