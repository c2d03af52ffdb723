#include "fitting/turned_over.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "fitting/even_points.h"
#include "fitting/fit_report.h"
#include "fitting/robust_least_squares.h"

namespace celadon {
namespace {

constexpr std::size_t kPoints = 6000, kSearchPoints = 400;
constexpr int kShifts = 96, kTurns = 72, kRefinedStarts = 6;
constexpr double kLeastOverlap = 0.2;
// Rims of the wall are left alone: points beyond them have no place on it.
constexpr double kRimShare = 0.03;
// A wall that slides this far within its noise, as a share of its height, does not say where it stands.
constexpr double kSlides = 0.01;

/// Points of the second pose against the wall of the first, moved by six numbers: a shift and a turn of the scanner's
/// frame, the turn about the z axis last.
class Contact {
 public:
  Contact(const RangeFunction& wall, const Eigen::Matrix3Xd& points, const Eigen::Isometry3d& X)
      : wall_(&wall), points_(&points), X_(X), round_(wall.degree_v() == 0) {}
  int unknowns() const { return round_ ? 5 : 6; }
  const Eigen::Isometry3d& X() const { return X_; }
  Contact moved(const Eigen::VectorXd& step) const {
    Contact result = *this;
    Eigen::Vector3d turn(step(3), step(4), round_ ? 0 : step(5));
    const double angle = turn.norm();
    Eigen::Isometry3d by = Eigen::Isometry3d::Identity();
    if (angle > 0) by.linear() = Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix();
    by.translation() = step.head<3>();
    result.X_ = by * X_;
    return result;
  }
  // Signed distances, and their derivatives at the state itself; out of the band a distance that no weight reaches.
  void residuals(const Eigen::Matrix3Xd&, Eigen::VectorXd& values, Eigen::MatrixXd* jacobian) const {
    values.resize(points_->cols());
    if (jacobian) jacobian->setZero(points_->cols(), unknowns());
    const Eigen::Isometry3d X_BW = wall_->base().X_WB.inverse();
    for (Eigen::Index k = 0; k < points_->cols(); ++k) {
      const Eigen::Vector3d p = X_ * points_->col(k);
      const auto member = wall_->membership(p);
      values(k) = member.in_band ? member.signed_distance_mm : wall_->coefficients().maxCoeff();
      if (!jacobian || !member.in_band) continue;
      const Eigen::Vector3d p_B = X_BW * p;
      const Eigen::Vector3d n = wall_->surface_point(std::atan2(p_B.y(), p_B.x()), p_B.z()).normal_W;
      const Eigen::Vector3d turned = p.cross(n);
      jacobian->row(k).head<3>() = n.transpose();
      jacobian->row(k).tail(unknowns() - 3) = turned.head(unknowns() - 3).transpose();
    }
  }

