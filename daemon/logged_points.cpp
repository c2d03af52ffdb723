#include "daemon/logged_points.h"

#include <cmath>
#include <variant>
#include <vector>

namespace celadon {

ScannedPoints logged_points(ProfileLogReader& log, std::size_t every) {
  ScannedPoints out;
  std::vector<double> coordinates;
  std::size_t next = every / 2, seen = 0;
  AxisStop stop;
  log.rewind();
  while (const auto entry = log.next_entry()) {
    if (const auto* const at = std::get_if<LogStop>(&*entry)) stop = at->stop;
    const auto* const logged = std::get_if<LoggedProfile>(&*entry);
    if (logged == nullptr || logged->overlap) continue;
    const Profile& profile = *logged->profile;
    for (; next < seen + profile.size(); next += every) {
      const std::size_t i = next - seen;
      coordinates.insert(coordinates.end(), {profile.r_mm[i] * std::cos(profile.theta_rad[i]),
                                             profile.r_mm[i] * std::sin(profile.theta_rad[i]), profile.z_mm[i]});
      out.table_angle_rad.push_back(profile.table_angle_rad);
      out.laser.push_back(profile.laser);
      out.stop.push_back(stop);
    }
    seen += profile.size();
  }
  out.p_mm =
      Eigen::Map<const Eigen::Matrix3Xd>(coordinates.data(), 3, static_cast<Eigen::Index>(coordinates.size() / 3));
  return out;
}

}  // namespace celadon
