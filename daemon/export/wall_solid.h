#pragma once
// The solid of OpenCASCADE around a wall: one face that is closed around, and a cap on each end that is no pole;
// topology built directly.

#include <TopoDS_Face.hxx>
#include <TopoDS_Solid.hxx>
#include <string>
#include <tl/expected.hpp>
#include <vector>

#include "fitting/nurbs_surface.h"

namespace celadon {

/// A face that was not measured.
struct Cap {
  TopoDS_Face face;
  const char* name;  ///< "bottom" or "top"
};

/// The faces are oriented as they lie in the solid.
struct WallSolid {
  TopoDS_Solid solid;
  TopoDS_Face wall;
  std::vector<Cap> caps;
  double volume_mm3 = 0;
};

/// The exact surface as given (no re-approximation), a seam with two pcurves at v's start, rims that are the exact
/// isoparametric curves u = start and u = end, shared by the caps; an end whose control points coincide is a pole with
/// a degenerate edge and no cap. A wall over a cylinder (S_u x S_v inward) is capped by plane discs; one over a sphere
/// (outward) by fans where its rim is not plane. README.md, "The solid".
/// Errors: a wall that is not closed in v, not finite, without positive weights, over a cylinder with a rim that is not
/// plane, or that OpenCASCADE finds invalid; the sentence says what and where.
tl::expected<WallSolid, std::string> solid_of_wall(const NurbsSurface& wall);

}  // namespace celadon
