#include "fitting/first_look.h"

#include <cmath>
#include <limits>
#include <utility>

namespace celadon {

FirstLook::FirstLook(const MomentGrid& sums)
    : specification_(sums.specification()), arcs_(sums.arcs()), extents_(sums) {}

void FirstLook::add(const Profile& profile) {
  const std::size_t n = profile.size();
  points_ += n;
  profiles_ += profile.order == ProfileOrder::rows ? 1 : std::numeric_limits<double>::infinity();
  covariances_ = covariances_ || !profile.covariance.empty();
  v_.resize(n);
  arcs_.place(profile.theta_rad.data(), n, v_.data());
  for (std::size_t k = 0; k < n; ++k) {
    const double r = profile.r_mm[k], z = profile.z_mm[k];
    if (!(r > 0 && std::isfinite(r) && v_[k] >= 0)) continue;
    if (!(z >= specification_.z_start_mm && z <= specification_.z_end_mm)) continue;
    samples_.add([&] { return SamplePoint{r, v_[k], z}; });
    extents_.add(v_[k], z);
  }
}

GatheredSamples gather(ProfileStream& samples, const GridSpecification& grid) {
  MomentGrid sums(grid);
  FirstLook look(sums);
  samples.rewind();
  while (const Profile* profile = samples.next()) {
    sums.add(profile->r_mm, profile->theta_rad, profile->z_mm);
    look.add(*profile);
  }
  return {std::move(sums), std::move(look)};
}

}  // namespace celadon
