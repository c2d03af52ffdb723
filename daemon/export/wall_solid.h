#pragma once
// The solid of OpenCASCADE around a wall: one closed face and a plane disc at each end, topology built directly.

#include <TopoDS_Face.hxx>
#include <TopoDS_Solid.hxx>
#include <string>
#include <tl/expected.hpp>

#include "fitting/nurbs_surface.h"

namespace celadon {

/// The faces are oriented as they lie in the solid.
struct WallSolid {
  TopoDS_Solid solid;
  TopoDS_Face wall, bottom, top;
  double volume_mm3 = 0;
};

/// The exact surface as given (no re-approximation), a seam with two pcurves at v's start, rims that are the exact
/// isoparametric curves u = start and u = end, shared by the discs. README.md, "The solid".
/// Errors: a wall that is not closed in v, not finite, without positive weights, inside out, with a rim that is not
/// plane, or that OpenCASCADE finds invalid; the sentence says what and where.
tl::expected<WallSolid, std::string> solid_of_wall(const NurbsSurface& wall);

}  // namespace celadon
