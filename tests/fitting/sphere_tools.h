#pragma once
// What the tests of fits over a sphere share: bodies in closed form about a centre, scattered and even samples of them.

#include <cmath>
#include <functional>
#include <random>

#include "fitting/base_surface.h"
#include "fitting/spherical_stream.h"
#include "tests/fitting/fit_tools.h"

namespace celadon::test {

/// rho of a direction.
using Body = std::function<double(double phi, double theta)>;

/// A sphere whose centre is off by d: rho = d.e + sqrt(R^2 - |d|^2 + (d.e)^2).
inline Body off_centre_sphere(double R, const Eigen::Vector3d& d) {
  return [=](double phi, double theta) {
    const Eigen::Vector3d e(std::sin(phi) * std::cos(theta), std::sin(phi) * std::sin(theta), std::cos(phi));
    const double along = d.dot(e);
    return along + std::sqrt(R * R - d.squaredNorm() + along * along);
  };
}

/// Samples of part of a body, even over the directions, as the cylindrical profiles that scanners deliver.
struct BodySetting {
  int samples = 40000;
  double sigma = 0;
  double phi_low = 0, phi_high = kPi;
  double centre_z = 0;
  unsigned seed = 1;
};
inline MemoryStream scattered_body(const Body& body, const BodySetting& s) {
  std::mt19937_64 random(s.seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0, 1);
  MemoryStream stream;
  for (int k = 0; k < s.samples; ++k) {
    if (k % 1024 == 0) {
      stream.profiles.emplace_back();
      stream.profiles.back().order = ProfileOrder::scattered;
    }
    const double c = std::cos(s.phi_low) + share(random) * (std::cos(s.phi_high) - std::cos(s.phi_low));
    const double phi = std::acos(c), theta = 2 * kPi * share(random);
    const double rho = body(phi, theta) + s.sigma * normal(random);
    push(stream.profiles.back(), rho * std::sin(phi), theta, s.centre_z + rho * c);
  }
  return stream;
}

inline tl::expected<RangeFit, FitError> fit_sphere(MemoryStream& cylindrical, RangeFitOptions options = {},
                                                   double centre_z = 0) {
  options.base = BaseKind::sphere;
  SphericalStream stream(cylindrical, centre_z);
  const auto grid = choose_grid(stream, options);
  if (!grid) return tl::unexpected(grid.error());
  MomentGrid sums(*grid);
  stream.rewind();
  while (const Profile* p = stream.next()) sums.add(p->r_mm, p->theta_rad, p->z_mm);
  return fit_range(sums, stream, options);
}

/// Largest and RMS difference to the body over even directions of the fit's band.
inline Miss miss_sphere(const RangeFunction& f, const Body& truth) {
  Miss m;
  double square = 0, count = 0;
  const BaseArcs& meridian = BaseSurface::meridian();
  const double lo = std::cos(meridian.theta_of_v(f.base().band_start)),
               hi = std::cos(meridian.theta_of_v(f.base().band_end));
  for (int i = 0; i <= 120; ++i)
    for (int j = 0; j < 97; ++j) {
      const double phi = std::acos(std::clamp(lo + (hi - lo) * i / 120, -1.0, 1.0)), theta = 2 * kPi * j / 97;
      const double e = f(theta, meridian.v_of_theta(phi)) - truth(phi, theta);
      square += e * e;
      ++count;
      m.max = std::max(m.max, std::abs(e));
    }
  m.rms = std::sqrt(square / count);
  return m;
}

}  // namespace celadon::test
