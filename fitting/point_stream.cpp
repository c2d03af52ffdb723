#include "fitting/point_stream.h"

#include <cmath>
#include <numbers>

namespace celadon {

PointStream::PointStream(const Eigen::Matrix3Xd& points) {
  constexpr Eigen::Index kPiece = 4096;
  for (Eigen::Index first = 0; first < points.cols(); first += kPiece) {
    Profile& profile = profiles_.emplace_back();
    profile.index = static_cast<std::uint32_t>(profiles_.size() - 1);
    profile.order = ProfileOrder::scattered;
    for (Eigen::Index k = first; k < std::min(first + kPiece, points.cols()); ++k) {
      const double x = points(0, k), y = points(1, k), theta = std::atan2(y, x);
      profile.r_mm.push_back(std::hypot(x, y));
      profile.theta_rad.push_back(theta < 0 ? theta + 2 * std::numbers::pi : theta);
      profile.z_mm.push_back(points(2, k));
    }
  }
}

}  // namespace celadon
