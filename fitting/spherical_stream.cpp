#include "fitting/spherical_stream.h"

#include <cmath>

#include "fitting/base_surface.h"

namespace celadon {
namespace {

// Of (rho, theta, w) from that of (r, theta, z): d rho = s dr + c dz, d phi = (c dr - s dz)/rho, s and c of phi.
SampleCovariance carried(const SampleCovariance& of, double s, double c, double w_phi, double rho) {
  const double rr = of.rr, rt = of.rt, rz = of.rz, tt = of.tt, tz = of.tz, zz = of.zz, per_rho = w_phi / rho;
  return {.rr = static_cast<float>(s * s * rr + 2 * s * c * rz + c * c * zz),
          .rt = static_cast<float>(s * rt + c * tz),
          .rz = static_cast<float>(per_rho * (s * c * (rr - zz) + (c * c - s * s) * rz)),
          .tt = static_cast<float>(tt),
          .tz = static_cast<float>(per_rho * (c * rt - s * tz)),
          .zz = static_cast<float>(per_rho * per_rho * (c * c * rr - 2 * s * c * rz + s * s * zz))};
}

}  // namespace

void to_spherical(const Profile& from, double centre_z_mm, Profile& to) {
  const BaseArcs& meridian = BaseSurface::meridian();
  const std::size_t n = from.size();
  to.index = from.index, to.pose = from.pose, to.laser = from.laser, to.order = from.order;
  to.lift_mm = from.lift_mm, to.table_angle_rad = from.table_angle_rad, to.time_ns = from.time_ns;
  to.theta_rad = from.theta_rad;
  to.row = from.row;
  to.covariance = from.covariance;
  to.r_mm.resize(n);
  to.z_mm = from.z_mm;
  for (double& z : to.z_mm) z -= centre_z_mm;
  std::vector<double> height;
  if (!from.covariance.empty()) height = to.z_mm;
  meridian.synchronise(to.z_mm.data(), from.r_mm.data(), n, to.z_mm.data(), to.r_mm.data());
  for (std::size_t k = 0; k < from.covariance.size(); ++k) {
    const double rho = to.r_mm[k];
    if (!(rho > 0)) continue;
    double phi_w = 1, phi_ww = 0;
    meridian.theta_derivatives(to.z_mm[k], phi_w, phi_ww);
    to.covariance[k] = carried(from.covariance[k], from.r_mm[k] / rho, height[k] / rho, 1 / phi_w, rho);
  }
}

double centre_on_axis_mm(ProfileStream& cylindrical) {
  // r^2 + z^2 = 2 z c + (R^2 - c^2), about the mean height: one line through (z, r^2 + z^2).
  double n = 0, mean_z = 0, mean_q = 0, zz = 0, zq = 0;
  cylindrical.rewind();
  while (const Profile* p = cylindrical.next())
    for (std::size_t k = 0; k < p->size(); ++k) {
      const double r = p->r_mm[k], z = p->z_mm[k], q = r * r + z * z;
      if (!std::isfinite(q)) continue;
      ++n;
      const double dz = z - mean_z, dq = q - mean_q;
      mean_z += dz / n;
      mean_q += dq / n;
      zz += dz * (z - mean_z);
      zq += dz * (q - mean_q);
    }
  return zz > 0 ? zq / zz / 2 : std::nan("");
}

const Profile* SphericalStream::next() {
  const Profile* from = from_.next();
  if (from == nullptr) return nullptr;
  to_spherical(*from, centre_z_, profile_);
  return &profile_;
}

}  // namespace celadon
