#pragma once
// The volume between a closed wall and the plane discs at its ends.

#include "fitting/nurbs_surface.h"

namespace celadon {

/// A third of the flux of the position through wall and discs, outward where S_u x S_v points inward; Gauss-Legendre
/// quadrature on every knot rectangle, relative error below 1e-9 for walls of degree up to 7 (README.md, "The solid").
/// @pre the surface's sizes agree, its weights are positive, it is closed in v and its rims are plane
double enclosed_volume_mm3(const NurbsSurface& wall);

}  // namespace celadon
