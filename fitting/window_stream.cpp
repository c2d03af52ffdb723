#include "fitting/window_stream.h"

namespace celadon {

const Profile* WindowStream::next() {
  const Profile* const all = from_.next();
  if (!all) return nullptr;
  profile_.index = all->index, profile_.pose = all->pose, profile_.laser = all->laser, profile_.order = all->order;
  profile_.lift_mm = all->lift_mm, profile_.table_angle_rad = all->table_angle_rad, profile_.time_ns = all->time_ns;
  profile_.r_mm.clear(), profile_.theta_rad.clear(), profile_.z_mm.clear();
  profile_.covariance.clear(), profile_.row.clear();
  for (std::size_t k = 0; k < all->size(); ++k) {
    if (!(all->z_mm[k] >= lowest_mm_ && all->z_mm[k] <= highest_mm_)) continue;
    profile_.r_mm.push_back(all->r_mm[k]);
    profile_.theta_rad.push_back(all->theta_rad[k]);
    profile_.z_mm.push_back(all->z_mm[k]);
    if (!all->covariance.empty()) profile_.covariance.push_back(all->covariance[k]);
    if (!all->row.empty()) profile_.row.push_back(all->row[k]);
  }
  return &profile_;
}

}  // namespace celadon
