// A machine whose every number is known, seen by an independent projection, and solved for.

#include "acquisition/calibrate/calibration_solver.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <string>
#include <vector>

#include "tests/acquisition/calibrate/error_blocks.h"
#include "tests/acquisition/calibrate/true_machine.h"

namespace celadon {
namespace {

using test::errors_of;
using test::kDegree;
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

const CalibrationStep& step_of(const CalibrationSolution& solution, const std::string& name) {
  for (const CalibrationStep& step : solution.steps) {
    if (step.name == name) return step;
  }
  ADD_FAILURE() << "no step " << name;
  return solution.steps.front();
}

void expect_exact(const TrueMachine& machine, std::uint64_t seed) {
  CalibrationInput input = seen_of(machine, seed, {}, {.drawn = false});
  input.pitch_x = {machine.pitch.x(), 2e-4};
  input.pitch_y = {machine.pitch.y(), 2e-4};
  const auto solution = solve_calibration(input);
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_EQ(solution->verdict, Verdict::good) << told(*solution);
  EXPECT_TRUE(solution->left_out.empty());
  EXPECT_EQ(solution->calibration.encoder.direction, machine.direction);
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

TEST(CalibrationSolver, IsExactForATableThatTurnsTheOtherWay) {
  TrueMachine machine;
  machine.direction = -1;
  machine.encoder_scale = 0.9985;
  machine.pitch = {1.0012, 0.9991};
  expect_exact(machine, 2);
}

// The frame is that of the triangulation: a cylinder's radius comes back, and theta = 0 lies in laser 0's half plane
// towards the camera.
// The whole turn is seen; what is expected of encoders pulls by two hundred-thousandths.
TEST(CalibrationSolver, FindsWhatTheEncoderErrsByOnceATurn) {
  for (const double direction : {1., -1.}) {
    TrueMachine machine;
    machine.direction = direction;
    machine.encoder_cos_rad = 4e-3;
    machine.encoder_sin_rad = -2.5e-3;
    const auto solution = solve_calibration(seen_of(machine, 3, {}, {.drawn = false}));
    ASSERT_TRUE(solution) << solution.error();
    const TableEncoder& found = solution->calibration.encoder;
    EXPECT_NEAR(found.cos_rad.value, machine.encoder_cos_rad, 1e-7);
    EXPECT_NEAR(found.sin_rad.value, machine.encoder_sin_rad, 1e-7);
    EXPECT_NEAR(found.scale.value, machine.encoder_scale, 1e-7);
    EXPECT_LT(std::max(found.cos_rad.u, found.sin_rad.u), 2e-5);
    // Where CALIBRATION.md has them.
    for (const double b : {-2., 0.3, 4.}) {
      EXPECT_NEAR(machine.table_at(b)(1, 0), std::sin(found.table_rad(b)), 1e-6) << b;
    }
    EXPECT_EQ(step_of(*solution, "encoder").verdict, Verdict::good) << step_of(*solution, "encoder").finding;
  }
}

// A third of a turn says little of it: the encoder's scale is stated so.
TEST(CalibrationSolver, PartOfATurnLeavesTheEncodersErrorUnsure) {
  TrueMachine machine;
  machine.encoder_sin_rad = 3e-3;
  const auto input = seen_of(machine, 5, {.placements = 1, .angles = 8});
  const auto part = solve_calibration(input), whole = solve_calibration(seen_of(machine, 5));
  ASSERT_TRUE(part && whole);
  EXPECT_GT(part->calibration.encoder.scale.u, 10 * whole->calibration.encoder.scale.u);
  EXPECT_LT(std::abs(part->calibration.encoder.scale.value - machine.encoder_scale),
            3 * part->calibration.encoder.scale.u);
}

TEST(CalibrationSolver, FrameIsTheOneThatScansUse) {
  const TrueMachine machine;
  const auto solution = solve_calibration(seen_of(machine, 5, {}, {.drawn = false}));
  ASSERT_TRUE(solution) << solution.error();
  for (int laser = 0; laser < 2; ++laser) {
    const std::vector<double> radii = test::scanned_radii(solution->calibration, machine, laser, 25);
    ASSERT_GT(radii.size(), 300u);
    for (double r : radii) EXPECT_NEAR(r, 25, 1e-4);  // pixels are floats
  }
  const Eigen::Isometry3d& X_CW = solution->calibration.axis.X_CW;
  EXPECT_NEAR(
      X_CW.linear().col(0).dot(solution->calibration.lasers[0].normal_C.cross(X_CW.linear().col(2)).normalized()),
      solution->calibration.lasers[0].normal_C.dot(X_CW.linear().col(1)) > 0 ? 1 : -1, 1e-9);
  EXPECT_GT(X_CW.inverse().translation().x(), 100);
  EXPECT_LT((X_CW.translation() - machine.X_CW.translation()).norm(), 1e-6);
}

// Swapped identities in two held views, a board moved during the exposure
// (half of its corners by 2 px), one that slipped on the platter, and a line on something else.
TEST(CalibrationSolver, ViewsThatDisagreeAreLeftOutAndNamed) {
  const TrueMachine machine;
  CalibrationInput input = seen_of(machine, 7, {.line_step_mm = 0.56});
  input.pitch_x = input.pitch_y = {1, 2e-4};
  const std::vector<int> swapped = {3, 11}, moved = {20}, strayed = {40}, slipped = {70, 100};
  for (int view : swapped) {
    auto& corners = input.views[static_cast<std::size_t>(view)].corners;
    std::vector<int> ids;
    for (const SeenCorner& corner : corners) ids.push_back(corner.id);
    std::mt19937_64 random(5);
    std::shuffle(ids.begin(), ids.end(), random);
    for (std::size_t i = 0; i < corners.size(); ++i) corners[i].id = ids[i];
  }
  for (int view : moved) {
    auto& corners = input.views[static_cast<std::size_t>(view)].corners;
    for (std::size_t i = 0; i < corners.size(); i += 2) corners[i].p_px += Eigen::Vector2d(2, -1);
  }
  for (int view : slipped) {
    for (SeenCorner& corner : input.views[static_cast<std::size_t>(view)].corners) corner.p_px.x() += 6;
  }
  for (int view : strayed) {
    for (SeenLine& line : input.views[static_cast<std::size_t>(view)].lines) {
      for (SeenLinePoint& point : line.points) point.p_px.x() += 3;
    }
  }
  // A tenth of the points of another line lie on something else: they alone are left out.
  for (SeenLine& line : input.views[50].lines) {
    for (std::size_t i = 0; i < line.points.size(); i += 10) line.points[i].p_px.x() += 25;
  }
  const auto solution = solve_calibration(input);
  ASSERT_TRUE(solution) << solution.error();
  std::vector<int> expected = {3, 11, 20, 40, 70, 100};
  EXPECT_EQ(solution->left_out, expected) << told(*solution);
  EXPECT_NE(solution->steps[0].finding.find("(3, 11, 20, 40, 70, 100)"), std::string::npos) << told(*solution);
  EXPECT_EQ(solution->verdict, Verdict::good) << told(*solution);
  const Eigen::VectorXd errors = errors_of(*solution, machine);
  for (Eigen::Index i = 0; i < errors.size(); ++i) {
    const std::string& name = solution->names[static_cast<std::size_t>(i)];
    if (name.starts_with("pitch") || name.starts_with("board") || name.starts_with("platter.slope")) continue;
    EXPECT_LT(std::abs(errors[i]), 4.5 * std::sqrt(solution->covariance(i, i))) << name;
  }
  const double dof = solution->degrees_of_freedom;
  EXPECT_NEAR(solution->chi_square / dof, 1, 4 * std::sqrt(2 / dof));
}

// Stated noise three times too small: every uncertainty grows by three, and the finding says so.
// Of a board that turns out of sight two columns are left, or two rows: every other corner of them lies in a line.
TEST(CalibrationSolver, TwoColumnsOrRowsOfABoardAreAViewLikeOthers) {
  auto input = seen_of(TrueMachine(), 6);
  std::map<int, Eigen::Vector2d> places;
  for (const BoardCorner& corner : input.board.corners()) places[corner.id] = corner.p_mm;
  double left_mm = 0, top_mm = 0;
  for (const auto& [id, p] : places) left_mm = std::min(left_mm, p.x()), top_mm = std::min(top_mm, p.y());
  for (std::size_t i = 0; i < input.views.size(); ++i) {
    if (input.views[i].placement == BoardView::kHeld || i % 9 != 0) continue;
    std::erase_if(input.views[i].corners, [&](const SeenCorner& corner) {
      const Eigen::Vector2d& p = places[corner.id];
      return i % 2 == 0 ? p.x() > left_mm + 1.5 * input.board.square_mm()
                        : p.y() > top_mm + 1.5 * input.board.square_mm();
    });
  }
  const auto solution = solve_calibration(input);
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_TRUE(solution->left_out.empty());
  EXPECT_NEAR(solution->held_out_rms_px, 0.044, 0.004) << told(*solution);
}

TEST(CalibrationSolver, NoiseThatIsLargerThanStatedInflatesTheUncertainties) {
  const TrueMachine machine;
  CalibrationInput input = seen_of(machine, 8, {.line_step_mm = 0.56});
  input.pitch_x = input.pitch_y = {1, 0};
  const auto honest = solve_calibration(input);
  for (BoardView& view : input.views) {
    for (SeenCorner& corner : view.corners) corner.sigma_px /= 3;
    for (SeenLine& line : view.lines) {
      for (SeenLinePoint& point : line.points) point.sigma_px /= 3;
    }
  }
  for (SeenLine& line : input.platter) {
    for (SeenLinePoint& point : line.points) point.sigma_px /= 3;
  }
  const auto optimistic = solve_calibration(input);
  ASSERT_TRUE(honest && optimistic);
  EXPECT_NEAR(optimistic->calibration.camera_model.fx_px.u / honest->calibration.camera_model.fx_px.u, 1, 0.03);
  EXPECT_NEAR(optimistic->chi_square / honest->chi_square, 9, 0.1);
  EXPECT_NE(step_of(*optimistic, "camera").finding.find("multiplied by"), std::string::npos) << told(*optimistic);
  EXPECT_EQ(step_of(*honest, "camera").finding.find("multiplied by"), std::string::npos) << told(*honest);
}

TEST(CalibrationSolver, PrintThatNobodyMeasuredIsUsableAtMost) {
  CalibrationInput input = seen_of(TrueMachine(), 9, {.line_step_mm = 0.56});
  input.pitch_x = input.pitch_y = {1, 0.003};
  const auto solution = solve_calibration(input);
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_EQ(solution->verdict, Verdict::usable) << told(*solution);
  EXPECT_EQ(step_of(*solution, "scale").verdict, Verdict::usable);
  EXPECT_NE(step_of(*solution, "scale").remedy.find("measure"), std::string::npos);
  EXPECT_NEAR(solution->calibration.scale.u, 0.003 / std::sqrt(2), 2e-5);
  // A radius of 40 mm carries the scale's share.
  EXPECT_GT(solution->calibration.systematic_mm, 0.02);
}

TEST(CalibrationSolver, BoardsThatAllFaceTheCameraAreRefused) {
  const auto solution = solve_calibration(seen_of(
      TrueMachine(), 10, {.placements = 1, .angles = 3, .angle_step_rad = 1.5 * kDegree, .largest_lean_rad = 0}));
  if (!solution) {
    EXPECT_NE(solution.error().find("tilt"), std::string::npos) << solution.error();
    return;
  }
  EXPECT_EQ(solution->verdict, Verdict::refused) << told(*solution);
  EXPECT_EQ(step_of(*solution, "camera").verdict, Verdict::refused) << told(*solution);
  EXPECT_NE(step_of(*solution, "camera").remedy.find("tilt the board"), std::string::npos) << told(*solution);
}

TEST(CalibrationSolver, OnePlacementAtOneAngleShowsNoAxis) {
  const auto solution = solve_calibration(seen_of(TrueMachine(), 11, {.placements = 1, .angles = 1}));
  ASSERT_FALSE(solution);
  EXPECT_NE(solution.error().find("turn the table"), std::string::npos) << solution.error();
}

// The encoder counts but the table stands still.
TEST(CalibrationSolver, TableThatStandsStillShowsNoAxis) {
  TrueMachine machine;
  machine.encoder_scale = 0;
  const auto solution = solve_calibration(seen_of(machine, 12));
  ASSERT_FALSE(solution);
  EXPECT_NE(solution.error().find("turn the table"), std::string::npos) << solution.error();
}

TEST(CalibrationSolver, LittleOfATurnIsNotGood) {
  const auto solution =
      solve_calibration(seen_of(TrueMachine(), 13, {.placements = 1, .angles = 4, .angle_step_rad = 2 * kDegree}));
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_EQ(step_of(*solution, "axis").verdict, Verdict::refused) << told(*solution);
  EXPECT_NE(step_of(*solution, "axis").remedy.find("turn the table further"), std::string::npos);
}

TEST(CalibrationSolver, LasersThatNeverMeetTheBoardAreRefused) {
  const auto solution = solve_calibration(seen_of(TrueMachine(), 14, {.laser_views = 0}));
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_EQ(solution->verdict, Verdict::refused);
  EXPECT_TRUE(solution->calibration.lasers.empty());
  EXPECT_EQ(step_of(*solution, "laser 0").verdict, Verdict::refused);
  EXPECT_NE(step_of(*solution, "laser 0").remedy.find("hold the board"), std::string::npos);
}

TEST(CalibrationSolver, WithoutThePlatterHeightsAreUnknown) {
  const TrueMachine machine;
  const auto solution = solve_calibration(seen_of(machine, 15, {.line_step_mm = 0.56, .platter = false}));
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_EQ(solution->verdict, Verdict::usable) << told(*solution);
  EXPECT_NE(step_of(*solution, "platter").remedy.find("platter"), std::string::npos);
  // Radii do not depend on it.
  for (double r : test::scanned_radii(solution->calibration, machine, 0, 25)) EXPECT_NEAR(r, 25, 0.1);
}

TEST(CalibrationSolver, PlatterThatTiltsIsTold) {
  TrueMachine machine;
  machine.platter_slope = {0.006, 0.002};
  const auto solution = solve_calibration(seen_of(machine, 16, {.line_step_mm = 0.56}));
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_EQ(step_of(*solution, "platter").verdict, Verdict::usable) << told(*solution);
  EXPECT_NE(step_of(*solution, "platter").finding.find("tilt against the axis 0.0063"), std::string::npos)
      << told(*solution);
}

TEST(CalibrationSolver, InputThatCannotBeIsAnErrorWithItsPlace) {
  const CalibrationInput sound = seen_of(TrueMachine(), 17, {.laser_views = 2, .angles = 4});
  const auto error_of = [](const CalibrationInput& input) {
    const auto solution = solve_calibration(input);
    return solution ? std::string("no error") : solution.error();
  };
  CalibrationInput input = sound;
  input.width_px = 0;
  EXPECT_NE(error_of(input).find("0 x 1024"), std::string::npos) << error_of(input);
  input = sound;
  input.views[4].corners[2].id = 70;
  EXPECT_NE(error_of(input).find("corner 70 in view 4"), std::string::npos) << error_of(input);
  input = sound;
  input.views[4].corners[2].sigma_px = 0;
  EXPECT_NE(error_of(input).find("corner 2 in view 4"), std::string::npos) << error_of(input);
  input = sound;
  input.views[26].lines[0].points[0].p_px.x() = std::nan("");
  EXPECT_NE(error_of(input).find("view 26"), std::string::npos) << error_of(input);
  input = sound;
  input.views.resize(2);
  EXPECT_NE(error_of(input).find("2 views"), std::string::npos) << error_of(input);
  input = sound;
  input.views.clear();
  EXPECT_NE(error_of(input).find("0 views"), std::string::npos) << error_of(input);
  input = sound;
  input.pitch_x.value = 0;
  EXPECT_NE(error_of(input).find("pitch"), std::string::npos) << error_of(input);
}

// Random machines and few views: whatever is called good is within what it says of itself, and nothing is not finite.
TEST(CalibrationSolver, OfRandomMachinesIsWhatItSays) {
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937_64 random(seed);
    const auto uniform = [&](double lo, double hi) { return std::uniform_real_distribution<double>(lo, hi)(random); };
    TrueMachine machine;
    machine.camera = {uniform(1700, 2500),  0,
                      uniform(600, 680),    uniform(470, 550),
                      uniform(-0.25, 0.1),  uniform(-0.05, 0.1),
                      uniform(-1e-3, 1e-3), uniform(-1e-3, 1e-3),
                      uniform(-0.05, 0.05)};
    machine.camera[1] = machine.camera[0] * uniform(0.99, 1.01);
    machine.encoder_scale = uniform(0.99, 1.01);
    machine.encoder_cos_rad = uniform(-3e-3, 3e-3);
    machine.encoder_sin_rad = uniform(-3e-3, 3e-3);
    machine.direction = uniform(-1, 1) < 0 ? -1 : 1;
    machine.X_CW = Eigen::Translation3d(uniform(-5, 5), uniform(-5, 5), uniform(-20, 20)) *
                   Eigen::AngleAxisd(uniform(-0.03, 0.03), Eigen::Vector3d(0.3, 0.5, 0.8).normalized()) * machine.X_CW;
    const Programme programme = {.board_views = static_cast<int>(uniform(3, 15)),
                                 .laser_views = static_cast<int>(uniform(2, 15)),
                                 .placements = static_cast<int>(uniform(1, 4)),
                                 .angles = static_cast<int>(uniform(2, 12)),
                                 .angle_step_rad = uniform(3, 10) * kDegree,
                                 .largest_lean_rad = uniform(10, 45) * kDegree,
                                 .line_step_mm = 0.56};
    const auto solution = solve_calibration(seen_of(machine, seed, programme));
    ASSERT_TRUE(solution) << solution.error();
    EXPECT_TRUE(solution->covariance.allFinite());
    EXPECT_EQ(solution->calibration.encoder.direction, machine.direction);
    const auto steps_worst = std::max_element(solution->steps.begin(), solution->steps.end(),
                                              [](const auto& a, const auto& b) { return a.verdict < b.verdict; });
    EXPECT_EQ(solution->verdict, steps_worst->verdict);
    for (const CalibrationStep& step : solution->steps) {
      EXPECT_EQ(step.remedy.empty(), step.verdict == Verdict::good) << step.name << ": " << step.finding;
      EXPECT_FALSE(step.finding.empty());
    }
    if (solution->verdict == Verdict::refused) continue;
    const Eigen::VectorXd errors = errors_of(*solution, machine);
    for (Eigen::Index i = 0; i < errors.size(); ++i) {
      const std::string& name = solution->names[static_cast<std::size_t>(i)];
      if (name.starts_with("pitch") || name.starts_with("board") || name.starts_with("platter.slope")) continue;
      EXPECT_LT(std::abs(errors[i]), 5 * std::sqrt(solution->covariance(i, i))) << name;
    }
    const Calibration& c = solution->calibration;
    EXPECT_LT((c.axis.X_CW.linear() * c.axis.X_CW.linear().transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-9);
    for (const LaserPlane& plane : c.lasers) EXPECT_NEAR(plane.normal_C.norm(), 1, 1e-9);
  }
}

}  // namespace
}  // namespace celadon
