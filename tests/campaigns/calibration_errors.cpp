// Errors of the joint calibration against its own covariance over many seeds: 25 board views, 40 laser views and 72
// views on the platter at 1280 x 1024, corners to 0.03 px, line points to 0.05 px, the print measured to 0.02 %.
// Arguments: number of seeds (100), first seed (1). Exits with 1 if a block is out of bounds.
#include <chrono>
#include <cstdio>
#include <cstdlib>

#include "tests/acquisition/calibrate/error_blocks.h"

int main(int argc, char** argv) {
  using namespace celadon;
  const int seeds = argc > 1 ? std::atoi(argv[1]) : 100;
  const int first = argc > 2 ? std::atoi(argv[2]) : 1;
  test::ErrorBlocks errors;
  std::chrono::steady_clock::duration spent{};
  int good = 0, points = 0;
  for (int seed = first; seed < first + seeds; ++seed) {
    test::TrueMachine machine;
    const CalibrationInput input =
        test::seen_with_measured_print(machine, static_cast<std::uint64_t>(seed), 2e-4, {.line_step_mm = 0.14});
    const auto begin = std::chrono::steady_clock::now();
    const auto solution = solve_calibration(input);
    spent += std::chrono::steady_clock::now() - begin;
    if (!solution) {
      std::printf("seed %d: %s\n", seed, solution.error().c_str());
      return 1;
    }
    good += solution->verdict == Verdict::good;
    points = solution->degrees_of_freedom;
    errors.add(*solution, machine);
  }
  std::printf("%d seeds from %d on, %d of verdict good, about %d degrees of freedom each, %.2f s a solve\n\n", seeds,
              first, good, points, std::chrono::duration<double>(spent).count() / seeds);
  std::printf(
      "| block | rms error | stated | normalised rms | chi-square | 1e-3 quantiles | "
      "|\n|---|---|---|---|---|---|---|\n");
  bool all = true;
  for (const test::ErrorBlock& block : errors.blocks()) {
    const bool holds = block.chi_square > block.lowest() && block.chi_square < block.highest() && block.ratio() < 1.3 &&
                       block.ratio() > 1 / 1.3;
    all = all && holds;
    std::printf("| %s | %.3g %s | %.3g %s | %.3f | %.1f | %.1f ... %.1f | %s |\n", block.name.c_str(), block.rms(),
                block.unit.c_str(), block.predicted(), block.unit.c_str(), block.ratio(), block.chi_square,
                block.lowest(), block.highest(), holds ? "holds" : "FAILS");
  }
  std::printf("\nresiduals: chi-square / degrees of freedom %.5f; held-out views %.4f px rms\n",
              errors.residual_chi_square() / errors.residual_dof(), errors.held_out_rms());
  std::printf(
      "radius of cylinders of 15 and 30 mm: rms error %.4f mm, stated at most %.4f mm, largest error %.2f stated\n",
      errors.radius_rms(), errors.systematic_rms(), errors.largest_radius_share());
  return all ? 0 : 1;
}
