#pragma once
// Plane faces on the rims of walls: discs on one, rings between two.

#include <Geom2d_BSplineCurve.hxx>
#include <Geom_BSplineCurve.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Face.hxx>
#include <gp_Ax3.hxx>
#include <string>
#include <tl/expected.hpp>

namespace celadon {

/// A closed edge whose curve is that, counter-clockwise seen from the top.
struct Rim {
  TopoDS_Edge edge;
  Handle(Geom_BSplineCurve) curve;
};

/// Sum of the areas of the control polygon as seen from a point, by Newell: its direction is up for a rim.
gp_XYZ polygon_area(const Geom_BSplineCurve& curve, const gp_XYZ& from);

/// The rim's control points in the coordinates of a plane; `off_plane` grows to the furthest of them from it.
Handle(Geom2d_BSplineCurve) projected(const Geom_BSplineCurve& curve, const gp_Ax3& plane, double& off_plane);

/// A plane's frame about a point; which way x lies within it does not matter.
gp_Ax3 plane_at(const gp_XYZ& centre, const gp_Dir& normal);

/// The disc within a rim, its normal away from the body. @pre the rim lies in the plane
TopoDS_Face plane_disc(const gp_Ax3& plane, const Rim& rim, bool top);

/// The plane ring between the upper rim of a wall and the lower rim of the one above it, its normal away from the body.
/// Errors: rims that do not lie in one plane, or of which neither encloses the other.
tl::expected<TopoDS_Face, std::string> plane_ring(const Rim& below, const Rim& above);

}  // namespace celadon
