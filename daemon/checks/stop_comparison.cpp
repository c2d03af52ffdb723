#include "daemon/checks/stop_comparison.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <numeric>
#include <variant>
#include <vector>

#include "acquisition/remeasured_points.h"
#include "daemon/laser_agreement.h"
#include "daemon/profile_log.h"

namespace celadon {
namespace {

/// Calls back with every profile of the fit and where the axes stood. @returns whether the log could be read
template <class Take>
bool each_profile(const std::filesystem::path& log_file, Take take) {
  auto log = ProfileLogReader::open(log_file);
  if (!log) return false;
  AxisStop stop;
  while (const auto entry = (*log)->next_entry()) {
    if (const auto* const at = std::get_if<LogStop>(&*entry)) stop = at->stop;
    const auto* const logged = std::get_if<LoggedProfile>(&*entry);
    if (logged != nullptr && !logged->overlap) take(*logged->profile, stop);
  }
  return (*log)->error().empty();
}

/// A sample of every so many profiles.
void add_sample(ScannedPoints& points, std::vector<Eigen::Vector3d>& places, const Profile& profile,
                const AxisStop& stop) {
  if (profile.size() == 0) return;
  const std::size_t i = places.size() * 7919 % profile.size();  // at changing heights
  places.emplace_back(profile.r_mm[i] * std::cos(profile.theta_rad[i]),
                      profile.r_mm[i] * std::sin(profile.theta_rad[i]), profile.z_mm[i]);
  points.table_angle_rad.push_back(profile.table_angle_rad);
  points.laser.push_back(profile.laser);
  points.stop.push_back(stop);
}

/// Root mean square over the points of what uncertain axes do to their radii.
double axes_uncertainty_mm(const ScannedPoints& points, Calibration calibration) {
  // The rest of the calibration is common to both stops.
  calibration.covariance.reset();
  calibration.scale.u = calibration.systematic_mm = calibration.u_drift_mm = 0;
  const Eigen::MatrixXd C = calibration_covariance_of(
      [](const Eigen::Matrix3Xd& p) -> Eigen::VectorXd { return p.topRows<2>().colwise().norm().transpose(); }, points,
      calibration);
  return C.size() == 0 ? 0 : std::sqrt(C.trace() / static_cast<double>(C.rows()));
}

}  // namespace

std::optional<StopComparison> compare_stops(const std::filesystem::path& log_file, const Calibration& calibration) {
  constexpr std::size_t kPoints = 80;
  std::vector<AxisStop> stops;
  GridSpecification band;
  band.z_start_mm = std::numeric_limits<double>::infinity();
  band.z_end_mm = -band.z_start_mm;
  std::size_t profiles = 0;
  std::vector<std::uint8_t> lasers;
  const bool read = each_profile(log_file, [&](const Profile& profile, const AxisStop& stop) {
    if (std::find(stops.begin(), stops.end(), stop) == stops.end()) stops.push_back(stop);
    if (std::find(lasers.begin(), lasers.end(), profile.laser) == lasers.end()) lasers.push_back(profile.laser);
    for (const double z : profile.z_mm) {
      band.z_start_mm = std::min(band.z_start_mm, z);
      band.z_end_mm = std::max(band.z_end_mm, z);
    }
    ++profiles;
  });
  if (!read || stops.size() < 2 || !(band.z_start_mm < band.z_end_mm)) return std::nullopt;
  std::vector<int> numbers(stops.size());
  std::iota(numbers.begin(), numbers.end(), 0);
  LaserAgreement agreement(band, numbers, static_cast<int>(profiles / (stops.size() * lasers.size())));
  ScannedPoints points;
  std::vector<Eigen::Vector3d> places;
  std::size_t seen = 0;
  const std::size_t every = std::max<std::size_t>(1, profiles / kPoints);
  each_profile(log_file, [&](const Profile& profile, const AxisStop& stop) {
    agreement.add(profile, static_cast<int>(std::find(stops.begin(), stops.end(), stop) - stops.begin()));
    if (seen++ % every == 0) add_sample(points, places, profile, stop);
  });
  points.p_mm.resize(3, static_cast<Eigen::Index>(places.size()));
  for (std::size_t i = 0; i < places.size(); ++i) points.p_mm.col(static_cast<Eigen::Index>(i)) = places[i];

  StopComparison out;
  out.error = agreement.result();
  if (out.error) {
    out.first = stops[static_cast<std::size_t>(out.error->first)];
    out.second = stops[static_cast<std::size_t>(out.error->second)];
  }
  // Each turn has the planes' own uncertainty, seen from where the head stood.
  out.stated_mm = std::numbers::sqrt2 * std::hypot(calibration.systematic_mm, axes_uncertainty_mm(points, calibration));
  return out;
}

}  // namespace celadon
