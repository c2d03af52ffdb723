#include "daemon/shape_measurement.h"

#include <map>
#include <tuple>

namespace celadon {

std::vector<int> profiles_of(const ScannedPoints& points) {
  std::map<std::tuple<int, double, double, double>, int> numbers;
  std::vector<int> out;
  for (std::size_t i = 0; i < points.laser.size(); ++i) {
    const AxisStop stop = points.stop.empty() ? AxisStop() : points.stop[i];
    const auto entry =
        numbers.try_emplace({points.laser[i], points.table_angle_rad[i], stop.elevation_rad, stop.lift_mm},
                            static_cast<int>(numbers.size()));
    out.push_back(entry.first->second);
  }
  return out;
}

std::optional<std::string> too_few(const ScannedPoints& points) {
  constexpr Eigen::Index kFewestPoints = 30;
  constexpr int kFewestProfiles = 12;
  const Eigen::Index count = points.p_mm.cols();
  if (count < kFewestPoints) {
    return "the shape has " + std::to_string(count) + " points and needs 30 to be measured; scan more of it";
  }
  const std::vector<int> profile = profiles_of(points);
  const int profiles = 1 + *std::max_element(profile.begin(), profile.end());
  if (profiles >= kFewestProfiles) return std::nullopt;
  return "the shape was seen in " + std::to_string(profiles) +
         " profiles and needs 12 to tell how sure its size is; scan with more profiles";
}

Eigen::MatrixXd scatter_covariance(const Eigen::MatrixXd& J, const Eigen::VectorXd& weights,
                                   const Eigen::VectorXd& residuals, const std::vector<int>& profile) {
  const int profiles = 1 + *std::max_element(profile.begin(), profile.end());
  Eigen::MatrixXd scores = Eigen::MatrixXd::Zero(J.cols(), profiles);
  for (Eigen::Index i = 0; i < J.rows(); ++i) {
    scores.col(profile[static_cast<std::size_t>(i)]) += weights[i] * residuals[i] * J.row(i).transpose();
  }
  const Eigen::MatrixXd inverse = (J.transpose() * weights.asDiagonal() * J).inverse();
  const double few = static_cast<double>(profiles) / static_cast<double>(profiles - J.cols());
  return few * inverse * scores * scores.transpose() * inverse;
}

}  // namespace celadon
