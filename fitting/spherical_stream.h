#pragma once
// Range data about a centre: what a fit over a sphere reads. Source: README.md, "Base geometries"; thesis (3.5).

#include "fitting/profile.h"

namespace celadon {

/// A stream of (r, theta, z) as (rho, theta, w) about the centre (0, 0, centre_z_mm): rho in place of r, and in place
/// of z the parameter w of BaseSurface::meridian(), with covariances carried over. Samples at the centre get rho = 0,
/// which a fit rejects.
class SphericalStream : public ProfileStream {
 public:
  /// The stream must outlive this one, which rewinds and reads it.
  SphericalStream(ProfileStream& cylindrical, double centre_z_mm) : from_(cylindrical), centre_z_(centre_z_mm) {}
  void rewind() override { from_.rewind(); }
  const Profile* next() override;

 private:
  ProfileStream& from_;
  double centre_z_;
  Profile profile_;
};

/// Height on the axis of the sphere about which the samples lie nearest to one radius: sum (|p - c|^2 - R^2)^2 least.
/// Of a closed body a point well inside. NaN: the samples do not determine one.
double centre_on_axis_mm(ProfileStream& cylindrical);

/// One profile.
void to_spherical(const Profile& cylindrical, double centre_z_mm, Profile& spherical);

}  // namespace celadon
