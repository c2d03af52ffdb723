// The formulas of acquisition/calibrate/README.md, each against a computation of another kind.

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/calib3d.hpp>
#include <random>
#include <stdexcept>
#include <vector>

#include "acquisition/calibrate/bundle.h"
#include "acquisition/calibrate/line_distance.h"
#include "acquisition/calibrate/residual_terms.h"
#include "acquisition/calibrate/uncertainty.h"
#include "tests/acquisition/calibrate/derivatives.h"
#include "tests/acquisition/calibrate/true_machine.h"

namespace celadon::calibrate {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using test::TrueMachine;

Estimate truth_of(const TrueMachine& machine) {
  Estimate out;
  out.camera = machine.camera;
  out.pitch = machine.pitch;
  AxisEstimate axis;
  axis.direction_C = machine.X_CW.linear().col(2);
  axis.point_C = machine.X_CW.translation();
  axis.across_C = machine.X_CW.linear().leftCols<2>();
  axis.turn = machine.direction * machine.encoder_scale;
  out.axis = axis;
  out.platter = PlatterEstimate{0, machine.platter_slope};
  for (const auto& sheet : machine.sheets) {
    PlaneEstimate plane;
    plane.laser = sheet.laser;
    plane.normal_C = machine.normal_C(sheet);
    plane.distance_mm = machine.distance_C(sheet);
    plane.anchor_C = plane.normal_C * plane.distance_mm;
    plane.tangents_C = tangents_across(plane.normal_C);
    out.planes.push_back(plane);
  }
  return out;
}

// Equation (1) against OpenCV, (2) against (1), and the derivatives of both against differences.
TEST(CalibrationTerms, ProjectionAndRayAreOpenCvsAndInverse) {
  const CameraParameters camera = TrueMachine().camera;
  const cv::Matx33d K(camera[0], 0, camera[2], 0, camera[1], camera[3], 0, 0, 1);
  const cv::Vec<double, 5> k(camera[4], camera[5], camera[6], camera[7], camera[8]);
  for (const Vector2d& ab : {Vector2d(0.01, -0.02), Vector2d(-0.28, 0.2), Vector2d(0.3, 0.24), Vector2d(0.1, -0.24)}) {
    std::vector<cv::Point2d> seen;
    cv::projectPoints(std::vector<cv::Point3d>{{ab.x() * 310, ab.y() * 310, 310}}, cv::Vec3d(), cv::Vec3d(), K, k,
                      seen);
    const Projection at = project(camera.data(), ab.x(), ab.y());
    EXPECT_NEAR(at.p_px.x(), seen[0].x, 1e-9);
    EXPECT_NEAR(at.p_px.y(), seen[0].y, 1e-9);
    const Ray ray = ray_of(camera.data(), at.p_px);
    ASSERT_TRUE(ray.exists);
    EXPECT_LT((ray.v.head<2>() - ab).norm(), 1e-13);
    for (std::size_t i = 0; i < 9; ++i) {
      CameraParameters up = camera, down = camera;
      const double step = i < 4 ? 1e-3 : 1e-5;
      up[i] += step;
      down[i] -= step;
      const auto column = static_cast<Eigen::Index>(i);
      const Vector2d slope =
          (project(up.data(), ab.x(), ab.y()).p_px - project(down.data(), ab.x(), ab.y()).p_px) / (2 * step);
      EXPECT_LT((at.by_camera.col(column) - slope).norm(), 1e-6 * (1 + slope.norm())) << i;
      const Vector2d turn = (ray_of(up.data(), at.p_px).v - ray_of(down.data(), at.p_px).v).head<2>() / (2 * step);
      EXPECT_LT((ray.by_camera.col(column) - turn).norm(), 1e-6 * (1e-3 + turn.norm())) << i;
    }
    for (int i = 0; i < 2; ++i) {
      const Vector2d e = Vector2d::Unit(i) * 1e-3;
      const Vector2d slope =
          (ray_of(camera.data(), at.p_px + e).v - ray_of(camera.data(), at.p_px - e).v).head<2>() / 2e-3;
      EXPECT_LT((ray.by_pixel.col(i) - slope).norm(), 1e-9);
    }
  }
}

// Equations (4) and (5): the distance across the line against the nearest of many projected places of the line, as it
// is in space by (3).
TEST(CalibrationTerms, LineDistanceIsThatToTheProjectedLine) {
  const TrueMachine machine;
  const auto& sheet = machine.sheets[0];
  test::Viewer viewer(machine, TargetBoard(11, 8, 8, false), 3, {.drawn = false});
  for (int k = 0; k < 20; ++k) {
    const Eigen::Isometry3d X_CB = viewer.pose(640, 512, 300, viewer.uniform(0, 0.7));
    const Vector3d m = X_CB.linear().col(2), n = machine.normal_C(sheet);
    const auto seen = viewer.line(sheet, m, X_CB.translation(), 25, 0.5).points;
    ASSERT_GT(seen.size(), 50u);
    const Vector3d along = n.cross(m).normalized();
    const Vector2d p = seen[seen.size() / 2].p_px + Vector2d(viewer.uniform(-3, 3), viewer.uniform(-3, 3));
    const LineDistance at =
        line_distance(machine.camera.data(), p, m, m.dot(X_CB.translation()), n, machine.distance_C(sheet));
    ASSERT_TRUE(at.exists && at.definite);
    EXPECT_NEAR(m.dot(at.foot.p_C - X_CB.translation()), 0, 1e-9);
    EXPECT_NEAR(n.dot(at.foot.p_C), machine.distance_C(sheet), 1e-8);
    // From any place of the line by golden section.
    double lo = -30, hi = 30;
    const auto apart = [&](double s) { return (machine.project(at.foot.p_C + s * along) - p).norm(); };
    for (int i = 0; i < 200; ++i) {
      const double a = hi - 0.618 * (hi - lo), b = lo + 0.618 * (hi - lo);
      (apart(a) < apart(b) ? hi : lo) = apart(a) < apart(b) ? b : a;
    }
    EXPECT_NEAR(std::abs(at.distance_px), apart(0.5 * (lo + hi)), 1e-6);
  }
}

// Equations (3) to (7): every term's derivatives against central differences, at parameters away from the charts'
// origins.
TEST(CalibrationTerms, DerivativesAreThoseOfTheResiduals) {
  TrueMachine machine;
  machine.platter_slope = {0.002, -0.003};
  CalibrationInput input =
      test::seen_of(machine, 4, {.board_views = 1, .laser_views = 2, .placements = 1, .angles = 2, .line_step_mm = 1});
  input.views[3].lines = input.views[1].lines;  // a line on a board that turns, wherever it lies
  auto observations = arrange(input);
  ASSERT_TRUE(observations) << observations.error();
  Estimate estimate = truth_of(machine);
  test::Viewer viewer(machine, input.board, 4, {});
  for (ViewObservation& view : observations->views) {
    estimate.X_CB.push_back(viewer.pose(640, 512, 300, 0.5));
    view.reference_rad = view.encoder_rad - (view.turned() ? 0.3 : 0);
    for (LineObservation& line : view.lines) line.plane = line.laser;
  }
  for (LineObservation& line : observations->platter) line.plane = line.laser;
  Parameters parameters(estimate);
  parameters.print = {1.002, 0.997, 0.005, -0.003, 0.008};
  for (double& x : parameters.axis) x = 2e-3;
  parameters.turn = {1.003, 2e-3, -3e-3};
  for (auto& plane : parameters.planes) plane = {1e-3, -2e-3, 0.1};
  for (auto& pose : parameters.poses) pose = {0.01, -0.02, 0.005, 0.3, -0.2, 0.1};
  std::map<std::size_t, int> kinds;
  for (const Term& term : terms_of(*observations, estimate, parameters)) {
    ++kinds[term.blocks.size()];
    test::expect_true_derivatives(term);
  }
  EXPECT_EQ(kinds[1], 3);      // priors
  EXPECT_EQ(kinds[3], 3);      // held corners
  EXPECT_EQ(kinds[4], 2 + 4);  // platter, lines on held boards
  EXPECT_EQ(kinds[5], 2);      // turned corners
  EXPECT_GE(kinds[6], 1);      // lines on a turned board
}

struct Scene {
  TargetBoard board{11, 8, 8, false};
  Observations observations;
  Estimate estimate;  ///< the truth
};

Scene scene_of(const TrueMachine& machine) {
  Scene scene;
  CalibrationInput input =
      test::seen_of(machine, 6, {.board_views = 0, .laser_views = 0, .placements = 0, .line_step_mm = 1});
  test::Viewer viewer(machine, input.board, 6, {});
  Estimate& estimate = scene.estimate;
  estimate = truth_of(machine);
  for (int i = 0; i < 12; ++i) {
    const Eigen::Isometry3d X_CB = viewer.pose(viewer.uniform(300, 900), viewer.uniform(300, 700),
                                               viewer.uniform(260, 330), viewer.uniform(0.2, 0.7));
    estimate.X_CB.push_back(X_CB);
    BoardView view;
    view.corners = viewer.corners(X_CB);
    view.lines = viewer.lines(X_CB, 1);
    input.views.push_back(std::move(view));
  }
  const Eigen::Isometry3d X_WB = viewer.standing(0.5, 0.2, 50, {10, -5});
  estimate.X_CB.push_back(machine.X_CW * X_WB);
  for (int i = 0; i < 8; ++i) {
    BoardView view;
    view.placement = 0;
    view.encoder_rad = 0.15 * (i - 4);
    view.corners = viewer.corners(machine.turned(view.encoder_rad) * X_WB);
    input.views.push_back(std::move(view));
  }
  auto observations = arrange(input);
  if (!observations) throw std::runtime_error(observations.error());
  for (ViewObservation& view : observations->views) {
    for (LineObservation& line : view.lines) line.plane = line.laser;
    view.pose = std::min(view.view, 12);
  }
  for (LineObservation& line : observations->platter) line.plane = line.laser;
  scene.observations = std::move(*observations);
  return scene;
}

// Equation (8): the covariance with the poses eliminated is the block of the whole inverse.
TEST(CalibrationTerms, CovarianceIsTheBlockOfTheWholeInverse) {
  const Scene scene = scene_of(TrueMachine());
  const Estimate& estimate = scene.estimate;
  const SharedInformation information = shared_information(scene.observations, estimate);
  EXPECT_TRUE(information.determined);

  const SharedLayout layout(estimate);
  Parameters parameters(estimate);
  std::map<const double*, int> column = {{parameters.camera.data(), layout.camera},
                                         {parameters.print.data(), layout.print},
                                         {parameters.axis.data(), layout.axis},
                                         {parameters.turn.data(), layout.turn},
                                         {parameters.platter.data(), layout.platter}};
  for (std::size_t i = 0; i < 2; ++i) column[parameters.planes[i].data()] = layout.planes[i];
  int total = layout.size;
  for (auto& pose : parameters.poses) {
    column[pose.data()] = total;
    total += 6;
  }
  Eigen::MatrixXd N = Eigen::MatrixXd::Zero(total, total);
  for (const Term& term : terms_of(scene.observations, estimate, parameters)) {
    const auto& sizes = term.cost->parameter_block_sizes();
    const int count = term.cost->num_residuals();
    using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    std::vector<Rows> jacobians;
    std::vector<double*> targets;
    for (int size : sizes) jacobians.emplace_back(Rows::Zero(count, size));
    for (auto& jacobian : jacobians) targets.push_back(jacobian.data());
    Eigen::VectorXd r(count);
    ASSERT_TRUE(term.cost->Evaluate(term.blocks.data(), r.data(), targets.data()));
    Eigen::MatrixXd J = Eigen::MatrixXd::Zero(count, total);
    for (std::size_t b = 0; b < sizes.size(); ++b) J.middleCols(column.at(term.blocks[b]), sizes[b]) = jacobians[b];
    N += J.transpose() * J;
  }
  // An LU of the matrix with a unit diagonal.
  const Eigen::VectorXd unit = N.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd whole =
      unit.asDiagonal() * (unit.asDiagonal() * N * unit.asDiagonal()).partialPivLu().inverse() * unit.asDiagonal();
  for (int i = 0; i < layout.size; ++i) {
    EXPECT_NEAR(information.covariance(i, i) / whole(i, i), 1, 1e-4) << i;
    for (int k = 0; k < i; ++k) {
      EXPECT_NEAR(information.covariance(i, k), whole(i, k), 1e-4 * std::sqrt(whole(i, i) * whole(k, k)));
    }
  }
}

// Equations (9) and (10): parameters drawn from the covariance, and the radius of each drawn calibration by a ray, a
// plane and a line; with the scale known, what is left of its spread after a regression on the mean pitch.
TEST(CalibrationTerms, RadiusUncertaintyIsTheSpreadOfDrawnCalibrations) {
  const Scene scene = scene_of(TrueMachine());
  const Estimate& estimate = scene.estimate;
  std::vector<VolumePoint> volume = volume_of(scene.observations, estimate);
  ASSERT_GT(volume.size(), 100u);
  for (std::size_t k : {std::size_t{0}, volume.size() / 2, volume.size() - 1}) {
    const VolumePoint place = volume[k];
    SharedInformation information = shared_information(scene.observations, estimate);
    information.chi_square = information.degrees_of_freedom;  // no more than stated
    information.groupings.clear();
    const Eigen::MatrixXd C = information.covariance;
    const Uncertainty uncertainty(estimate, std::move(information), {place});
    const SharedLayout& layout = uncertainty.layout();
    // C ~ L L^T with the unit taken out, for the numbers differ by orders of magnitude.
    const Eigen::VectorXd unit = C.diagonal().cwiseSqrt();
    const Eigen::MatrixXd scaled = unit.cwiseInverse().asDiagonal() * C * unit.cwiseInverse().asDiagonal();
    const Eigen::MatrixXd L = unit.asDiagonal() * Eigen::MatrixXd(scaled.llt().matrixL());
    std::mt19937_64 random(k);
    std::normal_distribution<double> normal;
    constexpr int kDraws = 4000;
    Eigen::VectorXd radii(kDraws), scales(kDraws);
    for (int draw = 0; draw < kDraws; ++draw) {
      Eigen::VectorXd x(layout.size);
      for (double& value : x) value = normal(random);
      x = (L * x).eval();
      Parameters parameters(estimate);
      for (int i = 0; i < 9; ++i) parameters.camera[static_cast<std::size_t>(i)] += x[layout.camera + i];
      for (int i = 0; i < 4; ++i) parameters.axis[static_cast<std::size_t>(i)] += x[layout.axis + i];
      for (int i = 0; i < 3; ++i)
        parameters.planes[place.plane][static_cast<std::size_t>(i)] += x[layout.planes[place.plane] + i];
      const Estimate drawn = parameters.moved(estimate);
      const PlaneEstimate& plane = drawn.planes[place.plane];
      const Vector3d v = ray_of(drawn.camera.data(), place.p_px).v;
      const Vector3d p = v * plane.distance_mm / plane.normal_C.dot(v);
      radii[draw] = (p - drawn.axis->point_C).cross(drawn.axis->direction_C).norm();
      scales[draw] = 0.5 * (x[layout.print] + x[layout.print + 1]);
    }
    const Eigen::VectorXd r = radii.array() - radii.mean(), s = scales.array() - scales.mean();
    const double slope = r.dot(s) / s.squaredNorm();
    // A standard deviation of 4000 draws is known to 1.1 %.
    EXPECT_NEAR(uncertainty.radius(Uncertainty::Scale::included) / (r.norm() / std::sqrt(kDraws)), 1, 0.05);
    EXPECT_NEAR(uncertainty.radius(Uncertainty::Scale::known) / ((r - slope * s).norm() / std::sqrt(kDraws)), 1, 0.05);
  }
}

}  // namespace
}  // namespace celadon::calibrate
