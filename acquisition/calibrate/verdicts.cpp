#include "acquisition/calibrate/verdicts.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <set>

#include "acquisition/calibrate/step_judge.h"
#include "acquisition/calibrate/stop_verdicts.h"
#include "acquisition/lens.h"

namespace celadon::calibrate {
namespace {

using Eigen::Vector3d;

/// Prints that nobody measured come with 0.3 %.
constexpr double kBelowUnmeasured = 0.299;
constexpr double kDegree = std::numbers::pi / 180;

/// Which way the boards of the used views looked.
struct Tilts {
  double largest_deg = 0;  ///< from facing the camera
  double spread_deg = 0;   ///< standard deviation in the direction in which they differ least
  double widest_deg = 0;   ///< and most
};

Tilts tilts_of(const Observations& observations, const Estimate& estimate) {
  Tilts out;
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  Eigen::Matrix2d squares = Eigen::Matrix2d::Zero();
  double count = 0;
  for (const ViewObservation& view : observations.views) {
    if (!view.used) continue;
    const Eigen::Isometry3d X_CB = pose_of(estimate, view);
    const Vector3d m = X_CB.linear().col(2), towards = X_CB.translation().normalized();
    const double facing = std::acos(std::min(1.0, std::abs(m.dot(towards))));
    out.largest_deg = std::max(out.largest_deg, facing / kDegree);
    const Eigen::Vector2d lean = m.head<2>() * (m.z() < 0 ? -1 : 1);
    sum += lean;
    squares += lean * lean.transpose();
    count += 1;
  }
  if (count == 0) return out;
  const Eigen::Vector2d values =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(squares / count - sum * sum.transpose() / (count * count))
          .eigenvalues()
          .cwiseMax(0.0)
          .cwiseSqrt();
  out.spread_deg = std::asin(std::min(1.0, values[0])) / kDegree;
  out.widest_deg = std::asin(std::min(1.0, values[1])) / kDegree;
  return out;
}

/// Share of the picture, in cells of a grid, that held corners.
double coverage_of(const Observations& observations, int width_px, int height_px) {
  constexpr int kColumns = 8, kRows = 6;
  std::set<std::pair<int, int>> cells;
  for (const ViewObservation& view : observations.views) {
    if (!view.used) continue;
    for (const CornerObservation& corner : view.corners) {
      if (!(corner.weight > 0)) continue;
      const int column = static_cast<int>((corner.p_px.x() + 0.5) / width_px * kColumns);
      const int row = static_cast<int>((corner.p_px.y() + 0.5) / height_px * kRows);
      cells.emplace(std::clamp(column, 0, kColumns - 1), std::clamp(row, 0, kRows - 1));
    }
  }
  return static_cast<double>(cells.size()) / (kColumns * kRows);
}

CalibrationStep judge_views(const Observations& observations, const CalibrationSolution& solution) {
  StepJudge judge("views");
  std::string list;
  for (int view : solution.left_out) list += (list.empty() ? " (" : ", ") + std::to_string(view);
  if (!list.empty()) list += ")";
  const double total = static_cast<double>(observations.views.size());
  judge.at_most("views that disagree with the others and are left out" + list + ":",
                100 * static_cast<double>(solution.left_out.size()) / total, " %", 10, 40,
                "take these views again with the board and the table at rest, and see that the board is flat and is "
                "the one given");
  return judge.step();
}

CalibrationStep judge_camera(const CalibrationInput& input, const Observations& observations, const Estimate& estimate,
                             const Uncertainty& uncertainty, const CalibrationSolution& solution) {
  StepJudge judge("camera");
  const std::string more_views =
      "show the board in more poses, tilted in all directions and near all edges of the picture";
  if (!uncertainty.information().determined) {
    judge.say(Verdict::refused, "the views leave a combination of the parameters free", more_views);
  }
  judge.at_most("error of held-out views", solution.held_out_rms_px, " px", 0.2, 0.6,
                "take sharp, evenly lit pictures of a flat board at rest");
  judge.at_least("corners in", 100 * coverage_of(observations, input.width_px, input.height_px), " % of the picture",
                 70, 40, "bring the board near the edges and corners of the picture");
  const Tilts tilts = tilts_of(observations, estimate);
  const bool one_way = tilts.widest_deg > 3 * tilts.spread_deg && tilts.widest_deg > 8;
  judge.at_least(
      "all views lie within " + figure(tilts.largest_deg) + " degrees of facing the camera, their tilts spread by",
      tilts.spread_deg, " degrees", 8, 4,
      one_way ? "tilt the board about the other direction too: its tilts differ in one direction only"
              : "tilt the board more, to all sides: all views lie within " + figure(tilts.largest_deg) +
                    " degrees of facing the camera");
  const CameraParameters& c = estimate.camera;
  judge.at_most("u(fx)/fx", uncertainty.of(0) / c[0], "", 1e-3, 5e-3, more_views);
  judge.at_most("u(fy)/fy", uncertainty.of(1) / c[1], "", 1e-3, 5e-3, more_views);
  judge.at_most("u(cx)", uncertainty.of(2), " px", 3, 15, more_views);
  judge.at_most("u(cy)", uncertainty.of(3), " px", 3, 15, more_views);
  if (!invertible(solution.calibration.camera_model)) {
    judge.say(Verdict::refused, "the distortion folds within the picture",
              "bring the board near the edges and corners of the picture");
  }
  if (uncertainty.inflation() > 1) {
    judge.at_most("the residuals are larger than the stated noise, and all uncertainties are multiplied by",
                  uncertainty.inflation(), "", 3, 10,
                  "see that the board is flat and the pictures are sharp and still");
  }
  return judge.step();
}

std::vector<CalibrationStep> judge_lasers(const Observations& observations, const Estimate& estimate,
                                          const Uncertainty& uncertainty) {
  struct Seen {
    int poses = 0, left_out = 0;
    double nearest = std::numeric_limits<double>::infinity(), farthest = 0;
    int plane = -1;
  };
  std::map<int, Seen> lasers;
  for (const LineObservation& line : observations.platter) lasers[line.laser];
  for (const ViewObservation& view : observations.views) {
    const Eigen::Isometry3d X_CB = pose_of(estimate, view);
    for (const LineObservation& line : view.lines) {
      Seen& seen = lasers[line.laser];
      seen.plane = line.plane;
      if (!view.used || line.points.empty()) continue;
      if (!line.used) {
        ++seen.left_out;
        continue;
      }
      ++seen.poses;
      const Vector3d m = X_CB.linear().col(2);
      for (const PointObservation& point : line.points) {
        if (!(point.weight > 0)) continue;
        const Ray ray = ray_of(estimate.camera.data(), point.p_px);
        const double depth = m.dot(X_CB.translation()) / m.dot(ray.v);
        seen.nearest = std::min(seen.nearest, depth);
        seen.farthest = std::max(seen.farthest, depth);
      }
    }
  }
  std::vector<CalibrationStep> out;
  if (lasers.empty()) {
    StepJudge judge("laser");
    judge.say(Verdict::refused, "no laser's line was seen on the board",
              "hold the board in the laser's light, in ten poses and more, and see that the laser is on");
    out.push_back(judge.step());
  }
  for (const auto& [laser, seen] : lasers) {
    StepJudge judge("laser " + std::to_string(laser));
    const std::string more = "hold the board in the laser's light in more poses, near and far";
    if (seen.plane < 0) {
      judge.say(Verdict::refused,
                "its line was seen on the board in " + std::to_string(seen.poses) + " poses, which do not span a plane",
                more);
      out.push_back(judge.step());
      continue;
    }
    const auto plane = static_cast<std::size_t>(seen.plane);
    judge.at_least("seen on the board in", seen.poses, " poses", 10, 3, more);
    const double range =
        seen.farthest > 0 ? (seen.farthest - seen.nearest) / (0.5 * (seen.farthest + seen.nearest)) : 0;
    judge.at_least("range of depth / depth", range, "", 0.15, 0.05, more);
    judge.at_most("the plane within the volume is known to", uncertainty.plane_place(plane, Uncertainty::Scale::known),
                  " mm", 0.15, 0.5, more);
    if (seen.left_out > 0) {
      judge.at_most(
          "lines that do not lie in the plane and are left out:", 100.0 * seen.left_out / (seen.poses + seen.left_out),
          " %", 10, 40, "keep the board still between the picture of the board and that of the line");
    }
    out.push_back(judge.step());
  }
  return out;
}

/// What the placements were seen at.
struct Motions {
  int views = 0;
  double largest_span_rad = 0;  ///< of one placement, true angle
};

Motions motions_of(const Observations& observations, const Estimate& estimate) {
  Motions out;
  std::map<int, std::pair<double, double>> spans;
  for (const ViewObservation& view : observations.views) {
    if (!view.used || !view.turned() || !view.at_zero()) continue;
    ++out.views;
    const auto [at, first] = spans.try_emplace(view.placement, view.encoder_rad, view.encoder_rad);
    if (first) continue;
    at->second.first = std::min(at->second.first, view.encoder_rad);
    at->second.second = std::max(at->second.second, view.encoder_rad);
  }
  for (const auto& [placement, span] : spans) {
    out.largest_span_rad = std::max(out.largest_span_rad, std::abs(estimate.axis->turn) * (span.second - span.first));
  }
  return out;
}

CalibrationStep judge_axis(const Observations& observations, const Estimate& estimate, const Uncertainty& uncertainty) {
  StepJudge judge("axis");
  const Motions motions = motions_of(observations, estimate);
  const std::string wider = "leave the board on the platter and turn the table further, as long as the board is seen";
  judge.at_least("the board on the platter seen at", motions.views, " angles", 12, 5, wider);
  judge.at_least("turned by up to", motions.largest_span_rad / kDegree, " degrees", 60, 20, wider);
  judge.at_most("u(direction)", uncertainty.worst_of_two(uncertainty.layout().axis), " rad", 6e-4, 3e-3, wider);
  judge.at_most("u(position)", uncertainty.axis_place(Uncertainty::Scale::known), " mm", 0.15, 0.5, wider);
  for (std::size_t i = 0; i < estimate.planes.size(); ++i) {
    judge.at_most("u(distance from the plane of laser " + std::to_string(estimate.planes[i].laser) + ")",
                  uncertainty.axis_from_plane(i, Uncertainty::Scale::known), " mm", 0.03, 0.15, wider);
  }
  if (!estimate.planes.empty()) {
    judge.at_most("a radius within the volume is known to", uncertainty.radius(Uncertainty::Scale::known), " mm", 0.05,
                  0.2, wider);
    judge.say(Verdict::good,
              "with the scale's part to " + figure(uncertainty.radius(Uncertainty::Scale::included)) + " mm");
  }
  return judge.step();
}

CalibrationStep judge_encoder(const Observations& observations, const Estimate& estimate,
                              const Uncertainty& uncertainty) {
  StepJudge judge("encoder");
  const Motions motions = motions_of(observations, estimate);
  const std::string wider = "leave the board on the platter and turn the table further, as long as the board is seen";
  const double scale = std::abs(estimate.axis->turn);
  judge.say(Verdict::good, "true angle / encoder angle " + std::to_string(scale) + ", direction " +
                               (estimate.axis->turn > 0 ? "+1" : "-1"));
  judge.at_least("turned by up to", motions.largest_span_rad / kDegree, " degrees", 60, 20, wider);
  judge.at_most("u(scale)/scale", uncertainty.of(uncertainty.layout().turn) / scale, "", 3e-4, 3e-3, wider);
  judge.at_most("|scale - 1|", std::abs(scale - 1), "", 0.02, 0.2,
                "see that the controller's steps per turn are those of this table");
  const int once = uncertainty.layout().turn + 1;
  judge.at_most("error once a turn", estimate.axis->once_a_turn_rad.norm(), " rad", 0.01, 0.05,
                "have the encoder's disc centred on the axis");
  judge.at_most("known to", uncertainty.worst_of_two(once), " rad", 3e-4, 3e-3,
                "stand the board where it faces the camera for each placement, the table turned on as the program "
                "turns it, so that the placements together show the whole turn");
  return judge.step();
}

CalibrationStep judge_scale(const CalibrationInput& input, const Estimate& estimate, const Uncertainty& uncertainty) {
  StepJudge judge("scale");
  const std::string measure = "measure the print along x and y, over its whole length, and give true / nominal length";
  const double u = std::max(input.pitch_x.u / input.pitch_x.value, input.pitch_y.u / input.pitch_y.value);
  judge.at_most("the print's length is known to", 100 * u, " %", kBelowUnmeasured, 1, measure);
  judge.say(Verdict::good, "lengths to " + figure(100 * uncertainty.scale()) + " %");
  const Eigen::Vector2d off((estimate.pitch.x() - input.pitch_x.value) / std::max(input.pitch_x.u, 1e-7),
                            (estimate.pitch.y() - input.pitch_y.value) / std::max(input.pitch_y.u, 1e-7));
  judge.at_most("the views' ratio of x and y differs from the measured one by", off.norm(), " standard deviations", 3.5,
                10, "measure the print along x and y again: their ratio is not what the views show");
  return judge.step();
}

CalibrationStep judge_platter(const Estimate& estimate, const Observations& observations,
                              const Uncertainty& uncertainty) {
  StepJudge judge("platter");
  const std::string show = "take the platter off everything and take a picture of each laser's line on it";
  int used = 0, off = 0;
  for (const LineObservation& line : observations.platter) {
    if (line.plane < 0) continue;
    for (const PointObservation& point : line.points) {
      const bool counts = line.used && point.weight > 0;
      used += counts;
      off += !counts;
    }
  }
  if (!estimate.platter || used == 0) {
    judge.say(Verdict::usable,
              "no line on the bare platter was used: z = 0 is one square below the lowest corner that stood on the "
              "platter, and heights may be off by the board's margin",
              show);
    return judge.step();
  }
  judge.at_least("points on the bare platter:", used, "", 50, 10, show);
  judge.at_most("of them beside it:", 100.0 * off / (used + off), " %", 10, 50, show);
  judge.at_most("u(z = 0)", uncertainty.of(uncertainty.layout().platter, Uncertainty::Scale::known), " mm", 0.2, 1,
                show);
  const int slopes = uncertainty.layout().platter + 1;
  const double slope = estimate.platter->slope.norm(), u = uncertainty.worst_of_two(slopes);
  // A slope counts as seen beyond three standard deviations.
  judge.at_most("tilt against the axis " + figure(slope) + " +- " + figure(u) + " rad, surely more than",
                std::max(0.0, slope - 3 * u), " rad", 0.002, 0.02, "clean the platter and seat it level on the axis");
  return judge.step();
}

}  // namespace

std::vector<CalibrationStep> judge(const CalibrationInput& input, const Observations& observations,
                                   const Estimate& estimate, const Uncertainty& uncertainty,
                                   const CalibrationSolution& solution) {
  std::vector<CalibrationStep> steps = {judge_views(observations, solution),
                                        judge_camera(input, observations, estimate, uncertainty, solution)};
  for (CalibrationStep& step : judge_lasers(observations, estimate, uncertainty)) steps.push_back(std::move(step));
  steps.push_back(judge_axis(observations, estimate, uncertainty));
  steps.push_back(judge_encoder(observations, estimate, uncertainty));
  steps.push_back(judge_scale(input, estimate, uncertainty));
  steps.push_back(judge_platter(estimate, observations, uncertainty));
  for (CalibrationStep& step : judge_stops(observations, estimate, uncertainty, solution)) {
    steps.push_back(std::move(step));
  }
  return steps;
}

}  // namespace celadon::calibrate
