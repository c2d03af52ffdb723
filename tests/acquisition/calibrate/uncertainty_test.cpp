// What a calibration says of its own numbers, against errors to the truth over many seeds: README.md, (8) to (10).

#include <gtest/gtest.h>

#include "tests/acquisition/calibrate/error_blocks.h"

namespace celadon {
namespace {

// Equations (8), (9) and (10): 25 board views, 40 laser views, 72 views on the platter, seen 40 times.
TEST(CalibrationUncertainty, CoversTheErrorsOfEveryBlock) {
  constexpr int kSeeds = 40;
  test::ErrorBlocks errors;
  for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
    test::TrueMachine machine;
    const auto solution =
        solve_calibration(test::seen_with_measured_print(machine, seed, 2e-4, {.line_step_mm = 0.56}));
    ASSERT_TRUE(solution) << solution.error();
    EXPECT_EQ(solution->verdict, Verdict::good) << "seed " << seed;
    EXPECT_TRUE(solution->left_out.empty()) << "seed " << seed;
    errors.add(*solution, machine);
  }
  for (const test::ErrorBlock& block : errors.blocks()) {
    SCOPED_TRACE(block.name);
    EXPECT_GT(block.chi_square, block.lowest());
    EXPECT_LT(block.chi_square, block.highest());
    EXPECT_GT(block.ratio(), 1 / 1.3);
    EXPECT_LT(block.ratio(), 1.3);
  }
  EXPECT_EQ(errors.blocks().size(), 13u);
  // A radius' stated uncertainty is the largest over the volume: it covers, and is not idle either.
  EXPECT_LT(errors.radius_rms(), 1.1 * errors.systematic_rms());
  EXPECT_GT(errors.radius_rms(), 0.1 * errors.systematic_rms());
  EXPECT_LT(errors.largest_radius_share(), 4);
  const double dof = errors.residual_dof();
  EXPECT_NEAR(errors.residual_chi_square() / dof, 1, 3.3 * std::sqrt(2 / dof));
}

}  // namespace
}  // namespace celadon