 private:
  const RangeFunction* wall_;
  const Eigen::Matrix3Xd* points_;
  Eigen::Isometry3d X_;
  bool round_;
};

bool within_rims(const RangeFunction& wall, double z) {
  const double rim = kRimShare * (wall.base().band_end - wall.base().band_start);
  return z >= wall.base().band_start + rim && z <= wall.base().band_end - rim;
}

struct Start {
  double shift_mm, turn_rad, cost;
};

// Median distance to the wall for every shift and turn; those of least cost first, no two of one shift and near turns.
std::vector<Start> starts(const RangeFunction& wall, const Eigen::Matrix3Xd& flipped) {
  const auto step = std::max<Eigen::Index>(1, flipped.cols() / static_cast<Eigen::Index>(kSearchPoints));
  std::vector<double> r, theta, z;
  for (Eigen::Index k = 0; k < flipped.cols(); k += step) {
    r.push_back(flipped.col(k).head<2>().norm());
    theta.push_back(std::atan2(flipped(1, k), flipped(0, k)));
    z.push_back(flipped(2, k));
  }
  const double low = wall.base().band_start - *std::max_element(z.begin(), z.end()),
               high = wall.base().band_end - *std::min_element(z.begin(), z.end());
  const int turns = wall.degree_v() == 0 ? 1 : kTurns;
  std::vector<Start> found;
  std::vector<double> at_theta, at_z, at_r, fitted, miss;
  for (int i = 1; i < kShifts; ++i) {
    const double shift = low + (high - low) * i / kShifts;
    for (int j = 0; j < turns; ++j) {
      const double turn = 2 * std::numbers::pi * j / turns;
      at_theta.clear(), at_z.clear(), at_r.clear(), miss.clear();
      for (std::size_t k = 0; k < z.size(); ++k) {
        if (!within_rims(wall, z[k] + shift)) continue;
        at_theta.push_back(theta[k] + turn);
        at_z.push_back(z[k] + shift);
        at_r.push_back(r[k]);
      }
      if (static_cast<double>(at_z.size()) < kLeastOverlap * static_cast<double>(z.size())) continue;
      fitted.resize(at_z.size());
      wall.evaluate(at_theta.data(), at_z.data(), at_z.size(), fitted.data());
      for (std::size_t k = 0; k < fitted.size(); ++k) miss.push_back(std::abs(at_r[k] - fitted[k]));
      const auto middle = miss.begin() + static_cast<std::ptrdiff_t>(miss.size() / 2);
      std::nth_element(miss.begin(), middle, miss.end());
      found.push_back({shift, turn, *middle});
    }
  }
  std::sort(found.begin(), found.end(), [](const Start& a, const Start& b) { return a.cost < b.cost; });
  return found;
}

Eigen::Isometry3d upside_down() {
  return Eigen::Isometry3d(Eigen::AngleAxisd(std::numbers::pi, Eigen::Vector3d::UnitX()));
}

}  // namespace

tl::expected<PoseAlignment, FitError> align_turned_over(const RangeFunction& wall, ProfileStream& second) {
  if (wall.base().spherical() || !wall.base().arcs.closed() || wall.base().heights)
    return tl::unexpected(
        FitError{"the first pose shows no wall that is closed around between plane rims; scan its whole turn, let rims "
                 "be plane"});
  const Eigen::Matrix3Xd points = even_points(second, kPoints);
  if (points.cols() < static_cast<Eigen::Index>(kSearchPoints) / 4)
    return tl::unexpected(FitError{text("%td samples of the second pose are too few; take more", points.cols())});
  // The search is in the wall's frame.
  const Eigen::Isometry3d X_WB = wall.base().X_WB, X_over = X_WB * upside_down() * X_WB.inverse();
  const auto candidates = starts(wall, X_WB.inverse() * (X_over * points));
  if (candidates.empty())
    return tl::unexpected(
        FitError{text("the two poses have less than %.0f %% of their heights in common; scan more of the wall in both",
                      100 * kLeastOverlap)});

  const double least_scale = 1e-9 * wall.coefficients().maxCoeff();
  PoseAlignment best;
  double best_cost = std::numeric_limits<double>::infinity();
  Eigen::MatrixXd covariance;
  std::vector<Start> tried;
  for (const Start& start : candidates) {
    const bool near = std::any_of(tried.begin(), tried.end(), [&](const Start& t) {
      return std::abs(t.shift_mm - start.shift_mm) < 0.03 * (wall.base().band_end - wall.base().band_start) &&
             std::abs(std::remainder(t.turn_rad - start.turn_rad, 2 * std::numbers::pi)) < 0.3;
    });
    if (near) continue;
    tried.push_back(start);
    Eigen::Isometry3d by = Eigen::Isometry3d::Identity();
    by.linear() = Eigen::AngleAxisd(start.turn_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    by.translation().z() = start.shift_mm;
    Contact contact(wall, points, X_WB * by * X_WB.inverse() * X_over);
    Eigen::VectorXd weights(points.cols());
    for (Eigen::Index k = 0; k < points.cols(); ++k)
      weights(k) = within_rims(wall, (X_WB.inverse() * (contact.X() * points.col(k))).z());
    const RobustSolution solution = fit_robustly(contact, points, weights, least_scale);
    Eigen::VectorXd values;
    contact.residuals(points, values, nullptr);
    const double scale = std::max(median_scale(values, weights), least_scale);
    if (scale < best_cost) {
      best_cost = scale;
      best.X_12 = contact.X();
      best.scale_mm = scale;
      best.overlap = weights.sum() / static_cast<double>(points.cols()) * solution.inliers;
      covariance = solution.covariance;
    }
    if (tried.size() == kRefinedStarts) break;
  }
  if (best.overlap < kLeastOverlap)
    return tl::unexpected(
        FitError{text("only %.0f %% of the second pose lie on the wall of the first; check that both "
                      "are the same object, the second upside down",
                      100 * best.overlap)});
  const double height = wall.base().band_end - wall.base().band_start;
  if (covariance.size() == 0 || !(std::sqrt(covariance(2, 2)) < kSlides * height))
    return tl::unexpected(FitError{
        "the wall is the same at every height: how far the object was raised by turning it over does not show; "
        "scan something of both that does, such as a mark or a rim"});
  best.shift_sd_mm = std::sqrt(covariance(2, 2));
  best.turn_sd_rad = covariance.rows() > 5 ? std::sqrt(covariance(5, 5)) : 0;
  return best;
}

}  // namespace celadon
