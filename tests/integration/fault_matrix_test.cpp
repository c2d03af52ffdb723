// A sample of the fault matrix: every fault at one moment, drawn by seed. The whole: tools/campaign fault_matrix.

#include "tests/integration/fault_matrix.h"

#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <cstdio>
#include <random>

namespace celadon::testing {
namespace {

constexpr std::uint64_t kSeed = 20260517;

TEST(FaultMatrix, ASampleOfItsCellsHolds) {
  spdlog::set_level(spdlog::level::off);
  std::mt19937_64 random(kSeed);
  int tried = 0, held = 0;
  for (const FaultCase& fault : fault_cases()) {
    // Mostly those that need the machine.
    const std::uint64_t drawn = random();
    const FaultMoment& moment = fault_moments()[drawn % 8 < 7 ? drawn / 8 % 7 : 7 + drawn / 8 % 2];
    const CellResult cell = try_cell(fault, moment, kSeed);
    ++tried;
    held += cell.bad.empty() ? 1 : 0;
    std::printf("%-28s %-26s %s%s\n", fault.order, moment.name, cell.outcome.c_str(),
                cell.named == "yes" ? ", named" : "");
    for (const std::string& what : cell.bad) ADD_FAILURE() << fault.order << ", " << moment.name << ": " << what;
  }
  std::printf("%d cells tried, %d held.\n", tried, held);
}

}  // namespace
}  // namespace celadon::testing
