#include "fitting/range_function.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

#include "fitting/bspline_basis.h"
#include "fitting/knots.h"
#include "fitting/tensor_sum.h"

namespace celadon {

RangeFunction::RangeFunction(BaseCylinder base, int degree_u, int degree_v, std::vector<double> knots_u,
                             std::vector<double> knots_v, Eigen::MatrixXd coefficients)
    : base_(std::move(base)),
      degree_u_(degree_u),
      degree_v_(degree_v),
      knots_u_(std::move(knots_u)),
      knots_v_(std::move(knots_v)),
      coefficients_(std::move(coefficients)) {
  require_clamped(knots_u_, degree_u_, "RangeFunction, u");
  require_clamped(knots_v_, degree_v_, "RangeFunction, v");
  const auto refuse = [](const std::string& why) { throw std::invalid_argument("RangeFunction: " + why); };
  if (knots_u_.front() != 0 || knots_u_.back() != 1) refuse("knots_u must run over [0, 1]");
  if (knots_v_.front() != 0 || knots_v_.back() != base_.arcs.count()) refuse("knots_v must run over the base arcs");
  if (!(base_.z_start_mm < base_.z_end_mm)) refuse("the band is empty");
  const auto count = [](const std::vector<double>& knots, int degree) {
    return static_cast<Eigen::Index>(knots.size()) - degree - 1;
  };
  const Eigen::Index rows = count(knots_u_, degree_u_), columns = count(knots_v_, degree_v_);
  if (coefficients_.rows() != rows || coefficients_.cols() != columns) {
    refuse("coefficients are " + std::to_string(coefficients_.rows()) + " x " + std::to_string(coefficients_.cols()) +
           ", the knots ask for " + std::to_string(rows) + " x " + std::to_string(columns));
  }
  if ((degree_u_ == 0 && rows != 1) || (degree_v_ == 0 && columns != 1)) refuse("degree 0 has one coefficient");
  basis_u_ = IntervalBasis(knots_u_, degree_u_);
  basis_v_ = IntervalBasis(knots_v_, degree_v_);
  padded_.setZero(rows + basis_u_.width() - degree_u_ - 1, columns + basis_v_.width() - degree_v_ - 1);
  padded_.topLeftCorner(rows, columns) = coefficients_;
}

double RangeFunction::u_of_z(double z_mm) const {
  return std::clamp((z_mm - base_.z_start_mm) / (base_.z_end_mm - base_.z_start_mm), 0.0, 1.0);
}

double RangeFunction::operator()(double theta_rad, double z_mm) const {
  double r_mm = 0;
  evaluate(&theta_rad, &z_mm, 1, &r_mm);
  return r_mm;
}

void RangeFunction::evaluate(const double* theta_rad, const double* z_mm, std::size_t n, double* r_mm) const {
  if (coefficients_.size() == 0) throw std::logic_error("RangeFunction: evaluated before it was built");
  constexpr std::size_t kBlock = 256;
  std::array<double, kBlock> u, v;
  for (std::size_t first = 0; first < n; first += kBlock) {
    const std::size_t m = std::min(kBlock, n - first);
    base_.arcs.synchronise(theta_rad + first, m, v.data());
    for (std::size_t k = 0; k < m; ++k) u[k] = u_of_z(z_mm[first + k]);
    tensor_sum(basis_u_, basis_v_, padded_, u.data(), v.data(), m, r_mm + first);
  }
}

RangeDerivatives RangeFunction::derivatives(double theta_rad, double z_mm) const {
  if (coefficients_.size() == 0) throw std::logic_error("RangeFunction: evaluated before it was built");
  const double v = base_.arcs.v_of_theta(theta_rad), u = u_of_z(z_mm);
  const int span_u = find_span(knots_u_, degree_u_, u), span_v = find_span(knots_v_, degree_v_, v);
  const auto Nu = basis_derivatives(knots_u_, degree_u_, span_u, u);
  const auto Nv = basis_derivatives(knots_v_, degree_v_, span_v, v);
  double F[3][3] = {};  // F[a][b]: a-th derivative in u, b-th in v
  for (int i = 0; i <= degree_u_; ++i) {
    for (int j = 0; j <= degree_v_; ++j) {
      const double f = coefficients_(span_u - degree_u_ + i, span_v - degree_v_ + j);
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = 0; a + b < 3; ++b) {
          F[a][b] += Nu[a][static_cast<std::size_t>(i)] * Nv[b][static_cast<std::size_t>(j)] * f;
        }
      }
    }
  }
  double theta_v = 0, theta_vv = 0;
  base_.arcs.theta_derivatives(v, theta_v, theta_vv);
  const double v_theta = 1 / theta_v, v_theta_theta = -theta_vv * v_theta * v_theta * v_theta;
  const double u_z = 1 / (base_.z_end_mm - base_.z_start_mm);
  return {.r_mm = F[0][0],
          .r_theta = F[0][1] * v_theta,
          .r_z = F[1][0] * u_z,
          .r_theta_theta = F[0][2] * v_theta * v_theta + F[0][1] * v_theta_theta,
          .r_theta_z = F[1][1] * v_theta * u_z,
          .r_z_z = F[2][0] * u_z * u_z};
}

SurfacePoint RangeFunction::surface_point(double theta_rad, double z_mm) const {
  const double z = std::clamp(z_mm, base_.z_start_mm, base_.z_end_mm);
  return celadon::surface_point(base_, theta_rad, z, derivatives(theta_rad, z_mm));
}

