#include "acquisition/calibrate/calibration_solver.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "acquisition/calibrate/adjustment.h"
#include "acquisition/calibrate/held_out.h"
#include "acquisition/calibrate/initial_axis.h"
#include "acquisition/calibrate/initial_camera.h"
#include "acquisition/calibrate/initial_planes.h"
#include "acquisition/calibrate/initial_stops.h"
#include "acquisition/calibrate/time_solver.h"
#include "acquisition/calibrate/time_verdict.h"
#include "acquisition/calibrate/uncertainty.h"
#include "acquisition/calibrate/verdicts.h"
#include "acquisition/calibration_change.h"

namespace celadon {
namespace {

using namespace calibrate;

/// Without a platter: the origin goes one square below the lowest corner that stood on it.
void lower_origin(Estimate& estimate, const Observations& observations, double square_mm) {
  AxisEstimate& axis = *estimate.axis;
  double lowest = std::numeric_limits<double>::infinity();
  for (const ViewObservation& view : observations.views) {
    if (!view.used || !view.turned()) continue;
    const Eigen::Isometry3d X_CB = pose_at_zero(estimate, view);
    for (const CornerObservation& corner : view.corners) {
      const Eigen::Vector3d p_C = X_CB * Eigen::Vector3d(corner.p_mm.x(), corner.p_mm.y(), 0);
      lowest = std::min(lowest, axis.direction_C.dot(p_C - axis.point_C));
    }
  }
  axis.point_C += (lowest - square_mm) * axis.direction_C;
}

std::vector<int> left_out(const Observations& observations) {
  std::vector<int> out;
  for (const ViewObservation& view : observations.views) {
    bool line_off = false;
    for (const LineObservation& line : view.lines) line_off = line_off || (line.plane >= 0 && !line.used);
    if (!view.used || line_off) out.push_back(view.view);
  }
  return out;
}

void set_figures(const Observations& observations, CalibrationSolution& solution) {
  double corner_squares = 0, line_squares = 0;
  int corners = 0, points = 0;
  for (const ViewObservation& view : observations.views) {
    if (!view.used) continue;
    for (const CornerObservation& corner : view.corners) {
      if (!(corner.weight > 0)) continue;
      corner_squares += (corner.residual * corner.sigma_px).squaredNorm();
      ++corners;
    }
    for (const LineObservation& line : view.lines) {
      if (!line.used || line.plane < 0) continue;
      for (const PointObservation& point : line.points) {
        if (!(point.weight > 0)) continue;
        line_squares += point.distance_mm * point.distance_mm;
        ++points;
      }
    }
  }
  solution.corner_rms_px = std::sqrt(corner_squares / std::max(1, corners));
  solution.line_rms_mm = std::sqrt(line_squares / std::max(1, points));
}

/// Of the numbers that the calibration holds; the print's pitch, the board's sag and the platter's slope are none of
/// them.
CalibrationCovariance covariance_in(const Calibration& calibration, const Uncertainty& uncertainty) {
  CalibrationCovariance out;
  std::vector<Eigen::Index> columns;
  const std::vector<std::string> names = uncertainty.names();
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (!has_parameter(calibration, names[i])) continue;
    out.names.push_back(names[i]);
    columns.push_back(static_cast<Eigen::Index>(i));
  }
  out.matrix = uncertainty.covariance()(columns, columns);
  return out;
}

/// Elevation axis and lift in the scanner's frame, where they are known.
void set_axes(const Estimate& estimate, const Uncertainty& uncertainty, Calibration& calibration) {
  const Eigen::Isometry3d X_WC = calibration.axis.X_CW.inverse();
  const SharedLayout& layout = uncertainty.layout();
  if (estimate.elevation) {
    ElevationAxis& axis = calibration.elevation.emplace();
    axis.origin_mm = X_WC * estimate.elevation->point_C;
    axis.direction = (X_WC.linear() * estimate.elevation->direction_C).normalized();
    axis.u_direction_rad = uncertainty.worst_of_two(layout.elevation);
    axis.u_origin_mm = uncertainty.worst_of_two(layout.elevation + 2);
    axis.scale = {estimate.elevation->scale, uncertainty.of(layout.elevation + 4)};
  }
  if (estimate.lift) {
    LiftAxis& axis = calibration.lift.emplace();
    axis.direction = (X_WC.linear() * estimate.lift->direction_C).normalized();
    axis.u_direction_rad = uncertainty.worst_of_two(layout.lift);
    axis.scale = {estimate.lift->scale, uncertainty.of(layout.lift + 2)};
  }
}

Calibration calibration_of(const CalibrationInput& input, const Estimate& estimate, const Uncertainty& uncertainty) {
  Calibration out;
  CameraModel& camera = out.camera_model;
  camera.width_px = input.width_px;
  camera.height_px = input.height_px;
  const auto parameter = [&](int i) {
    return Measured{estimate.camera[static_cast<std::size_t>(i)], uncertainty.of(i)};
  };
  camera.fx_px = parameter(0);
  camera.fy_px = parameter(1);
  camera.cx_px = parameter(2);
  camera.cy_px = parameter(3);
  for (int i = 0; i < 5; ++i) camera.distortion[static_cast<std::size_t>(i)] = parameter(4 + i);

  const SharedLayout& layout = uncertainty.layout();
  for (std::size_t i = 0; i < estimate.planes.size(); ++i) {
    const PlaneEstimate& plane = estimate.planes[i];
    out.lasers.push_back({.laser = plane.laser,
                          .normal_C = plane.normal_C,
                          .distance_mm = plane.distance_mm,
                          .u_normal_rad = uncertainty.worst_of_two(layout.planes[i]),
                          .u_distance_mm = uncertainty.plane_distance(i)});
  }
  out.axis.X_CW = scanner_frame(estimate);
  out.axis.u_direction_rad = uncertainty.worst_of_two(layout.axis);
  out.axis.u_position_mm = uncertainty.worst_of_two(layout.axis + 2);
  const AxisEstimate& axis = *estimate.axis;
  const double direction = axis.turn < 0 ? -1 : 1;
  out.encoder = {{direction * axis.turn, uncertainty.of(layout.turn)},
                 {direction * axis.once_a_turn_rad.x(), uncertainty.of(layout.turn + 1)},
                 {direction * axis.once_a_turn_rad.y(), uncertainty.of(layout.turn + 2)},
                 direction};
  out.scale = {1, uncertainty.scale()};
  out.systematic_mm = uncertainty.radius(Uncertainty::Scale::included);
  set_axes(estimate, uncertainty, out);
  out.covariance = covariance_in(out, uncertainty);
  return out;
}

}  // namespace

