#pragma once
// One pass over a stream of profiles: their v, their residuals to range functions and the slopes there; nothing is
// kept.

#include <cmath>
#include <vector>

#include "fitting/base_arcs.h"
#include "fitting/profile.h"
#include "fitting/range_function.h"

namespace celadon {

/// r_theta and r_z of a range function at many points: its derivative splines, evaluated as fast as itself.
class RangeSlopes {
 public:
  explicit RangeSlopes(const RangeFunction& function);
  /// Arrays of length n; v of the points as BaseArcs gives it. Points outside the band: those of its rim.
  void evaluate(const double* theta_rad, const double* v, const double* z_mm, std::size_t n, double* r_theta,
                double* r_z);

 private:
  RangeFunction function_, along_u_, around_v_;
  bool spline_u_ = false, spline_v_ = false;  // else zero (constant) or piecewise constant (degree 1)
};

class ResidualPass {
 public:
  /// Rewinds the stream.
  ResidualPass(ProfileStream& profiles, const BaseArcs& arcs) : profiles_(profiles), arcs_(arcs) { profiles_.rewind(); }
  /// The next profile with its v (-1 where an angle is not finite); nullptr after the last.
  const Profile* next();
  const std::vector<double>& v() const { return v_; }
  /// r - F of the current profile.
  void residuals(const RangeFunction& function, std::vector<double>& residual) const;
  /// Sample k of the current profile is a point off the axis with z in [z_start, z_end].
  bool usable(std::size_t k, double z_start_mm, double z_end_mm) const {
    const double r = profile_->r_mm[k], z = profile_->z_mm[k];
    return r > 0 && std::isfinite(r) && z >= z_start_mm && z <= z_end_mm && v_[k] >= 0;
  }

 private:
  ProfileStream& profiles_;
  const BaseArcs& arcs_;
  const Profile* profile_ = nullptr;
  std::vector<double> v_;
};

}  // namespace celadon