SurfacePoint surface_point(const BaseCylinder& base, double theta_rad, double z_mm, const RangeDerivatives& f) {
  // In the frame (radial, tangential, axial): S_theta = (r_theta, r, 0), S_z = (r_z, 0, 1).
  const Eigen::Vector3d radial(std::cos(theta_rad), std::sin(theta_rad), 0), tangential(-radial.y(), radial.x(), 0);
  const double norm = std::sqrt(f.r_mm * f.r_mm + f.r_theta * f.r_theta + f.r_mm * f.r_z * f.r_mm * f.r_z);
  const Eigen::Vector3d n(f.r_mm / norm, -f.r_theta / norm, -f.r_mm * f.r_z / norm);
  const double E = f.r_theta * f.r_theta + f.r_mm * f.r_mm, F = f.r_theta * f.r_z, G = f.r_z * f.r_z + 1;
  // Second form with the inward normal: positive where the body is convex.
  const double L = -((f.r_theta_theta - f.r_mm) * n.x() + 2 * f.r_theta * n.y());
  const double M = -(f.r_theta_z * n.x() + f.r_z * n.y());
  const double N = -f.r_z_z * n.x();
  // In orthonormal directions of the tangent plane the shape operator is symmetric: no cancelling H^2 - K.
  const double skew = F / E, height2 = G - F * skew;
  const double A = L / E, B = (M - skew * L) / std::sqrt(E * height2);
  const double C = (N - 2 * skew * M + skew * skew * L) / height2;
  const double mean = 0.5 * (A + C), half = std::hypot(0.5 * (A - C), B);

  SurfacePoint point;
  point.p_W = base.X_WB * (f.r_mm * radial + Eigen::Vector3d(0, 0, z_mm));
  point.normal_W = base.X_WB.linear() * (n.x() * radial + n.y() * tangential + Eigen::Vector3d(0, 0, n.z()));
  point.curvature_max = mean + half;
  point.curvature_min = mean - half;
  return point;
}

RangeFunction RangeFunction::clipped(double z_start_mm, double z_end_mm) const {
  if (!(base_.z_start_mm <= z_start_mm && z_start_mm < z_end_mm && z_end_mm <= base_.z_end_mm)) {
    throw std::invalid_argument("RangeFunction::clipped: [" + std::to_string(z_start_mm) + ", " +
                                std::to_string(z_end_mm) + "] mm is not a band within [" +
                                std::to_string(base_.z_start_mm) + ", " + std::to_string(base_.z_end_mm) + "] mm");
  }
  BaseCylinder base = base_;
  base.z_start_mm = z_start_mm;
  base.z_end_mm = z_end_mm;
  if (degree_u_ == 0) return {base, 0, degree_v_, knots_u_, knots_v_, coefficients_};

  // A cut within rounding of a knot is that knot: no interval of no length.
  const auto cut = [&](double z_mm) {
    const double u = u_of_z(z_mm);
    const auto near = std::find_if(knots_u_.begin(), knots_u_.end(), [&](double t) { return std::abs(t - u) < 1e-12; });
    return near == knots_u_.end() ? u : *near;
  };
  const double lo = cut(z_start_mm), hi = cut(z_end_mm);
  if (!(lo < hi)) throw std::invalid_argument("RangeFunction::clipped: the band has no height");
  std::vector<double> added;
  for (const double u : {lo, hi}) {
    const auto there = std::count(knots_u_.begin(), knots_u_.end(), u);
    for (auto m = there; m < degree_u_; ++m) added.push_back(u);
  }
  const Refinement refined = insert_knots(knots_u_, degree_u_, added);
  // The coefficient that is the value at a cut: the one whose `degree` inner knots are all there.
  const auto index_of = [&](double u) {
    const auto found = std::lower_bound(refined.knots.begin(), refined.knots.end(), u) - refined.knots.begin();
    return std::max<Eigen::Index>(found - 1, 0);
  };
  const Eigen::Index first = index_of(lo), last = index_of(hi);
  std::vector<double> knots(static_cast<std::size_t>(degree_u_) + 1, 0.0);
  for (const double t : refined.knots) {
    if (t > lo && t < hi) knots.push_back((t - lo) / (hi - lo));
  }
  knots.insert(knots.end(), static_cast<std::size_t>(degree_u_) + 1, 1.0);
  const Eigen::MatrixXd coefficients = refined.map * coefficients_;
  return {base, degree_u_, degree_v_, std::move(knots), knots_v_, coefficients.middleRows(first, last - first + 1)};
}

RangeFunction::Membership RangeFunction::membership(const Eigen::Vector3d& p_W) const {
  const Eigen::Vector3d p_B = base_.X_WB.inverse() * p_W;
  const RangeDerivatives f = derivatives(std::atan2(p_B.y(), p_B.x()), p_B.z());
  const double ray_mm = std::hypot(p_B.x(), p_B.y()) - f.r_mm;
  const double cos_psi = 1 / std::sqrt(1 + f.r_theta * f.r_theta / (f.r_mm * f.r_mm) + f.r_z * f.r_z);
  return {.in_band = p_B.z() >= base_.z_start_mm && p_B.z() <= base_.z_end_mm,
          .ray_mm = ray_mm,
          .signed_distance_mm = ray_mm * cos_psi};
}

}  // namespace celadon
