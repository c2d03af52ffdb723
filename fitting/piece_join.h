#pragma once
// Two pieces of one body made to meet: a range over a cylinder and a range over a sphere whose centre lies on the
// cylinder's axis at the height of the rim, so that the rim is the sphere's equator. Source: README.md, "Composites".

#include <numbers>

#include "fitting/range_function.h"
#include "fitting/range_space.h"

namespace celadon {

/// How two pieces meet on their rim: the largest over the angles.
struct Meeting {
  double gap_mm = 0;     ///< between their points
  double angle_rad = 0;  ///< between their normals
};

/// @pre as join()
Meeting meeting(const RangeFunction& body, const RangeFunction& head);

/// What the joined rim has of the body's value and slope; the rest is the head's.
struct BodyShare {
  double value = 0, slope = 0;
};

struct JoinedPieces {
  RangeFunction body, head;
  BodyShare of_body;
};

/// dphi/dw on a head's equator: tangent planes agree where rho_w = -kPhiPerW r r_z.
inline constexpr double kPhiPerW = std::numbers::sqrt2;

/// By how much a joined piece changes at `along` with the value and with the slope along at one of its rims.
struct RimInfluence {
  double value, slope;
};
RimInfluence rim_influence(const RangeFunction& joined, bool at_end, double along);

/// Changes the last two rows of coefficients at the rim so that both have the same rim and the same tangent planes on
/// it: r = rho, r r_z = -rho_phi. The rim is equal to the bit; the tangent planes as far as a spline around can be the
/// product of two, which knots are added for. What varies in more directions takes the whole change, so that an exact
/// cylinder, sphere or revolution stays one; of equals the stiffer keeps more of what it was.
/// @pre both closed around, degrees along 2 and more where they are not constant, one frame but for the height; the
/// head's band ends (a head on top) or starts (one below) on its equator, w = 1, the body's at the head's centre
/// @throws std::invalid_argument otherwise
JoinedPieces join(const RangeFunction& body, const RangeFunction& head, JointContinuity continuity);

}  // namespace celadon
