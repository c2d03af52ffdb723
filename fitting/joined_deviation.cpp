#include "fitting/joined_deviation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "fitting/deviation_nodes.h"
#include "fitting/knots.h"

namespace celadon {
namespace {

// A rim in coordinates of the body: radius and slope dr/dz.
struct Rim {
  double r, r_z;
};
Rim rim_of(const RangeFunction& joined, bool at_end, double v) {
  const BaseSurface& base = joined.base();
  const RangeDerivatives d = joined.derivatives(base.arcs.theta_of_v(v), at_end ? base.band_end : base.band_start);
  return {d.r_mm, base.spherical() ? -d.r_z / (kPhiPerW * d.r_mm) : d.r_z};
}

// What the errors of value and slope at the rim, of both pieces alone, do to a joined piece at one place. With the
// shares a and s of the body, r = rho on the rim and rho_w = -k r r_z there:
//   d rim = a dr + (1 - a) drho,   d slope = s dr_z + (1 - s) (-drho_w/(k r) - r_z/r drho),
// along the head d rho_w = -k (r_z d rim + r d slope); the piece changes by value (d rim - own) + slope (d slope -
// own).
struct Effect {
  double own_value, own_slope, other_value, other_slope;
};
Effect effect_of(const RimInfluence& influence, const BodyShare& share, const Rim& rim, bool head) {
  const double a = share.value, s = share.slope, k = kPhiPerW;
  if (!head)
    return {-influence.value * (1 - a), -influence.slope * (1 - s),
            influence.value * (1 - a) - influence.slope * (1 - s) * rim.r_z / rim.r,
            -influence.slope * (1 - s) / (k * rim.r)};
  return {-influence.value * a + influence.slope * k * rim.r_z * (a - s), -influence.slope * s,
          influence.value * a - influence.slope * k * rim.r_z * a, -influence.slope * k * rim.r * s};
}

std::vector<double> breaks_along(const RangeFunction& f) {
  const BaseSurface& base = f.base();
  std::vector<double> breaks = breaks_of(f.knots_u()).values;
  if (!base.spherical())
    for (double& u : breaks) u = base.band_start + u * (base.band_end - base.band_start);
  return breaks;
}

}  // namespace

DeviationMap joined_deviation(const CoefficientCovariance& alone, const RangeFunction& joined,
                              std::span<const JoinedEnd> ends) {
  const bool head = joined.base().spherical();
  // Around, the piece or what it was joined to may have the finer knots.
  const RangeSpace* around = &alone.space().v;
  for (const JoinedEnd& end : ends)
    if (end.other->space().v.intervals() > around->intervals()) around = &end.other->space().v;
  const auto sd_mm = [&](double v, double along) {
    std::vector<AlongTerm> own{{along, 0, 1}};
    double variance = 0;
    for (const JoinedEnd& end : ends) {
      const double at = end.at_end ? joined.base().band_end : joined.base().band_start;
      const Effect effect =
          effect_of(rim_influence(joined, end.at_end, along), end.of_body, rim_of(joined, end.at_end, v), head);
      own.insert(own.end(), {{at, 0, effect.own_value}, {at, 1, effect.own_slope}});
      const std::array<AlongTerm, 2> other{
          {{end.other_along, 0, effect.other_value}, {end.other_along, 1, effect.other_slope}}};
      variance += std::pow(end.other->sd_mm(v, other), 2);
    }
    return std::sqrt(variance + std::pow(alone.sd_mm(v, own), 2));
  };
  const std::vector<double> along = breaks_along(joined);
  return deviation_map(sd_mm, {along, joined.degree_u() > 0},
                       {around->breaks(), !around->periodic() && around->degree() > 0}, joined.base().band_start,
                       joined.base().band_end);
}

}  // namespace celadon
