#include "fitting/range_function.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>
#include <utility>

#include "fitting/bspline_basis.h"
#include "fitting/knots.h"
#include "fitting/tensor_sum.h"

namespace celadon {

RangeFunction::RangeFunction(BaseSurface base, int degree_u, int degree_v, std::vector<double> knots_u,
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
  if (base_.spherical()) {
    if (!(base_.band_start >= 0 && base_.band_end <= BaseSurface::kMeridianEnd))
      refuse("the band is not within [0, 2]");
    if (knots_u_.front() != base_.band_start || knots_u_.back() != base_.band_end)
      refuse("knots_u must run over the band");
  } else if (knots_u_.front() != 0 || knots_u_.back() != 1) {
    refuse("knots_u must run over [0, 1]");
  }
  if (knots_v_.front() != 0 || knots_v_.back() != base_.arcs.count()) refuse("knots_v must run over the base arcs");
  if (!(base_.band_start < base_.band_end)) refuse("the band is empty");
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

double RangeFunction::u_of(double along) const {
  if (base_.spherical()) return std::clamp(along, base_.band_start, base_.band_end);
  return std::clamp((along - base_.band_start) / (base_.band_end - base_.band_start), 0.0, 1.0);
}

// du / d along.
double RangeFunction::u_along() const {
  return base_.spherical() ? 1 : 1 / (base_.band_end - base_.band_start);
}

double RangeFunction::operator()(double theta_rad, double along) const {
  double r_mm = 0;
  evaluate(&theta_rad, &along, 1, &r_mm);
  return r_mm;
}

void RangeFunction::evaluate(const double* theta_rad, const double* along, std::size_t n, double* r_mm) const {
  if (coefficients_.size() == 0) throw std::logic_error("RangeFunction: evaluated before it was built");
  constexpr std::size_t kBlock = 256;
  std::array<double, kBlock> u, v;
  for (std::size_t first = 0; first < n; first += kBlock) {
    const std::size_t m = std::min(kBlock, n - first);
    base_.arcs.synchronise(theta_rad + first, m, v.data());
    for (std::size_t k = 0; k < m; ++k) u[k] = u_of(along[first + k]);
    tensor_sum(basis_u_, basis_v_, padded_, u.data(), v.data(), m, r_mm + first);
  }
}

RangeDerivatives RangeFunction::derivatives(double theta_rad, double along) const {
  if (coefficients_.size() == 0) throw std::logic_error("RangeFunction: evaluated before it was built");
  const double v = base_.arcs.v_of_theta(theta_rad), u = u_of(along);
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
  const double u_z = u_along();
  return {.r_mm = F[0][0],
          .r_theta = F[0][1] * v_theta,
          .r_z = F[1][0] * u_z,
          .r_theta_theta = F[0][2] * v_theta * v_theta + F[0][1] * v_theta_theta,
          .r_theta_z = F[1][1] * v_theta * u_z,
          .r_z_z = F[2][0] * u_z * u_z};
}

SurfacePoint RangeFunction::surface_point(double theta_rad, double along) const {
  const double at = std::clamp(along, base_.band_start, base_.band_end);
  if (base_.spherical() && (at == 0 || at == BaseSurface::kMeridianEnd)) {
    constexpr double kEighth = std::numbers::pi / 4;
    return pole_point(base_, at, {derivatives(0, at), derivatives(kEighth, at), derivatives(2 * kEighth, at)});
  }
  return celadon::surface_point(base_, theta_rad, at, derivatives(theta_rad, at));
}

RangeFunction RangeFunction::clipped(double start, double end) const {
  if (!(base_.band_start <= start && start < end && end <= base_.band_end)) {
    throw std::invalid_argument("RangeFunction::clipped: [" + std::to_string(start) + ", " + std::to_string(end) +
                                "] is not a band within [" + std::to_string(base_.band_start) + ", " +
                                std::to_string(base_.band_end) + "]");
  }
  BaseSurface base = base_;
  base.band_start = start;
  base.band_end = end;
  const bool spherical = base_.spherical();
  if (degree_u_ == 0) {
    return {base, 0, degree_v_, spherical ? std::vector{start, end} : knots_u_, knots_v_, coefficients_};
  }

  // A cut within rounding of a knot is that knot: no interval of no length.
  const auto cut = [&](double along) {
    const double u = u_of(along);
    const auto near = std::find_if(knots_u_.begin(), knots_u_.end(), [&](double t) { return std::abs(t - u) < 1e-12; });
    return near == knots_u_.end() ? u : *near;
  };
  const double lo = cut(start), hi = cut(end);
  if (!(lo < hi)) throw std::invalid_argument("RangeFunction::clipped: the band has no height");
  if (spherical) base.band_start = lo, base.band_end = hi;
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
  std::vector<double> knots(static_cast<std::size_t>(degree_u_) + 1, spherical ? lo : 0.0);
  for (const double t : refined.knots) {
    if (t > lo && t < hi) knots.push_back(spherical ? t : (t - lo) / (hi - lo));
  }
  knots.insert(knots.end(), static_cast<std::size_t>(degree_u_) + 1, spherical ? hi : 1.0);
  const Eigen::MatrixXd coefficients = refined.map * coefficients_;
  return {base, degree_u_, degree_v_, std::move(knots), knots_v_, coefficients.middleRows(first, last - first + 1)};
}

void require_cylinder(const RangeFunction& function, const char* what) {
  if (function.base().spherical())
    throw std::invalid_argument(std::string(what) + ": the range is over a sphere, not over a cylinder");
  if (function.base().heights)
    throw std::invalid_argument(std::string(what) + ": the rims of the cylinder are not plane");
}

RangeFunction::Membership RangeFunction::membership(const Eigen::Vector3d& p_W) const {
  const Eigen::Vector3d p_B = base_.X_WB.inverse() * p_W;
  const double along = base_.along_of(p_B), theta = std::atan2(p_B.y(), p_B.x());
  const RangeDerivatives f = derivatives(theta, along);
  const double ray_mm = base_.range_of(p_B) - f.r_mm;
  // At a pole the slope around is that of the limit: seen from beside it.
  const double beside = base_.spherical() ? std::clamp(along, 1e-7, BaseSurface::kMeridianEnd - 1e-7) : along;
  const RangeDerivatives slopes = beside == along ? f : derivatives(theta, beside);
  return {.in_band = along >= base_.band_start && along <= base_.band_end,
          .ray_mm = ray_mm,
          .signed_distance_mm = ray_mm * cos_psi(base_, theta, beside, slopes.r_mm, slopes.r_theta, slopes.r_z)};
}

}  // namespace celadon
