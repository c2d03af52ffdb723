#include "fitting/residual_pass.h"

namespace celadon {

const Profile* ResidualPass::next() {
  profile_ = profiles_.next();
  if (!profile_) return nullptr;
  v_.resize(profile_->size());
  arcs_.place(profile_->theta_rad.data(), profile_->size(), v_.data());
  return profile_;
}

void ResidualPass::compare(const CellPolynomials& function, Residuals& result, bool slopes) const {
  const std::size_t n = profile_->size();
  const double* z = profile_->z_mm.data();
  result.r.resize(n);
  result.residual.resize(n);
  if (slopes) {
    result.r_theta.resize(n);
    result.r_z.resize(n);
    function.evaluate(v_.data(), z, n, result.r.data(), result.r_theta.data(), result.r_z.data());
  } else {
    function.evaluate(v_.data(), z, n, result.r.data());
  }
  for (std::size_t k = 0; k < n; ++k) result.residual[k] = profile_->r_mm[k] - result.r[k];
}

}  // namespace celadon
