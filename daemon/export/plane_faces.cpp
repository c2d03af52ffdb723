#include "daemon/export/plane_faces.h"

#include <BRep_Builder.hxx>
#include <Geom_Plane.hxx>
#include <TColStd_Array1OfInteger.hxx>
#include <TColStd_Array1OfReal.hxx>
#include <TColgp_Array1OfPnt2d.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Wire.hxx>
#include <algorithm>
#include <cmath>

#include "daemon/export/wall_surface.h"

namespace celadon {
namespace {

gp_XYZ middle_of(const Geom_BSplineCurve& curve) {
  gp_XYZ sum(0, 0, 0);
  for (int i = 1; i < curve.NbPoles(); ++i) sum += curve.Pole(i).XYZ();
  return sum / std::max(1, curve.NbPoles() - 1);
}

TopoDS_Wire wire_of(const TopoDS_Edge& edge) {
  const BRep_Builder builder;
  TopoDS_Wire wire;
  builder.MakeWire(wire);
  builder.Add(wire, edge);
  wire.Closed(true);
  return wire;
}

}  // namespace

gp_XYZ polygon_area(const Geom_BSplineCurve& curve, const gp_XYZ& from) {
  gp_XYZ area(0, 0, 0);
  for (int i = 1; i < curve.NbPoles(); ++i) {
    area += (curve.Pole(i).XYZ() - from).Crossed(curve.Pole(i + 1).XYZ() - from) / 2;
  }
  return area;
}

Handle(Geom2d_BSplineCurve) projected(const Geom_BSplineCurve& curve, const gp_Ax3& plane, double& off_plane) {
  TColgp_Array1OfPnt2d poles(1, curve.NbPoles());
  TColStd_Array1OfReal weights(1, curve.NbPoles());
  for (int i = 1; i <= curve.NbPoles(); ++i) {
    const gp_Vec from_centre(plane.Location(), curve.Pole(i));
    poles(i) = gp_Pnt2d(from_centre.Dot(gp_Vec(plane.XDirection())), from_centre.Dot(gp_Vec(plane.YDirection())));
    weights(i) = curve.Weight(i);
    off_plane = std::max(off_plane, std::abs(from_centre.Dot(gp_Vec(plane.Direction()))));
  }
  TColStd_Array1OfReal knots(1, curve.NbKnots());
  TColStd_Array1OfInteger multiplicities(1, curve.NbKnots());
  curve.Knots(knots);
  curve.Multiplicities(multiplicities);
  return new Geom2d_BSplineCurve(poles, weights, knots, multiplicities, curve.Degree());
}

gp_Ax3 plane_at(const gp_XYZ& centre, const gp_Dir& normal) {
  // The axis furthest from the normal keeps a level plane's numbers simple.
  return {gp_Pnt(centre), normal, std::abs(normal.X()) < 0.9 ? gp_Dir(1, 0, 0) : gp_Dir(0, 1, 0)};
}

TopoDS_Face plane_disc(const gp_Ax3& plane, const Rim& rim, bool top) {
  const BRep_Builder builder;
  TopoDS_Face face;
  builder.MakeFace(face, new Geom_Plane(plane), tolerance_mm);
  double off_plane = 0;
  builder.UpdateEdge(rim.edge, projected(*rim.curve, plane, off_plane), face, tolerance_mm);
  builder.Add(face, wire_of(top ? rim.edge : TopoDS::Edge(rim.edge.Reversed())));
  return face;
}

tl::expected<TopoDS_Face, std::string> plane_ring(const Rim& below, const Rim& above) {
  const gp_XYZ centre = middle_of(*below.curve), up = polygon_area(*below.curve, centre);
  const double inner = up.Modulus(), outer = polygon_area(*above.curve, centre).Modulus();
  if (inner < tolerance_mm * tolerance_mm || std::abs(inner - outer) < tolerance_mm * std::sqrt(inner)) {
    return tl::make_unexpected(std::string("two rims enclose the same area and leave no ring between them"));
  }
  const gp_Dir normal = outer > inner ? gp_Dir(up.Reversed()) : gp_Dir(up);
  const gp_Ax3 plane = plane_at(centre, normal);
  const BRep_Builder builder;
  TopoDS_Face face;
  builder.MakeFace(face, new Geom_Plane(plane), tolerance_mm);
  double off_plane = 0;
  for (const Rim* rim : {&below, &above}) {
    builder.UpdateEdge(rim->edge, projected(*rim->curve, plane, off_plane), face, tolerance_mm);
  }
  if (off_plane > tolerance_mm) {
    return tl::make_unexpected("two walls do not meet: their rims are " + number(off_plane) + " mm off one plane");
  }
  // Each rim bounds the face in the sense in which a disc on its wall would be bounded.
  const TopoDS_Wire of_below = wire_of(below.edge), of_above = wire_of(TopoDS::Edge(above.edge.Reversed()));
  builder.Add(face, outer > inner ? of_above : of_below);
  builder.Add(face, outer > inner ? of_below : of_above);
  return face;
}

}  // namespace celadon
