#pragma once
// The solid of OpenCASCADE around walls that are closed around, one above the other, and a cap on each end that is no
// pole; topology built directly.

#include <TopoDS_Face.hxx>
#include <TopoDS_Solid.hxx>
#include <span>
#include <string>
#include <tl/expected.hpp>
#include <vector>

#include "fitting/nurbs_surface.h"

namespace celadon {

struct NamedFace {
  TopoDS_Face face;
  const char* name;
};

/// The faces are oriented as they lie in the solid.
struct WallSolid {
  TopoDS_Solid solid;
  std::vector<NamedFace> walls;  ///< "wall"; of several "body" (over a cylinder) and "head" (over a sphere)
  std::vector<NamedFace> caps;   ///< not measured: "bottom", "top"
  double volume_mm3 = 0;
};

/// The exact surfaces as given (no re-approximation), a seam with two pcurves at v's start, rims that are the exact
/// isoparametric curves u = start and u = end, shared by walls that meet there and by the caps; an end whose control
/// points coincide is a pole with a degenerate edge and no cap. Walls over a cylinder (S_u x S_v inward) are capped by
/// plane discs; those over a sphere (outward) by fans where the rim is not plane. README.md, "The solid".
/// @param walls from bottom to top
/// Errors: a wall that is not closed in v, not finite, without positive weights, over a cylinder with a rim that is not
/// plane, walls that do not meet, or what OpenCASCADE finds invalid; the sentence says what and where.
tl::expected<WallSolid, std::string> solid_of_walls(std::span<const NurbsSurface> walls);

}  // namespace celadon
