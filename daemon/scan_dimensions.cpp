#include "daemon/scan_dimensions.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <variant>

#include "daemon/dimensions.h"
#include "daemon/profile_log.h"

namespace celadon {
namespace {

constexpr std::size_t kMostPoints = 2000;

/// Every so many samples of the first look; none if the log cannot be read.
ScannedPoints points_of(const std::filesystem::path& log_file, std::size_t samples) {
  ScannedPoints out;
  auto log = ProfileLogReader::open(log_file);
  if (!log) return out;
  // Not a divisor of what repeats from profile to profile.
  const std::size_t every = std::max<std::size_t>(1, samples / kMostPoints) | 1;
  std::vector<Eigen::Vector3d> points;
  std::size_t next = every / 2, seen = 0;
  AxisStop stop;
  while (const auto entry = (*log)->next_entry()) {
    if (const auto* const at = std::get_if<LogStop>(&*entry)) stop = at->stop;
    const auto* const logged = std::get_if<LoggedProfile>(&*entry);
    if (logged == nullptr || logged->overlap) continue;
    const Profile& profile = *logged->profile;
    for (; next < seen + profile.size(); next += every) {
      const std::size_t i = next - seen;
      points.emplace_back(profile.r_mm[i] * std::cos(profile.theta_rad[i]),
                          profile.r_mm[i] * std::sin(profile.theta_rad[i]), profile.z_mm[i]);
      out.table_angle_rad.push_back(profile.table_angle_rad);
      out.laser.push_back(profile.laser);
      out.stop.push_back(stop);
    }
    seen += profile.size();
  }
  out.p_mm.resize(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i) out.p_mm.col(static_cast<Eigen::Index>(i)) = points[i];
  return out;
}

std::optional<RoundShape> shape_of(const BodyFit& fit) {
  const auto pieces = fit.pieces();
  if (pieces.size() != 1 || pieces[0].report.model != SurfaceModel::cylinder) return std::nullopt;
  return pieces[0].function.base().spherical() ? RoundShape::sphere : RoundShape::cylinder;
}

}  // namespace

std::vector<Dimension> dimensions_of_scan(const BodyFit& fit, const Calibration& calibration,
                                          const std::filesystem::path& log_file) {
  const auto shape = shape_of(fit);
  if (!shape) return {};
  const auto found = dimensions_of(*shape, points_of(log_file, fit.whole().points), calibration);
  return found ? found->values : std::vector<Dimension>{};
}

}  // namespace celadon
