#pragma once
// The body of OpenCASCADE around walls: of those that are closed around, one above the other, a solid with a cap on
// each end that is no pole; of one that is open around, a shell. Topology built directly.

#include <TopoDS_Face.hxx>
#include <TopoDS_Shape.hxx>
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
struct WallBody {
  TopoDS_Shape shape;  ///< a solid, or the shell of a wall that is open around
  bool closed = true;  ///< it is a solid
  std::vector<NamedFace>
      walls;  ///< "wall"; of several "body" (over a cylinder), "head" (over a sphere), "shoulder" (plane)
  std::vector<NamedFace> caps;  ///< not measured: "bottom", "top"
  double volume_mm3 = 0;
};

/// The exact surfaces as given (no re-approximation), a seam with two pcurves at v's start, rims that are the exact
/// isoparametric curves u = start and u = end, shared by walls that meet there and by the caps; an end whose control
/// points coincide is a pole with a degenerate edge and no cap. Two walls over a cylinder that do not meet have a plane
/// ring between their rims. Caps are plane discs, and fans where the rim is not plane. README.md, "The solid".
/// @param walls from bottom to top; S_u x S_v points inward on those over a cylinder, outward on those over a sphere
/// Errors: a wall that is not closed in v, not finite, without positive weights, walls that do not meet, or what
/// OpenCASCADE finds invalid; the sentence says what and where.
tl::expected<WallBody, std::string> solid_of_walls(std::span<const NurbsSurface> walls);

/// The shell of one face over a wall that is open around: its sides are the exact isoparametric curves at both ends of
/// v, its outward normal points away from its own middle. Errors: as above; or a wall that is closed around.
tl::expected<WallBody, std::string> shell_of_wall(const NurbsSurface& wall);

}  // namespace celadon