tl::expected<CalibrationSolution, std::string> solve_calibration(const CalibrationInput& input) {
  auto observations = arrange(input);
  if (!observations) return tl::unexpected(observations.error());
  auto estimate = initial_camera(*observations, input.width_px, input.height_px);
  if (!estimate) return tl::unexpected(estimate.error());
  estimate = adjusted(*observations, *estimate);
  if (!estimate) return tl::unexpected(estimate.error());

  estimate->axis = initial_axis(*estimate, *observations);
  if (!estimate->axis) {
    return tl::unexpected(std::string(
        "no placement of the board on the platter was seen at two angles a degree and more apart, so nothing shows the "
        "axis; stand the board on the platter and turn the table between views"));
  }
  const std::vector<Eigen::Isometry3d> own_X_CB = estimate->X_CB;
  gather_placements(*estimate, *observations);
  initial_stops(own_X_CB, *estimate, *observations);
  initial_planes(*estimate, *observations);
  initial_platter(*estimate, *observations);
  estimate = adjusted(*observations, *estimate);
  if (!estimate) return tl::unexpected(estimate.error());
  if (!estimate->platter) lower_origin(*estimate, *observations, input.board.square_mm());
  const Estimate solved = anchored(*estimate);

  const Uncertainty uncertainty(solved, shared_information(*observations, solved), volume_of(*observations, solved));
  CalibrationSolution out;
  out.calibration = calibration_of(input, solved, uncertainty);
  set_figures(*observations, out);
  const HeldOutErrors held_out = held_out_errors(*observations, solved);
  out.held_out_rms_px = held_out.corner_px;
  out.held_out_raised_px = held_out.raised_px;
  out.held_out_lifted_px = held_out.lifted_px;
  out.left_out = left_out(*observations);
  out.names = uncertainty.names();
  out.covariance = uncertainty.covariance();
  out.chi_square = uncertainty.information().chi_square;
  out.degrees_of_freedom = uncertainty.information().degrees_of_freedom;
  out.steps = judge(input, *observations, solved, uncertainty, out);
  out.calibration.time = input.assumed_time;
  if (!input.sweeps.empty()) {
    const auto time = estimate_time(input.sweeps, input.assumed_time, solved, *observations);
    if (time) out.calibration.time = time->time;
    out.steps.push_back(judge_time(time, input.height_px));
  }
  out.verdict = Verdict::good;
  for (const CalibrationStep& step : out.steps) out.verdict = std::max(out.verdict, step.verdict);
  return out;
}

}  // namespace celadon
