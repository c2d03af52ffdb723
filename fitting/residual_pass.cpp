#include "fitting/residual_pass.h"

#include <algorithm>

namespace celadon {
namespace {

// Coefficients and knots of the derivative of a clamped spline along the rows of a matrix.
struct Derivative {
  Eigen::MatrixXd coefficients;
  std::vector<double> knots;
};

Derivative differentiate(const Eigen::MatrixXd& c, const std::vector<double>& knots, int degree) {
  Derivative d{Eigen::MatrixXd(c.rows() - 1, c.cols()), std::vector<double>(knots.begin() + 1, knots.end() - 1)};
  for (Eigen::Index i = 0; i + 1 < c.rows(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    const double span = knots[k + static_cast<std::size_t>(degree) + 1] - knots[k + 1];
    if (span > 0) {
      d.coefficients.row(i) = degree / span * (c.row(i + 1) - c.row(i));
    } else {
      d.coefficients.row(i).setZero();
    }
  }
  return d;
}

// Simple derivatives of splines with knots of full multiplicity would jump; none of the spaces fitted here has them.
bool differentiable(const std::vector<double>& knots, int degree) {
  if (degree < 2) return false;
  int run = 1;
  for (std::size_t k = static_cast<std::size_t>(degree) + 2; k + static_cast<std::size_t>(degree) + 1 < knots.size();
       ++k) {
    run = knots[k] == knots[k - 1] ? run + 1 : 1;
    if (run >= degree) return false;
  }
  return true;
}

}  // namespace

RangeSlopes::RangeSlopes(const RangeFunction& f) : function_(f) {
  spline_u_ = differentiable(f.knots_u(), f.degree_u());
  spline_v_ = differentiable(f.knots_v(), f.degree_v());
  if (spline_u_) {
    Derivative d = differentiate(f.coefficients(), f.knots_u(), f.degree_u());
    along_u_ = RangeFunction(f.base(), f.degree_u() - 1, f.degree_v(), std::move(d.knots), f.knots_v(),
                             std::move(d.coefficients));
  }
  if (spline_v_) {
    Derivative d = differentiate(f.coefficients().transpose(), f.knots_v(), f.degree_v());
    around_v_ = RangeFunction(f.base(), f.degree_u(), f.degree_v() - 1, f.knots_u(), std::move(d.knots),
                              d.coefficients.transpose().eval());
  }
}

void RangeSlopes::evaluate(const double* theta, const double* v, const double* z, std::size_t n, double* r_theta,
                           double* r_z) {
  const bool pointwise = (!spline_u_ && function_.degree_u() > 0) || (!spline_v_ && function_.degree_v() > 0);
  if (pointwise) {
    for (std::size_t k = 0; k < n; ++k) {
      const RangeDerivatives d = function_.derivatives(theta[k], z[k]);
      r_theta[k] = d.r_theta;
      r_z[k] = d.r_z;
    }
    return;
  }
  std::fill(r_theta, r_theta + n, 0.0);
  std::fill(r_z, r_z + n, 0.0);
  const BaseCylinder& base = function_.base();
  if (spline_u_) {
    along_u_.evaluate(theta, z, n, r_z);
    const double scale = 1 / (base.z_end_mm - base.z_start_mm);
    for (std::size_t k = 0; k < n; ++k) r_z[k] *= scale;
  }
  if (spline_v_) {
    around_v_.evaluate(theta, z, n, r_theta);
    for (std::size_t k = 0; k < n; ++k) {
      double theta_v = 1, theta_vv = 0;
      base.arcs.theta_derivatives(v[k] >= 0 ? v[k] : 0, theta_v, theta_vv);
      r_theta[k] /= theta_v;
    }
  }
}

const Profile* ResidualPass::next() {
  profile_ = profiles_.next();
  if (!profile_) return nullptr;
  v_.resize(profile_->size());
  arcs_.synchronise(profile_->theta_rad.data(), profile_->size(), v_.data());
  for (std::size_t k = 0; k < v_.size(); ++k)
    if (!std::isfinite(profile_->theta_rad[k])) v_[k] = -1;
  return profile_;
}

void ResidualPass::residuals(const RangeFunction& function, std::vector<double>& residual) const {
  residual.resize(profile_->size());
  function.evaluate(profile_->theta_rad.data(), profile_->z_mm.data(), residual.size(), residual.data());
  for (std::size_t k = 0; k < residual.size(); ++k) residual[k] = profile_->r_mm[k] - residual[k];
}

}  // namespace celadon
