#include "acquisition/calibrate/observations.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "acquisition/calibrate/line_distance.h"

namespace celadon::calibrate {
namespace {

constexpr int kFewestCorners = 8;

bool plausible(const Eigen::Vector2d& p_px, double sigma_px) {
  return p_px.allFinite() && std::isfinite(sigma_px) && sigma_px > 0;
}

tl::expected<LineObservation, std::string> arrange_line(const SeenLine& seen, const std::string& where) {
  LineObservation line;
  line.laser = seen.laser;
  for (const SeenLinePoint& point : seen.points) {
    if (!plausible(point.p_px, point.sigma_px)) {
      return tl::unexpected("a line point of laser " + std::to_string(seen.laser) + " in " + where +
                            " has no finite place or no positive standard deviation; leave it out");
    }
    line.points.push_back({.p_px = point.p_px, .sigma_px = point.sigma_px});
  }
  return line;
}

}  // namespace

tl::expected<Observations, std::string> arrange(const CalibrationInput& input) {
  if (input.width_px < 16 || input.height_px < 16) {
    return tl::unexpected("pictures of " + std::to_string(input.width_px) + " x " + std::to_string(input.height_px) +
                          " pixels calibrate nothing; give the camera's picture size");
  }
  for (const Measured& pitch : {input.pitch_x, input.pitch_y}) {
    if (!(pitch.value > 0.5 && pitch.value < 2 && pitch.u >= 0 && std::isfinite(pitch.u))) {
      return tl::unexpected("a print pitch of " + std::to_string(pitch.value) + " +- " + std::to_string(pitch.u) +
                            " cannot be; give measured length / nominal length, near 1");
    }
  }
  Observations out;
  // Halfway places of boards with an even number of corners and rounding fall on no border.
  const auto half_of = [&](const Eigen::Vector2d& p_mm) {
    const Eigen::Vector2d squares = (p_mm / input.board.square_mm()).array() + 0.25;
    return (static_cast<int>(std::floor(squares.x())) + static_cast<int>(std::floor(squares.y()))) & 1;
  };
  for (const BoardCorner& corner : input.board.corners()) {
    out.places[corner.id] = corner.p_mm;
    out.board_radius_mm = std::max(out.board_radius_mm, corner.p_mm.norm());
  }
  out.pitch_x = input.pitch_x;
  out.pitch_y = input.pitch_y;
  for (std::size_t i = 0; i < input.views.size(); ++i) {
    const BoardView& seen = input.views[i];
    const std::string where = "view " + std::to_string(i);
    ViewObservation view;
    view.view = view.pose = static_cast<int>(i);
    view.placement = std::max(seen.placement, BoardView::kHeld);
    view.encoder_rad = seen.encoder_rad;
    if (!std::isfinite(seen.encoder_rad)) {
      return tl::unexpected("the encoder angle of " + where + " is not finite; leave the view out");
    }
    view.stop = seen.stop;
    if (!std::isfinite(seen.stop.elevation_rad) || !std::isfinite(seen.stop.lift_mm)) {
      return tl::unexpected("what head or lift read in " + where + " is not finite; leave the view out");
    }
    for (const SeenCorner& corner : seen.corners) {
      const auto place = out.places.find(corner.id);
      if (place == out.places.end()) {
        return tl::unexpected("corner " + std::to_string(corner.id) + " in " + where + " is not on the board " +
                              std::to_string(input.board.columns()) + " x " + std::to_string(input.board.rows()) +
                              "; give the board that was used");
      }
      if (!plausible(corner.p_px, corner.sigma_px)) {
        return tl::unexpected("corner " + std::to_string(corner.id) + " in " + where +
                              " has no finite place or no positive standard deviation; leave it out");
      }
      view.corners.push_back(
          {.p_mm = place->second, .p_px = corner.p_px, .sigma_px = corner.sigma_px, .half = half_of(place->second)});
    }
    for (const SeenLine& line : seen.lines) {
      auto arranged = arrange_line(line, where);
      if (!arranged) return tl::unexpected(arranged.error());
      view.lines.push_back(std::move(*arranged));
    }
    view.used = view.corners.size() >= kFewestCorners;
    out.views.push_back(std::move(view));
  }
  for (const SeenLine& line : input.platter) {
    auto arranged = arrange_line(line, "the platter's picture");
    if (!arranged) return tl::unexpected(arranged.error());
    out.platter.push_back(std::move(*arranged));
  }
  return out;
}

Eigen::Isometry3d pose_at_zero(const Estimate& estimate, const ViewObservation& view) {
  const Eigen::Isometry3d& X_CB = estimate.X_CB[static_cast<std::size_t>(view.pose)];
  if (!view.turned() || !estimate.axis) return X_CB;
  const AxisEstimate& axis = *estimate.axis;
  const Eigen::AngleAxisd turn(axis.turned_rad(view.reference_rad, view.encoder_rad), axis.direction_C);
  return Eigen::Translation3d(axis.point_C) * turn * Eigen::Translation3d(-axis.point_C) * X_CB;
}

Eigen::Isometry3d pose_of(const Estimate& estimate, const ViewObservation& view) {
  const Eigen::Isometry3d X_CB = pose_at_zero(estimate, view);
  return view.turned() ? seen_from_stop(estimate, view.stop) * X_CB : X_CB;
}

void update_residuals(const Estimate& estimate, Observations& observations) {
  const double* camera = estimate.camera.data();
  // Where nothing can be computed the observation is as wrong as can be.
  constexpr double kImpossible = 1e6;
  for (ViewObservation& view : observations.views) {
    const Eigen::Isometry3d X_CB = pose_of(estimate, view);
    for (CornerObservation& corner : view.corners) {
      const Eigen::Vector3d p_C = X_CB * on_board(estimate, corner.p_mm);
      corner.residual.setConstant(kImpossible);
      if (p_C.z() > 0) {
        corner.residual = (project(camera, p_C.x() / p_C.z(), p_C.y() / p_C.z()).p_px - corner.p_px) / corner.sigma_px;
      }
    }
    for (LineObservation& line : view.lines) {
      if (line.plane < 0) continue;
      const PlaneEstimate& plane = estimate.planes[static_cast<std::size_t>(line.plane)];
      for (PointObservation& point : line.points) {
        const LineDistance at = line_on_board(estimate, X_CB, point.p_px, plane).at;
        point.distance_mm = at.height_mm;
        point.residual = at.exists && at.definite ? at.distance_px / point.sigma_px : kImpossible;
      }
    }
  }
  if (!estimate.platter) return;
  for (LineObservation& line : observations.platter) {
    if (line.plane < 0) continue;
    const PlaneEstimate& plane = estimate.planes[static_cast<std::size_t>(line.plane)];
    const AxisEstimate& axis = *estimate.axis;
    const Eigen::Vector3d up = axis.direction_C - axis.across_C * estimate.platter->slope;
    for (PointObservation& point : line.points) {
      const LineDistance at = line_distance(camera, point.p_px, plane.normal_C, plane.distance_mm, up,
                                            up.dot(axis.point_C) + estimate.platter->height_mm);
      point.distance_mm = at.height_mm;
      point.residual = at.exists && at.definite ? at.distance_px / point.sigma_px : kImpossible;
    }
  }
}

}  // namespace celadon::calibrate
