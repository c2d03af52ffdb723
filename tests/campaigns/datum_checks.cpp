// Faults that a scan may not see in its object, with one laser and two, with and without the datum: which check names
// them. Usage: datum_checks [profiles = 400]
#include <cstdio>
#include <cstdlib>
#include <string>

#include "tests/integration/self_check_cells.h"

int main(int argc, char** argv) {
  using namespace celadon::testing;
  const int profiles = argc > 1 ? std::atoi(argv[1]) : 400;
  constexpr CheckedFault kFaults[] = {{"", "none"},
                                      {"calibration laser-moved", "laser moved by 0.3 mm"},
                                      {"camera-nudge 0.2", "camera turned by 0.2 degrees"},
                                      {"calibration lasers-swapped", "lasers swapped"},
                                      {"steps-wrong 1.01", "steps per turn wrong by 1 %"},
                                      {"calibration frames-late", "frames late by 4 ms"}};
  constexpr const char* kObjects[] = {"cylinder", "cylinder-off", "humidifier"};
  std::printf(
      "Checks that failed. \"-\": none did; then what could not be verified stands in brackets.\n\n"
      "| fault | lasers | datum |");
  for (const char* object : kObjects) std::printf(" %s |", object);
  std::printf("\n|---|---|---|---|---|---|\n");
  int cells = 0, named = 0, open = 0, wrong = 0;
  for (const CheckedFault& fault : kFaults) {
    for (const int lasers : {1, 2}) {
      if (lasers == 1 && std::string(fault.order).ends_with("swapped")) continue;
      for (const bool datum : {false, true}) {
        std::printf("| %s | %d | %s |", fault.name, lasers, datum ? "with" : "without");
        for (const char* object : kObjects) {
          const CheckedCell cell = try_self_checks(object, fault.order, 1, profiles, {lasers, datum});
          const std::string failed = cell.names_of("failed"), unknown = cell.names_of("not verifiable");
          ++cells;
          const bool sound = std::string(fault.order).empty();
          if (cell.exit_code > 1) {
            std::printf(" no scan: %s |", cell.err.substr(0, cell.err.find('\n')).c_str());
            ++named;
          } else {
            std::printf(" %s%s |", failed.empty() ? "-" : failed.c_str(),
                        failed.empty() ? (" (" + unknown + ")").c_str() : "");
            if (!failed.empty() == !sound) {
              ++named;
            } else if (!sound && !unknown.empty()) {
              ++open;
            } else {
              ++wrong;
            }
          }
          std::fflush(stdout);
          for (const auto& check : cell.checks)
            std::fprintf(stderr, "%s, %s, %d, %d: %s\n", fault.order, object, lasers, datum, check.dump().c_str());
        }
        std::printf("\n");
      }
    }
  }
  std::printf("\n%d cells: %d as they should be, %d not verifiable, %d wrong.\n", cells, named, open, wrong);
  return wrong == 0 ? 0 : 1;
}
