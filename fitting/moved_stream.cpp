#include "fitting/moved_stream.h"

#include <cmath>
#include <numbers>

namespace celadon {
namespace {

// d(x, y, z)/d(r, theta, z).
Eigen::Matrix3d cartesian_by_polar(double r, double theta) {
  const double c = std::cos(theta), s = std::sin(theta);
  return (Eigen::Matrix3d() << c, -r * s, 0, s, r * c, 0, 0, 0, 1).finished();
}

SampleCovariance carried(const SampleCovariance& of, const Eigen::Matrix3d& by) {
  Eigen::Matrix3d before;
  before << of.rr, of.rt, of.rz, of.rt, of.tt, of.tz, of.rz, of.tz, of.zz;
  const Eigen::Matrix3d after = by * before * by.transpose();
  const auto at = [&](int i, int j) { return static_cast<float>(after(i, j)); };
  return {.rr = at(0, 0), .rt = at(0, 1), .rz = at(0, 2), .tt = at(1, 1), .tz = at(1, 2), .zz = at(2, 2)};
}

}  // namespace

void move_profile(const Profile& from, const Eigen::Isometry3d& X_LS, Profile& to) {
  to = from;
  for (std::size_t k = 0; k < from.size(); ++k) {
    const double r = from.r_mm[k], theta = from.theta_rad[k];
    const Eigen::Vector3d p = X_LS * Eigen::Vector3d(r * std::cos(theta), r * std::sin(theta), from.z_mm[k]);
    const double turned = std::atan2(p.y(), p.x());
    to.r_mm[k] = std::hypot(p.x(), p.y());
    to.theta_rad[k] = turned < 0 ? turned + 2 * std::numbers::pi : turned;
    to.z_mm[k] = p.z();
    if (from.covariance.empty() || !(to.r_mm[k] > 0)) continue;
    const Eigen::Matrix3d by =
        cartesian_by_polar(to.r_mm[k], turned).inverse() * X_LS.linear() * cartesian_by_polar(r, theta);
    to.covariance[k] = carried(from.covariance[k], by);
  }
}

const Profile* MovedStream::next() {
  const Profile* const from = from_.next();
  if (!from) return nullptr;
  move_profile(*from, X_LS_, profile_);
  return &profile_;
}

MovedParts::MovedParts(ProfileParts parts, const Eigen::Isometry3d& X_LS) {
  for (ProfileStream* part : parts) {
    moved_.push_back(std::make_unique<MovedStream>(*part, X_LS));
    streams_.push_back(moved_.back().get());
  }
}

void JoinedStream::rewind() {
  at_ = 0;
  if (!parts_.empty()) parts_.front()->rewind();
}

const Profile* JoinedStream::next() {
  while (at_ < parts_.size()) {
    if (const Profile* profile = parts_[at_]->next()) return profile;
    if (++at_ < parts_.size()) parts_[at_]->rewind();
  }
  return nullptr;
}

}  // namespace celadon
