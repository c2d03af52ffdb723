#include "fitting/base_surface.h"

#include <cmath>
#include <numbers>

#include "fitting/range_function.h"

namespace celadon {
namespace {

// A surface as a range over directions: p = rho(x1, x2) times a unit vector e(x1, x2) with de/dx_i = e_i and
// d2e/dx_i dx_j = -delta_ij e at the point; H the second derivatives of rho in those coordinates.
struct SphericalJet {
  Eigen::Vector3d e, e1, e2;
  double rho, g1, g2, H11, H12, H22;
};

// Normal and curvatures from first and second derivatives of a point, outward n: positive where the body is convex.
SurfacePoint finish(const BaseSurface& base, const Eigen::Vector3d& p, const Eigen::Vector3d& n, double E, double F,
                    double G, double L, double M, double N) {
  // In orthonormal directions of the tangent plane the shape operator is symmetric: no cancelling H^2 - K.
  const double skew = F / E, height2 = G - F * skew;
  const double A = L / E, B = (M - skew * L) / std::sqrt(E * height2);
  const double C = (N - 2 * skew * M + skew * skew * L) / height2;
  const double mean = 0.5 * (A + C), half = std::hypot(0.5 * (A - C), B);
  SurfacePoint point;
  point.p_W = base.X_WB * p;
  point.normal_W = base.X_WB.linear() * n;
  point.curvature_max = mean + half;
  point.curvature_min = mean - half;
  return point;
}

SurfacePoint finish(const BaseSurface& base, const SphericalJet& j) {
  const Eigen::Vector3d p1 = j.g1 * j.e + j.rho * j.e1, p2 = j.g2 * j.e + j.rho * j.e2;
  const Eigen::Vector3d n = (j.rho * j.e - j.g1 * j.e1 - j.g2 * j.e2).normalized();
  const double ne = n.dot(j.e), n1 = n.dot(j.e1), n2 = n.dot(j.e2);
  const double L = -((j.H11 - j.rho) * ne + 2 * j.g1 * n1), M = -(j.H12 * ne + j.g1 * n2 + j.g2 * n1),
               N = -((j.H22 - j.rho) * ne + 2 * j.g2 * n2);
  return finish(base, j.rho * j.e, n, p1.dot(p1), p1.dot(p2), p2.dot(p2), L, M, N);
}

// First and second derivative of w with respect to phi.
struct Meridian {
  double phi, w_phi, w_phi_phi;
  explicit Meridian(double w) : phi(BaseSurface::meridian().theta_of_v(w)) {
    double phi_w = 1, phi_ww = 0;
    BaseSurface::meridian().theta_derivatives(w, phi_w, phi_ww);
    w_phi = 1 / phi_w;
    w_phi_phi = -phi_ww * w_phi * w_phi * w_phi;
  }
  double second(const RangeDerivatives& r) const { return r.r_z_z * w_phi * w_phi + r.r_z * w_phi_phi; }
};

// From derivatives by theta and the coordinate t along to those by theta and z = H(theta, t), H linear in t:
// t_z = 1/H_t, t_theta = -H_theta/H_t.
RangeDerivatives by_height(const RangeFunction& heights, double theta_rad, double along, const RangeDerivatives& f) {
  const RangeDerivatives H = heights.derivatives(theta_rad, along);
  const double t_z = 1 / H.r_z, t_theta = -H.r_theta * t_z, t_theta_z = -H.r_theta_z * t_z * t_z,
               t_theta_theta = -(H.r_theta_theta + 2 * H.r_theta_z * t_theta) * t_z;
  return {.r_mm = f.r_mm,
          .r_theta = f.r_theta + f.r_z * t_theta,
          .r_z = f.r_z * t_z,
          .r_theta_theta =
              f.r_theta_theta + 2 * f.r_theta_z * t_theta + f.r_z_z * t_theta * t_theta + f.r_z * t_theta_theta,
          .r_theta_z = (f.r_theta_z + f.r_z_z * t_theta) * t_z + f.r_z * t_theta_z,
          .r_z_z = f.r_z_z * t_z * t_z};
}

}  // namespace

const BaseArcs& BaseSurface::meridian() {
  static const BaseArcs arcs = BaseArcs::open(0, std::numbers::pi);
  return arcs;
}

double BaseSurface::z_mm(double theta_rad, double along) const {
  return heights ? (*heights)(theta_rad, along) : along;
}

double BaseSurface::along_at(double theta_rad, double z_mm) const {
  if (!heights) return z_mm;
  const double a = heights->base().band_start, b = heights->base().band_end;
  const double lower = (*heights)(theta_rad, a), upper = (*heights)(theta_rad, b);
  return a + (z_mm - lower) / (upper - lower) * (b - a);
}

double BaseSurface::along_of(const Eigen::Vector3d& p_B) const {
  if (!spherical()) return along_at(std::atan2(p_B.y(), p_B.x()), p_B.z());
  const double x = p_B.z(), y = std::hypot(p_B.x(), p_B.y());
  double w = 0, rho = 0;
  meridian().synchronise(&x, &y, 1, &w, &rho);
  return w;
}

double BaseSurface::range_of(const Eigen::Vector3d& p_B) const {
  return spherical() ? p_B.norm() : std::hypot(p_B.x(), p_B.y());
}

SurfacePoint surface_point(const BaseSurface& base, double theta_rad, double along, const RangeDerivatives& of_along) {
  const RangeDerivatives f = base.heights ? by_height(*base.heights, theta_rad, along, of_along) : of_along;
  const Eigen::Vector3d radial(std::cos(theta_rad), std::sin(theta_rad), 0), tangential(-radial.y(), radial.x(), 0);
  if (base.spherical()) {
    const Meridian m(along);
    const double s = std::sin(m.phi), c = std::cos(m.phi);
    SphericalJet jet;
    jet.e = s * radial + c * Eigen::Vector3d::UnitZ();
    jet.e1 = c * radial - s * Eigen::Vector3d::UnitZ();
    jet.e2 = tangential;
    jet.rho = f.r_mm;
    jet.g1 = f.r_z * m.w_phi;
    jet.g2 = f.r_theta / s;
    // The covariant second derivatives on the sphere.
    jet.H11 = m.second(f);
    jet.H12 = (f.r_theta_z * m.w_phi - c / s * f.r_theta) / s;
    jet.H22 = (f.r_theta_theta / s + c * jet.g1) / s;
    return finish(base, jet);
  }
  // In the frame (radial, tangential, axial): S_theta = (r_theta, r, 0), S_z = (r_z, 0, 1).
  const double norm = std::sqrt(f.r_mm * f.r_mm + f.r_theta * f.r_theta + f.r_mm * f.r_z * f.r_mm * f.r_z);
  const Eigen::Vector3d n(f.r_mm / norm, -f.r_theta / norm, -f.r_mm * f.r_z / norm);
  const double L = -((f.r_theta_theta - f.r_mm) * n.x() + 2 * f.r_theta * n.y());
  const double M = -(f.r_theta_z * n.x() + f.r_z * n.y());
  const double N = -f.r_z_z * n.x();
  return finish(base, f.r_mm * radial + Eigen::Vector3d(0, 0, base.z_mm(theta_rad, along)),
                n.x() * radial + n.y() * tangential + Eigen::Vector3d(0, 0, n.z()),
                f.r_theta * f.r_theta + f.r_mm * f.r_mm, f.r_theta * f.r_z, f.r_z * f.r_z + 1, L, M, N);
}

SurfacePoint pole_point(const BaseSurface& base, double along, const RangeDerivatives (&f)[3]) {
  const Meridian m(along);
  const bool south = along > 1;
  // phi grows away from the pole at phi = 0 and towards that at pi: derivatives by the distance from the pole.
  const double away = south ? -1 : 1;
  SphericalJet jet;
  jet.e = (south ? -1 : 1) * Eigen::Vector3d::UnitZ();
  jet.e1 = Eigen::Vector3d::UnitX();
  jet.e2 = Eigen::Vector3d::UnitY();
  jet.rho = f[0].r_mm;
  jet.g1 = away * f[0].r_z * m.w_phi;
  jet.g2 = away * f[2].r_z * m.w_phi;
  jet.H11 = m.second(f[0]);
  jet.H22 = m.second(f[2]);
  jet.H12 = m.second(f[1]) - 0.5 * (jet.H11 + jet.H22);
  return finish(base, jet);
}

double cos_psi(const BaseSurface& base, double theta_rad, double along, double r_mm, double r_theta, double r_along) {
  if (base.heights) {
    const RangeDerivatives z = base.heights->derivatives(theta_rad, along);
    r_along /= z.r_z;
    r_theta -= r_along * z.r_theta;
  }
  if (!base.spherical()) return 1 / std::sqrt(1 + r_theta * r_theta / (r_mm * r_mm) + r_along * r_along);
  const Meridian m(along);
  const double g1 = r_along * m.w_phi / r_mm, g2 = r_theta / (std::sin(m.phi) * r_mm);
  return 1 / std::sqrt(1 + g1 * g1 + g2 * g2);
}

}  // namespace celadon
