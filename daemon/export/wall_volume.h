#pragma once
// The volume within a wall that is closed around and what closes its ends.

#include "fitting/nurbs_surface.h"

namespace celadon {

/// The point that the cap on a rim runs together in, a plane disc or a fan: the middle of the rim's control points.
/// @pre the points of a row of control points, the first and last of which coincide
Eigen::Vector3d cap_apex(const Eigen::Matrix4Xd& rim);

/// A third of the flux of the position through wall and caps, positive where S_u x S_v points inward (a cylinder's
/// wall), negative where it points outward (a sphere's); Gauss-Legendre quadrature on every knot rectangle, relative
/// error below 1e-9 for walls of degree up to 7 (README.md, "The solid").
/// @pre the surface's sizes agree, its weights are positive, it is closed in v
double signed_volume_mm3(const NurbsSurface& wall);

}  // namespace celadon
