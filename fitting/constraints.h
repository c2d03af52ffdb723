#pragma once
// What a surface shall hold exactly whatever the samples say: radii at heights, angles at the rims. Source: thesis,
// appendix C; README.md, "Constraints".

#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

namespace celadon {

class FitLadder;
struct Inflation;
struct LadderFit;
struct Variation;
struct FitError;

/// The radius all around at a height.
struct FixedRadius {
  double z_mm = 0, radius_mm = 0;
};

/// Of a surface over a cylinder.
struct Constraints {
  std::vector<FixedRadius> radii;
  /// Angle between the wall and the axis at the lower and at the upper rim, positive where the radius grows with z.
  std::optional<double> angle_start_rad, angle_end_rad;
  bool any() const { return !radii.empty() || angle_start_rad || angle_end_rad; }
};

/// A constraint that is held, and what the samples alone would have made of it: the mean all around.
struct HeldConstraint {
  std::string what;       ///< "radius 20 mm at z = 10 mm", "angle 0 degrees at the upper rim"
  bool is_angle = false;  ///< values are in rad, else in mm
  double asked = 0;
  double alone = 0, alone_sd = 0;  ///< the same without it, and the standard deviation of that
};

/// Constraints that no surface can hold, before there is one: two radii at one height, a radius that is not positive,
/// an angle beyond 89 degrees.
std::optional<FitError> refuse(const Constraints& constraints);

/// The minimiser among those members that hold the constraints, by Lagrange multipliers; finer along z, or varying
/// along z at all, where the member has too few functions for them. `fit` and `variation` are changed.
/// Errors: a height outside [z_start_mm, z_end_mm]; more constraints than the finest member can hold.
tl::expected<std::vector<HeldConstraint>, FitError> hold(const Constraints& constraints, const FitLadder& ladder,
                                                         double z_start_mm, double z_end_mm, double noise_variance,
                                                         const Inflation& inflation, LadderFit& fit,
                                                         Variation& variation);

}  // namespace celadon
