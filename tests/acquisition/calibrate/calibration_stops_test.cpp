// Elevation axis and lift: acquisition/calibrate/README.md, (12) and (13), and what is solved for from views at stops,
// against a machine whose every number is known.

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "acquisition/calibrate/frame_change.h"
#include "acquisition/calibrate/residual_terms.h"
#include "acquisition/calibration_change.h"
#include "tests/acquisition/calibrate/derivatives.h"
#include "tests/acquisition/calibrate/error_blocks.h"
#include "tests/acquisition/calibrate/true_machine.h"
#include "tests/acquisition/stop_truth.h"

namespace celadon::calibrate {
namespace {

using Eigen::Vector3d;
using test::kDegree;
using test::Programme;
using test::seen_of;
using test::TrueMachine;

TrueMachine machine_with_axes() {
  TrueMachine machine;
  machine.add_head_and_lift();
  return machine;
}

/// What a machine is calibrated as, without uncertainties.
Calibration calibration_of(const TrueMachine& machine) {
  Calibration out;
  out.axis.X_CW = machine.X_CW;
  out.elevation =
      ElevationAxis{machine.elevation->origin_W, machine.elevation->direction_W, 0, 0, {machine.elevation->scale, 0}};
  out.lift = LiftAxis{machine.lift->direction_W, 0, {machine.lift->scale, 0}};
  return out;
}

/// The truth, in the charts that the file has.
Estimate true_estimate(const TrueMachine& machine) {
  Estimate out;
  out.camera = machine.camera;
  out.axis = AxisEstimate{machine.X_CW.linear().col(2), machine.X_CW.translation(), machine.X_CW.linear().leftCols<2>(),
                          machine.direction * machine.encoder_scale};
  out.platter = PlatterEstimate{};
  const Vector3d d = machine.X_CW.linear() * machine.elevation->direction_W;
  out.elevation =
      ElevationEstimate{d, machine.X_CW * machine.elevation->origin_W, tangents_across(d), machine.elevation->scale};
  const Vector3d l = machine.X_CW.linear() * machine.lift->direction_W;
  out.lift = LiftEstimate{l, tangents_across(l), machine.lift->scale};
  return anchored(out);
}

Programme few_views() {
  return {.board_views = 20,
          .laser_views = 12,
          .placements = 3,
          .angles = 16,
          .line_step_mm = 1,
          .elevations_rad = {-8 * kDegree, 9 * kDegree, 18 * kDegree, 27 * kDegree, 36 * kDegree, 45 * kDegree},
          .lifts_mm = {-24, -15, -7, 6, 14, 23}};
}

const CalibrationStep& step_of(const CalibrationSolution& solution, const std::string& name) {
  for (const CalibrationStep& step : solution.steps) {
    if (step.name == name) return step;
  }
  ADD_FAILURE() << "no step " << name;
  return solution.steps.front();
}

bool has_step(const CalibrationSolution& solution, const std::string& name) {
  return std::any_of(solution.steps.begin(), solution.steps.end(), [&](const auto& step) { return step.name == name; });
}

// Equation (12) against Rodrigues' formula as CALIBRATION.md has it.
TEST(CalibrationStops, AreSeenAsTheFileSays) {
  const TrueMachine machine = machine_with_axes();
  const Estimate estimate = true_estimate(machine);
  const Calibration calibration = calibration_of(machine);
  for (const AxisStop& stop : {AxisStop{0, 0}, AxisStop{0.6, 0}, AxisStop{0, -35}, AxisStop{-0.15, 40}}) {
    for (const double turn : {0.0, 1.1}) {
      const Vector3d p_W(21, -13, 47);
      const Vector3d p_C = machine.X_CW * rotated_about(p_W, Vector3d::Zero(), Vector3d::UnitZ(), turn);
      EXPECT_LT((seen_from_stop(estimate, stop) * p_C - seen_at_stop(calibration, p_W, turn, stop)).norm(), 1e-10);
    }
  }
}

// Equations (6) and (12): derivatives of views off 0 of one axis, of the other and of both, against central differences
// away from the charts' origins.
TEST(CalibrationStops, DerivativesAreThoseOfTheResiduals) {
  const TrueMachine machine = machine_with_axes();
  CalibrationInput input = seen_of(machine, 4, {.board_views = 0, .laser_views = 1, .placements = 1, .angles = 1});
  const std::array<AxisStop, 3> stops = {AxisStop{0.5, 0}, AxisStop{0, 20}, AxisStop{0.3, -15}};
  for (const AxisStop& stop : stops) {
    BoardView view = input.views[1];
    view.stop = stop;
    view.lines = input.views[0].lines;  // wherever it lies
    input.views.push_back(std::move(view));
  }
  auto observations = arrange(input);
  ASSERT_TRUE(observations) << observations.error();
  Estimate estimate = true_estimate(machine);
  estimate.board_radius_mm = observations->board_radius_mm;
  estimate.platter.reset();
  for (const auto& sheet : machine.sheets) {
    PlaneEstimate plane;
    plane.normal_C = machine.normal_C(sheet);
    plane.distance_mm = machine.distance_C(sheet);
    plane.anchor_C = plane.normal_C * plane.distance_mm;
    plane.tangents_C = tangents_across(plane.normal_C);
    estimate.planes.push_back(plane);
  }
  test::Viewer viewer(machine, input.board, 4, {});
  for (ViewObservation& view : observations->views) {
    estimate.X_CB.push_back(viewer.pose(640, 512, 300, 0.4));
    view.reference_rad = view.encoder_rad - (view.turned() ? 0.3 : 0);
    for (LineObservation& line : view.lines) line.plane = line.laser;
  }
  Parameters parameters(estimate);
  for (double& x : parameters.axis) x = 2e-3;
  for (std::size_t i = 0; i < 4; ++i) parameters.elevation[i] = 3e-3;
  parameters.lift[0] = parameters.lift[1] = -2e-3;
  for (auto& pose : parameters.poses) pose = {0.01, -0.02, 0.005, 0.3, -0.2, 0.1};
  int with_elevation = 0, with_lift = 0;
  for (const Term& term : terms_of(*observations, estimate, parameters)) {
    for (const double* block : term.blocks) {
      with_elevation += block == parameters.elevation.data();
      with_lift += block == parameters.lift.data();
    }
    test::expect_true_derivatives(term);
  }
  // Two views each, their corners and at least one laser's line.
  EXPECT_GE(with_elevation, 4);
  EXPECT_GE(with_lift, 4);
}

// Equation (13): the estimate moved in its charts sees at stops what the file sees with its numbers moved as (13) says.
TEST(CalibrationStops, ChartsOfTheFileFollowTheScannersFrame) {
  const TrueMachine machine = machine_with_axes();
  const Estimate estimate = true_estimate(machine);
  const SharedLayout layout(estimate);
  const Eigen::MatrixXd by = in_scanner_frame(estimate, layout);
  Calibration calibration = calibration_of(machine);
  const Eigen::Isometry3d X_CW = scanner_frame(estimate);
  calibration.axis.X_CW = X_CW;
  calibration.elevation->origin_mm = X_CW.inverse() * estimate.elevation->point_C;
  calibration.elevation->direction = X_CW.linear().transpose() * estimate.elevation->direction_C;
  calibration.lift->direction = X_CW.linear().transpose() * estimate.lift->direction_C;
  // Of the platter the file holds the height alone.
  const std::vector<std::pair<int, std::vector<std::string>>> names = {
      {layout.axis, {"axis.tilt_x_rad", "axis.tilt_y_rad", "axis.x_mm", "axis.y_mm"}},
      {layout.platter, {"platter.height_mm"}},
      {layout.elevation,
       {"elevation.tilt_up_rad", "elevation.tilt_across_rad", "elevation.up_mm", "elevation.across_mm",
        "elevation.scale"}},
      {layout.lift, {"lift.tilt_x_rad", "lift.tilt_y_rad", "lift.scale"}}};
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  for (int draw = 0; draw < 20; ++draw) {
    constexpr double kSmall_rad = 1e-5, kSmall_mm = 1e-3;  // what is of second order comes to 1e-7 mm
    Eigen::VectorXd moves = Eigen::VectorXd::Zero(layout.size);
    for (const auto& [first, of] : names) {
      for (std::size_t i = 0; i < of.size(); ++i) {
        moves[first + static_cast<int>(i)] = (of[i].ends_with("_mm") ? kSmall_mm : kSmall_rad) * normal(random);
      }
    }
    Parameters parameters(estimate);
    for (int i = 0; i < 4; ++i) parameters.axis[static_cast<std::size_t>(i)] += moves[layout.axis + i];
    parameters.platter[0] += moves[layout.platter];
    for (int i = 0; i < 5; ++i) parameters.elevation[static_cast<std::size_t>(i)] += moves[layout.elevation + i];
    for (int i = 0; i < 3; ++i) parameters.lift[static_cast<std::size_t>(i)] += moves[layout.lift + i];
    const Estimate moved = parameters.moved(estimate);

    const Eigen::VectorXd of_file = by * moves;
    Calibration file = calibration;
    for (const auto& [first, of] : names) {
      for (std::size_t i = 0; i < of.size(); ++i) file = changed(file, of[i], of_file[first + static_cast<int>(i)]);
    }
    for (const AxisStop& stop : {AxisStop{0.7, 0}, AxisStop{0, 50}, AxisStop{-0.2, -30}}) {
      const Vector3d p_W(30, 10, 80);
      const Vector3d p_C = file.axis.X_CW * p_W;  // as the rotary axis has it, with all at 0
      const Vector3d seen = seen_from_stop(moved, stop) * p_C;
      EXPECT_LT((seen - seen_at_stop(file, p_W, 0, stop)).norm(), 1e-6);
      EXPECT_GT((seen - seen_at_stop(calibration, p_W, 0, stop)).norm(), 5e-5) << "moved by nothing";
    }
  }
}

TEST(CalibrationStops, AreExactWithoutNoise) {
  for (const double direction : {1.0, -1.0}) {
    TrueMachine machine = machine_with_axes();
    machine.direction = direction;
    CalibrationInput input = seen_of(machine, 2, few_views(), {.drawn = false});
    input.pitch_x = input.pitch_y = {1, 2e-4};
    const auto solution = solve_calibration(input);
    ASSERT_TRUE(solution) << solution.error();
    ASSERT_TRUE(solution->calibration.elevation && solution->calibration.lift);
    EXPECT_TRUE(solution->left_out.empty());
    EXPECT_LT(solution->held_out_raised_px, 1e-6);
    const Eigen::VectorXd errors = test::errors_of(*solution, machine);
    ASSERT_EQ(static_cast<std::size_t>(errors.size()), solution->names.size());
    for (Eigen::Index i = 0; i < errors.size(); ++i) {
      const std::string& name = solution->names[static_cast<std::size_t>(i)];
      const double size = name.ends_with("_px") ? 2100 : name.ends_with("_mm") ? 300 : 1;
      EXPECT_LT(std::abs(errors[i]), 1e-9 * size) << name;
    }
    // The file takes them.
    Calibration written = solution->calibration;
    written.machine = written.camera = "test";
    written.date = "2026-01-01";
    const auto read = parse_calibration(format_calibration(written), "test");
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ(read->covariance->names.size(), solution->calibration.covariance->names.size());
    EXPECT_TRUE(std::count(read->covariance->names.begin(), read->covariance->names.end(), "lift.scale") == 1);
  }
}

/// Where a point of the object comes out at a stop, less where it comes out with all at 0: 0 for the true numbers.
Vector3d split(const Calibration& calibration, const TrueMachine& machine, const AxisStop& stop) {
  const Vector3d p_W(25, 15, 70);
  const Vector3d at_stop_C = machine.turned(0, stop) * p_W, at_zero_C = machine.turned(0, {}) * p_W;
  return camera_to_object(calibration, stop) * at_stop_C - camera_to_object(calibration, {}) * at_zero_C;
}

// Stated uncertainties over seeds, block by block, and of what a scan makes of two stops by the joint covariance.
TEST(CalibrationStops, CoverTheErrorsOfEveryBlock) {
  constexpr int kSeeds = 30;
  constexpr AxisStop kStop{40 * kDegree, -20};
  std::vector<test::ErrorBlock> blocks = {
      {"elevation direction", "rad"}, {"elevation position", "mm"}, {"elevation scale", ""},
      {"lift direction", "rad"},      {"lift scale", ""},           {"split of two stops", "mm"}};
  double held_out = 0;
  for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
    TrueMachine machine = machine_with_axes();
    const auto solution = solve_calibration(test::seen_with_measured_print(machine, seed, 2e-4, few_views()));
    ASSERT_TRUE(solution) << solution.error();
    for (const char* name : {"elevation", "lift"}) {
      EXPECT_EQ(step_of(*solution, name).verdict, Verdict::good) << step_of(*solution, name).finding;
    }
    EXPECT_TRUE(solution->left_out.empty()) << "seed " << seed;
    const Eigen::VectorXd errors = test::errors_of(*solution, machine);
    const auto add = [&](std::size_t block, const std::string& first, int size) {
      const auto found = std::find(solution->names.begin(), solution->names.end(), first);
      const auto at = static_cast<Eigen::Index>(found - solution->names.begin());
      blocks[block].add(errors.segment(at, size), solution->covariance.block(at, at, size, size));
    };
    add(0, "elevation.tilt_up_rad", 2);
    add(1, "elevation.up_mm", 2);
    add(2, "elevation.scale", 1);
    add(3, "lift.tilt_x_rad", 2);
    add(4, "lift.scale", 1);
    const CalibrationCovariance& joint = *solution->calibration.covariance;
    Eigen::Matrix<double, 3, Eigen::Dynamic> J(3, joint.matrix.rows());
    for (Eigen::Index i = 0; i < J.cols(); ++i) {
      const std::string& name = joint.names[static_cast<std::size_t>(i)];
      const double step = std::sqrt(joint.matrix(i, i));
      J.col(i) = (split(changed(solution->calibration, name, step), machine, kStop) -
                  split(changed(solution->calibration, name, -step), machine, kStop)) /
                 (2 * step);
    }
    blocks[5].add(split(solution->calibration, machine, kStop), J * joint.matrix * J.transpose());
    held_out += solution->held_out_raised_px / kSeeds;
  }
  for (const test::ErrorBlock& block : blocks) {
    SCOPED_TRACE(block.name);
    std::printf("%-20s rms %.2e, stated %.2e %s, normalised %.3f\n", block.name.c_str(), block.rms(), block.predicted(),
                block.unit.c_str(), block.ratio());
    EXPECT_GT(block.chi_square, block.lowest());
    EXPECT_LT(block.chi_square, block.highest());
  }
  // Noise of 0.03 px a coordinate, and what the axes add.
  EXPECT_GT(held_out, 0.040);
  EXPECT_LT(held_out, 0.050);
}

TEST(CalibrationStops, MachineWithoutThemHasNone) {
  const auto solution = solve_calibration(seen_of(TrueMachine(), 5, {.laser_views = 12, .line_step_mm = 1}));
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_FALSE(solution->calibration.elevation || solution->calibration.lift);
  EXPECT_FALSE(has_step(*solution, "elevation") || has_step(*solution, "lift"));
  EXPECT_EQ(std::count(solution->names.begin(), solution->names.end(), "elevation.scale"), 0);
}

TEST(CalibrationStops, OneAxisAloneIsCalibratedAlone) {
  TrueMachine machine = machine_with_axes();
  machine.elevation.reset();
  Programme programme = few_views();
  programme.elevations_rad.clear();
  const auto solution = solve_calibration(seen_of(machine, 6, programme));
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_FALSE(solution->calibration.elevation);
  ASSERT_TRUE(solution->calibration.lift);
  EXPECT_FALSE(has_step(*solution, "elevation"));
  EXPECT_EQ(step_of(*solution, "lift").verdict, Verdict::good) << step_of(*solution, "lift").finding;
}

void expect_refused(const CalibrationInput& input, const std::string& step, const std::string& remedy) {
  const auto solution = solve_calibration(input);
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_EQ(solution->verdict, Verdict::refused);
  const CalibrationStep& of = step_of(*solution, step);
  EXPECT_EQ(of.verdict, Verdict::refused) << of.finding;
  EXPECT_NE(of.remedy.find(remedy), std::string::npos) << of.remedy;
  // What was seen at those stops pulls at nothing else.
  for (const CalibrationStep& other : solution->steps) {
    if (other.name == "camera" || other.name == "axis") {
      EXPECT_NE(other.verdict, Verdict::refused) << other.finding;
    }
  }
}

TEST(CalibrationStops, TooFewAreRefused) {
  Programme programme = few_views();
  programme.placements = 1;
  programme.elevations_rad = {20 * kDegree};
  programme.lifts_mm = {};
  expect_refused(seen_of(machine_with_axes(), 7, programme), "elevation", "lean the board on the platter back");
  programme.elevations_rad = {};
  programme.lifts_mm = {15};
  expect_refused(seen_of(machine_with_axes(), 7, programme), "lift", "more heights of the lift");
}

TEST(CalibrationStops, TooCloseAreRefused) {
  Programme programme = few_views();
  programme.placements = 1;
  programme.elevations_rad = {0.3 * kDegree, 0.35 * kDegree, 0.4 * kDegree};
  programme.lifts_mm = {};
  expect_refused(seen_of(machine_with_axes(), 8, programme), "elevation", "further apart");
  programme.elevations_rad = {-2 * kDegree, 2 * kDegree, 4 * kDegree};  // an axis is seen, but badly
  expect_refused(seen_of(machine_with_axes(), 8, programme), "elevation", "further apart");
  programme.elevations_rad = {};
  programme.lifts_mm = {0.1, 0.2, 0.3};
  expect_refused(seen_of(machine_with_axes(), 8, programme), "lift", "further apart");
}

// The reading counts but nothing moves.
TEST(CalibrationStops, AxesThatStandStillAreRefused) {
  TrueMachine machine = machine_with_axes();
  machine.elevation->scale = 0;
  Programme programme = few_views();
  programme.lifts_mm = {};
  expect_refused(seen_of(machine, 9, programme), "elevation", "see that the head moves when its reading does");
  machine = machine_with_axes();
  machine.lift->scale = 0;
  programme = few_views();
  programme.elevations_rad = {};
  expect_refused(seen_of(machine, 9, programme), "lift", "see that the table moves when the lift's reading does");
}

TEST(CalibrationStops, LiftThatSinksForRisingReadingsIsRefused) {
  TrueMachine machine = machine_with_axes();
  machine.lift->direction_W = -machine.lift->direction_W;
  expect_refused(seen_of(machine, 10, few_views()), "lift", "rising readings of the lift raise the table");
}

// A board that slipped at one stop, a reading that is wrong at another: named, and without effect.
TEST(CalibrationStops, ViewsThatDisagreeAreLeftOut) {
  const TrueMachine machine = machine_with_axes();
  CalibrationInput input = seen_of(machine, 11, few_views());
  input.pitch_x = input.pitch_y = {1, 2e-4};
  std::vector<int> spoilt;
  int raised = 0, lifted = 0;
  for (std::size_t i = 0; i < input.views.size(); ++i) {
    BoardView& view = input.views[i];
    if (view.stop.elevation_rad != 0 && ++raised == 5) {
      for (SeenCorner& corner : view.corners) corner.p_px.y() += 4;
    } else if (view.stop.lift_mm != 0 && ++lifted == 8) {
      view.stop.lift_mm += 0.5;
    } else {
      continue;
    }
    spoilt.push_back(static_cast<int>(i));
  }
  ASSERT_EQ(spoilt.size(), 2u);
  const auto solution = solve_calibration(input);
  ASSERT_TRUE(solution) << solution.error();
  EXPECT_EQ(solution->left_out, spoilt);
  const Eigen::VectorXd errors = test::errors_of(*solution, machine);
  for (Eigen::Index i = 0; i < errors.size(); ++i) {
    const std::string& name = solution->names[static_cast<std::size_t>(i)];
    if (!name.starts_with("elevation") && !name.starts_with("lift")) continue;
    EXPECT_LT(std::abs(errors[i]), 4.5 * std::sqrt(solution->covariance(i, i))) << name;
  }
}

TEST(CalibrationStops, ReadingsThatCannotBeAreErrorsWithTheirPlace) {
  CalibrationInput input = seen_of(machine_with_axes(), 12, {.board_views = 4, .laser_views = 2, .angles = 4});
  input.views[8].stop.lift_mm = std::nan("");
  const auto solution = solve_calibration(input);
  ASSERT_FALSE(solution);
  EXPECT_NE(solution.error().find("view 8"), std::string::npos) << solution.error();
}

}  // namespace
}  // namespace celadon::calibrate
