#pragma once
// One pass over a stream of profiles: their v, their residuals to range functions and the slopes there; nothing is
// kept.

#include <cmath>
#include <vector>

#include "fitting/base_arcs.h"
#include "fitting/cell_polynomials.h"
#include "fitting/profile.h"

namespace celadon {

/// The current profile against a range function: arrays of the profile's length.
struct Residuals {
  std::vector<double> r, residual;   ///< F and r - F
  std::vector<double> r_theta, r_z;  ///< slopes of F, where asked for
};

class ResidualPass {
 public:
  /// Rewinds the stream.
  ResidualPass(ProfileStream& profiles, const BaseArcs& arcs) : profiles_(profiles), arcs_(arcs) { profiles_.rewind(); }
  /// The next profile with its v (negative where BaseArcs::place() finds none); nullptr after the last.
  const Profile* next();
  const std::vector<double>& v() const { return v_; }
  /// Of the current profile.
  void compare(const CellPolynomials& function, Residuals& result, bool slopes) const;
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
