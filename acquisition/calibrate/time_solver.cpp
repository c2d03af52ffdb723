#include "acquisition/calibrate/time_solver.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

namespace celadon::calibrate {
namespace {

constexpr int kFewestInFrame = 8;   // of a frame that counts, as of a view at rest
constexpr int kFewestViews = 3;     // of a sweep
constexpr int kPassRounds = 6;      // of Gauss and Newton; corners that are off are left out after the first three
constexpr double kOff_sigma = 5.5;  // as with views at rest
constexpr double kOtherExposure = 1.5;

/// One sweep, brought down to what it says: the table is seen `ahead` of what the encoder reads at the stamps, in a
/// row as far from the top as the middle of all corners, and by `per_row` more in each row below. Of the encoder.
struct SweepAngles {
  int placement = 0;
  double speed_rad_per_s = 0, exposure_ns = 0, row = 0;
  double ahead_rad = 0, per_row_rad = 0;
  double u_ahead_rad = 0, u_per_row_rad = 0;  ///< by the scatter of the corners
  double u_clock_s = 0;
};

/// A placement's pose at the encoder angle that it refers to.
struct Placement {
  Eigen::Isometry3d X_CB = Eigen::Isometry3d::Identity();
  double reference_rad = 0;
};

/// A corner where it was seen, and where the table is to be for it.
struct PassingCorner {
  Eigen::Vector3d at_reference_C;  ///< on the board of the placement
  Eigen::Vector2d p_px;
  double sigma_px = 0, reference_rad = 0, encoder_rad = 0;
  bool used = true;
};

struct Predicted {
  Eigen::Vector2d p_px, by_angle_px;
};

std::optional<Predicted> predict(const Estimate& estimate, const PassingCorner& corner, double ahead_rad) {
  const AxisEstimate& axis = *estimate.axis;
  const Eigen::Vector3d from_axis =
      Eigen::AngleAxisd(axis.turned_rad(corner.reference_rad, corner.encoder_rad + ahead_rad), axis.direction_C) *
      (corner.at_reference_C - axis.point_C);
  const Eigen::Vector3d p = axis.point_C + from_axis;
  const Eigen::Vector3d move = axis.rate(corner.encoder_rad + ahead_rad) * axis.direction_C.cross(from_axis);
  if (!(p.z() > 0)) return std::nullopt;
  const Projection at = project(estimate.camera.data(), p.x() / p.z(), p.y() / p.z());
  const Eigen::Vector2d ray_by_angle = (move.head<2>() - p.head<2>() / p.z() * move.z()) / p.z();
  return Predicted{at.p_px, at.by_ray * ray_by_angle};
}

/// Equation (14), solved for one sweep.
std::optional<SweepAngles> angles_of(const BoardSweep& sweep, const Placement& placement, const Estimate& estimate,
                                     const std::map<int, Eigen::Vector2d>& places) {
  SweepAngles out;
  out.placement = sweep.placement;
  out.u_clock_s = std::numeric_limits<double>::infinity();
  std::vector<PassingCorner> corners;
  int views = 0;
  for (const MovingView& view : sweep.views) {
    if (view.corners.size() < kFewestInFrame || view.at_stamp.speed_rad_per_s == 0) continue;
    ++views;
    out.speed_rad_per_s += view.at_stamp.speed_rad_per_s;
    out.exposure_ns += static_cast<double>(view.exposure_ns);
    out.u_clock_s = std::min(out.u_clock_s, view.at_stamp.sigma_rad / std::abs(view.at_stamp.speed_rad_per_s));
    for (const SeenCorner& corner : view.corners) {
      const auto place = places.find(corner.id);
      if (place == places.end()) continue;
      corners.push_back({placement.X_CB * on_board(estimate, place->second), corner.p_px, corner.sigma_px,
                         placement.reference_rad, view.at_stamp.angle_rad});
      out.row += corner.p_px.y();
    }
  }
  if (views < kFewestViews || corners.empty()) return std::nullopt;
  out.speed_rad_per_s /= views;
  out.exposure_ns /= views;
  out.row /= static_cast<double>(corners.size());

  for (int round = 0; round < kPassRounds; ++round) {
    Eigen::Matrix2d N = Eigen::Matrix2d::Zero();
    Eigen::Vector2d b = Eigen::Vector2d::Zero();
    std::vector<double> squares;  // a corner's, in standard deviations
    for (PassingCorner& corner : corners) {
      const double row = corner.p_px.y() - out.row;
      const auto at = predict(estimate, corner, out.ahead_rad + out.per_row_rad * row);
      if (!at) return std::nullopt;
      const Eigen::Vector2d miss = (corner.p_px - at->p_px) / corner.sigma_px;
      const Eigen::Vector2d by = at->by_angle_px / corner.sigma_px;
      squares.push_back(miss.squaredNorm());
      if (!corner.used) continue;
      const Eigen::Vector2d which(1, row);
      N += by.squaredNorm() * which * which.transpose();
      b += by.dot(miss) * which;
    }
    const Eigen::Vector2d step = N.ldlt().solve(b);
    if (!step.allFinite() || !(N.determinant() > 0)) return std::nullopt;
    out.ahead_rad += step.x();
    out.per_row_rad += step.y();
    std::vector<double> sorted = squares;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    // Of two squared standard normal numbers the middle sum is 2 log 2.
    const double variance = std::max(1.0, *middle / (2 * std::log(2.0)));
    if (round >= kPassRounds / 2) {
      for (std::size_t i = 0; i < corners.size(); ++i) {
        corners[i].used = squares[i] < kOff_sigma * kOff_sigma * variance;
      }
    }
    const Eigen::Matrix2d C = variance * N.inverse();
    out.u_ahead_rad = std::sqrt(C(0, 0));
    out.u_per_row_rad = std::sqrt(C(1, 1));
  }
  return out;
}

/// What a standard deviation from few degrees of freedom has to be multiplied by for twice it to cover 95 %: Student's
/// quantile over 1.96, to 4 % by Hill's expansion from three on.
double student(int freedom) {
  if (freedom == 1) return 6.48;
  if (freedom == 2) return 2.2;
  const double z = 1.96, n = freedom;
  return 1 + (z * z + 1) / (4 * n) + (5 * z * z * z * z + 16 * z * z + 3) / (96 * n * n);
}

/// Line time by the rows of all sweeps, equation (15): weighted mean, its uncertainty from the scatter if that is more.
Measured line_time_s(const std::vector<SweepAngles>& sweeps) {
  double weights = 0, sum = 0;
  for (const SweepAngles& s : sweeps) {
    const double weight = std::pow(s.speed_rad_per_s / s.u_per_row_rad, 2);
    weights += weight;
    sum += weight * s.per_row_rad / s.speed_rad_per_s;
  }
  const double mean = sum / weights;
  double chi_square = 0;
  for (const SweepAngles& s : sweeps) {
    chi_square += std::pow((s.per_row_rad - s.speed_rad_per_s * mean) / s.u_per_row_rad, 2);
  }
  const int freedom = static_cast<int>(sweeps.size()) - 1;
  const double scatter = freedom > 0 ? chi_square / freedom : 1;
  return {mean, std::sqrt(std::max(1.0, scatter) / weights) * (scatter > 1 ? student(freedom) : 1)};
}

bool exposures_differ(const std::vector<SweepAngles>& sweeps) {
  const auto [least, most] = std::minmax_element(
      sweeps.begin(), sweeps.end(), [](const auto& a, const auto& b) { return a.exposure_ns < b.exposure_ns; });
  return most->exposure_ns > kOtherExposure * least->exposure_ns;
}

}  // namespace

std::optional<TimeEstimate> estimate_time(const std::vector<BoardSweep>& sweeps, const TimeModel& assumed,
                                          const Estimate& estimate, const Observations& observations) {
  if (!estimate.axis) return std::nullopt;
  std::map<int, Placement> placements;
  for (const ViewObservation& view : observations.views) {
    if (!view.turned() || !view.used) continue;
    placements[view.placement] = {estimate.X_CB[static_cast<std::size_t>(view.pose)], view.reference_rad};
  }
  std::vector<SweepAngles> seen;
  std::map<int, Eigen::Index> column_of;  // of a placement
  bool forwards = false, backwards = false;
  for (const BoardSweep& sweep : sweeps) {
    const auto placement = placements.find(sweep.placement);
    if (placement == placements.end()) continue;
    const auto angles = angles_of(sweep, placement->second, estimate, observations.places);
    if (!angles) continue;
    seen.push_back(*angles);
    column_of.emplace(sweep.placement, static_cast<Eigen::Index>(column_of.size()));
    (angles->speed_rad_per_s > 0 ? forwards : backwards) = true;
  }
  if (seen.empty()) return std::nullopt;

  TimeEstimate out;
  out.sweeps = static_cast<int>(seen.size());
  const Measured line_s = line_time_s(seen);
  out.time.line_time_ns = {line_s.value * 1e9, line_s.u * 1e9};

  // Equation (16). Columns: offset in s, [play], [exposure factor, per mean exposure], each placement's own angle.
  const bool play = forwards && backwards, factor = exposures_differ(seen);
  const Eigen::Index own = 1 + (play ? 1 : 0) + (factor ? 1 : 0);
  const auto rows = static_cast<Eigen::Index>(seen.size());
  const Eigen::Index unknowns = own + static_cast<Eigen::Index>(column_of.size());
  if (rows <= unknowns) return std::nullopt;
  double mean_exposure_ns = 0, mean_row = 0, u_ahead_rad = 0, fastest = 0;
  for (const SweepAngles& s : seen) {
    mean_exposure_ns += s.exposure_ns / static_cast<double>(rows);
    mean_row += s.row / static_cast<double>(rows);
    u_ahead_rad = std::max(u_ahead_rad, s.u_ahead_rad);
    fastest = std::max(fastest, std::abs(s.speed_rad_per_s));
  }
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(rows, unknowns);
  Eigen::VectorXd y(rows);
  for (Eigen::Index i = 0; i < rows; ++i) {
    const SweepAngles& s = seen[static_cast<std::size_t>(i)];
    const double speed = s.speed_rad_per_s / fastest;
    A(i, 0) = speed;
    if (play) A(i, 1) = s.speed_rad_per_s < 0 ? 1 : 0;
    if (factor) A(i, own - 1) = speed * (s.exposure_ns - mean_exposure_ns) / mean_exposure_ns;
    A(i, own + column_of.at(s.placement)) = 1;
    y[i] = s.ahead_rad - s.speed_rad_per_s * s.row * line_s.value;
    if (!factor) y[i] -= s.speed_rad_per_s * (s.exposure_ns - mean_exposure_ns) * 1e-9 * assumed.exposure_factor.value;
  }
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(A);
  constexpr double kSpeedsAlike = 0.05;  // a speed and a half of it are well apart
  if (std::abs(qr.matrixR()(unknowns - 1, unknowns - 1)) < kSpeedsAlike) return std::nullopt;
  const Eigen::VectorXd x = qr.solve(y);
  const int freedom = static_cast<int>(rows - unknowns);
  const double scatter_rad = (y - A * x).norm() / std::sqrt(freedom) * student(freedom);
  const Eigen::MatrixXd C = std::pow(std::max(scatter_rad, u_ahead_rad), 2) * (A.transpose() * A).inverse();

  // x[0] is the middle instant of the first row at the mean exposure, times the fastest speed.
  const double f = factor ? x[own - 1] / (fastest * mean_exposure_ns * 1e-9) : assumed.exposure_factor.value;
  const double u_f = factor ? std::sqrt(C(own - 1, own - 1)) / (fastest * mean_exposure_ns * 1e-9) : 0;
  out.time.exposure_factor = {f, factor ? u_f : assumed.exposure_factor.u};
  const double u_clock_s = std::min_element(seen.begin(), seen.end(), [](const auto& a, const auto& b) {
                             return a.u_clock_s < b.u_clock_s;
                           })->u_clock_s;
  out.together_ns = 1e9 * std::hypot(std::sqrt(C(0, 0)) / fastest, u_clock_s);
  const double by_factor_ns = factor ? u_f * mean_exposure_ns : 0;
  out.time.stamp_offset_ns = {x[0] / fastest * 1e9 - f * mean_exposure_ns,
                              std::hypot(out.together_ns, by_factor_ns, mean_row * out.time.line_time_ns.u)};
  if (play) out.backlash_rad = {x[1], std::sqrt(C(1, 1))};
  return out;
}

}  // namespace celadon::calibrate
