// A machine whose every number is known, seen by an independent projection, and solved for.

#include "acquisition/calibrate/calibration_solver.h"

#include <gtest/gtest.h>

#include "tests/acquisition/calibrate/true_machine.h"

namespace celadon {
namespace {

using test::errors_of;
using test::kDegree;
using test::Noise;
using test::Programme;
using test::seen_of;
using test::TrueMachine;

std::string told(const CalibrationSolution& solution) {
  std::string out;
  for (const CalibrationStep& step : solution.steps) {
    out += step.name +
           (step.verdict == Verdict::good     ? " good: "
            : step.verdict == Verdict::usable ? " usable: "
                                              : " refused: ") +
           step.finding + " " + step.remedy + "\n";
  }
  return out;
}

void expect_exact(const TrueMachine& machine, std::uint64_t seed) {
  CalibrationInput input = seen_of(machine, seed, {}, {.drawn = false});
  input.pitch_x = {machine.pitch.x(), 2e-4};
  input.pitch_y = {machine.pitch.y(), 2e-4};
  const auto solution = solve_calibration(input);
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_EQ(solution->verdict, Verdict::good) << told(*solution);
  EXPECT_TRUE(solution->left_out.empty());
  EXPECT_EQ(solution->calibration.direction, machine.direction);
  const Eigen::VectorXd errors = errors_of(*solution, machine);
  ASSERT_EQ(static_cast<std::size_t>(errors.size()), solution->names.size());
  // Relative: pixels to the focal length, millimetres to the distance, the rest to 1.
  for (Eigen::Index i = 0; i < errors.size(); ++i) {
    const std::string& name = solution->names[static_cast<std::size_t>(i)];
    const double size = name.ends_with("_px") ? 2100 : name.ends_with("_mm") ? 300 : 1;
    EXPECT_LT(std::abs(errors[i]), 1e-9 * size) << name;
  }
}

TEST(CalibrationSolver, IsExactWithoutNoise) {
  expect_exact(TrueMachine(), 1);
}

}  // namespace
}  // namespace celadon
