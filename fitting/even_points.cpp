#include "fitting/even_points.h"

#include <cmath>

#include "fitting/even_sample.h"

namespace celadon {

Eigen::Matrix3Xd even_points(ProfileStream& samples, std::size_t most) {
  EvenSample<Eigen::Vector3d> kept(most);
  samples.rewind();
  while (const Profile* profile = samples.next())
    for (std::size_t k = 0; k < profile->size(); ++k) {
      const double r = profile->r_mm[k], t = profile->theta_rad[k], z = profile->z_mm[k];
      if (!std::isfinite(r) || !std::isfinite(t) || !std::isfinite(z)) continue;
      kept.add([&] { return Eigen::Vector3d(r * std::cos(t), r * std::sin(t), z); });
    }
  Eigen::Matrix3Xd points(3, static_cast<Eigen::Index>(kept.values().size()));
  for (std::size_t k = 0; k < kept.values().size(); ++k) points.col(static_cast<Eigen::Index>(k)) = kept.values()[k];
  return points;
}

}  // namespace celadon
