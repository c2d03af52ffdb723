#include "acquisition/stereo/stereo_profile.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace celadon {
namespace {

/// What moves by less in the camera's picture does not turn with the table: a point 3 mm beside the axis moves by more.
constexpr double kStanding_px = 1.5;

/// A change of x and y and z as one of (r, theta, z).
Eigen::Vector3d native(const Eigen::Vector3d& p, const Eigen::Vector3d& change) {
  const double rr = p.head<2>().squaredNorm();
  return {(p.x() * change.x() + p.y() * change.y()) / std::sqrt(rr), (p.x() * change.y() - p.y() * change.x()) / rr,
          change.z()};
}

double first_turn(double angle_rad) {
  constexpr double kTurn = 2 * std::numbers::pi;
  const double rest = std::fmod(angle_rad, kTurn);
  return rest < 0 ? std::min(rest + kTurn, std::nextafter(kTurn, 0)) : rest;
}

}  // namespace

tl::expected<StereoPair, std::string> StereoPair::begin(const Calibration& calibration, const ScanVolume& volume,
                                                        const CameraMode& mode, const PictureNoise& noise,
                                                        const TablePicture& first, const TablePicture& second) {
  auto geometry = NormalPair::make(calibration, first.encoder_rad, second.encoder_rad);
  if (!geometry) return tl::make_unexpected(geometry.error());
  StereoPair pair(*geometry, volume);
  pair.first_sigma_rad_ = std::abs(calibration.encoder.rate(first.encoder_rad)) * first.sigma_rad;
  pair.second_sigma_rad_ = std::abs(calibration.encoder.rate(second.encoder_rad)) * second.sigma_rad;
  pair.first_ = std::make_unique<const LevelPicture>(normal_picture(*geometry, 0, levels_of(mode, first.bytes)));
  pair.second_ = std::make_unique<const LevelPicture>(normal_picture(*geometry, 1, levels_of(mode, second.bytes)));
  const double reach = std::min(volume.r_max_mm, geometry->view_reach_mm());
  pair.matcher_ = std::make_unique<const WindowMatcher>(*pair.first_, *pair.second_, noise, geometry->range_to(reach));
  return pair;
}

int StereoPair::bands() const {
  return matcher_->bands();
}

void StereoPair::match(int band) {
  counts_ += matcher_->match(band, matches_);
}

MatchCounts StereoPair::fill(Profile& profile) const {
  MatchCounts counts = counts_;
  profile.r_mm.clear();
  profile.theta_rad.clear();
  profile.z_mm.clear();
  profile.covariance.clear();
  profile.row.clear();
  profile.order = ProfileOrder::scattered;
  profile.table_angle_rad = geometry_.middle_rad();
  for (const WindowMatch& match : matches_) {
    const Eigen::Vector2d first = geometry_.pixel(0, match.x_px, match.y_px),
                          second = geometry_.pixel(1, match.x_px - match.disparity_px, match.y_px);
    if ((first - second).norm() < kStanding_px) {
      ++counts.standing;
      continue;
    }
    const StereoPoint point = geometry_.point(match.x_px, match.y_px, match.disparity_px);
    const Eigen::Vector3d& p = point.p_mm;
    const double r = p.head<2>().norm();
    if (!(r >= volume_.r_min_mm && r <= volume_.r_max_mm && p.z() >= volume_.z_min_mm && p.z() <= volume_.z_max_mm)) {
      ++counts.outside;
      continue;
    }
    Eigen::Matrix3d J;
    J << native(p, point.by_disparity) * match.sigma_px, native(p, point.by_first_rad) * first_sigma_rad_,
        native(p, point.by_second_rad) * second_sigma_rad_;
    const Eigen::Matrix3f C = (J * J.transpose()).cast<float>();
    profile.r_mm.push_back(r);
    profile.theta_rad.push_back(first_turn(std::atan2(p.y(), p.x())));
    profile.z_mm.push_back(p.z());
    profile.covariance.push_back(
        {.rr = C(0, 0), .rt = C(0, 1), .rz = C(0, 2), .tt = C(1, 1), .tz = C(1, 2), .zz = C(2, 2)});
  }
  return counts;
}

}  // namespace celadon
