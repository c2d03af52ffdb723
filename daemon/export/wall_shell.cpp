// Walls that are open around: one face within four edges.
#include <BRepCheck_Analyzer.hxx>
#include <BRep_Builder.hxx>
#include <Geom2d_Line.hxx>
#include <Geom_BSplineCurve.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Shell.hxx>
#include <TopoDS_Vertex.hxx>
#include <TopoDS_Wire.hxx>

#include "daemon/export/wall_solid.h"
#include "daemon/export/wall_surface.h"

namespace celadon {
namespace {

// S_u x S_v points away from the middle of the control points, on the whole.
bool points_outward(const Handle(Geom_BSplineSurface) & surface) {
  constexpr int kSteps = 16;
  gp_XYZ middle(0, 0, 0);
  const int rows = surface->NbUPoles(), columns = surface->NbVPoles();
  for (int i = 1; i <= rows; ++i)
    for (int j = 1; j <= columns; ++j) middle += surface->Pole(i, j).XYZ() / (static_cast<double>(rows) * columns);
  double u0 = 0, u1 = 0, v0 = 0, v1 = 0, flux = 0;
  surface->Bounds(u0, u1, v0, v1);
  for (int i = 0; i < kSteps; ++i)
    for (int j = 0; j < kSteps; ++j) {
      gp_Pnt p;
      gp_Vec along_u, along_v;
      surface->D1(u0 + (u1 - u0) * (i + 0.5) / kSteps, v0 + (v1 - v0) * (j + 0.5) / kSteps, p, along_u, along_v);
      flux += (p.XYZ() - middle).Dot(along_u.Crossed(along_v).XYZ());
    }
  return flux > 0;
}

class ShellBuilder {
 public:
  explicit ShellBuilder(const NurbsSurface& wall)
      : surface_(surface_of(wall)),
        u_{wall.knots_u.front(), wall.knots_u.back()},
        v_{wall.knots_v.front(), wall.knots_v.back()},
        pole_{is_pole(wall, 0), is_pole(wall, wall.count_u() - 1)} {
    builder_.MakeFace(face_, surface_, tolerance_mm);
    for (int i : {0, 1})
      for (int j : {0, 1}) {
        if (j == 1 && pole_[i]) {
          corner_[i][1] = corner_[i][0];
        } else {
          builder_.MakeVertex(corner_[i][j], surface_->Value(u_[i], v_[j]), tolerance_mm);
        }
      }
    // Counter-clockwise in the parameter plane: along v start, up the end of u, back along v end, down the start of u.
    TopoDS_Wire boundary;
    builder_.MakeWire(boundary);
    builder_.Add(boundary, side(0));
    builder_.Add(boundary, rim(1));
    builder_.Add(boundary, side(1).Reversed());
    builder_.Add(boundary, rim(0).Reversed());
    boundary.Closed(true);
    builder_.Add(face_, boundary);
  }
  const TopoDS_Face& face() const { return face_; }
  const Handle(Geom_BSplineSurface) & surface() const { return surface_; }

 private:
  TopoDS_Edge between(const TopoDS_Vertex& from, const TopoDS_Vertex& to, TopoDS_Edge edge) {
    builder_.Add(edge, from.Oriented(TopAbs_FORWARD));
    builder_.Add(edge, to.Oriented(TopAbs_REVERSED));
    return edge;
  }
  TopoDS_Edge side(int j) {
    TopoDS_Edge edge;
    builder_.MakeEdge(edge, surface_->VIso(v_[j]), tolerance_mm);
    edge = between(corner_[0][j], corner_[1][j], edge);
    builder_.UpdateEdge(edge, new Geom2d_Line(gp_Pnt2d(0, v_[j]), gp_Dir2d(1, 0)), face_, tolerance_mm);
    builder_.Range(edge, u_[0], u_[1]);
    return edge;
  }
  TopoDS_Edge rim(int i) {
    TopoDS_Edge edge;
    pole_[i] ? builder_.MakeEdge(edge) : builder_.MakeEdge(edge, surface_->UIso(u_[i]), tolerance_mm);
    edge = between(corner_[i][0], corner_[i][1], edge);
    builder_.UpdateEdge(edge, new Geom2d_Line(gp_Pnt2d(u_[i], 0), gp_Dir2d(0, 1)), face_, tolerance_mm);
    if (pole_[i]) {
      builder_.Range(edge, face_, v_[0], v_[1]);
      builder_.Degenerated(edge, true);
    } else {
      builder_.Range(edge, v_[0], v_[1]);
    }
    return edge;
  }

  BRep_Builder builder_;
  Handle(Geom_BSplineSurface) surface_;
  double u_[2], v_[2];
  bool pole_[2];
  TopoDS_Face face_;
  TopoDS_Vertex corner_[2][2];
};

}  // namespace

tl::expected<WallBody, std::string> shell_of_wall(const NurbsSurface& wall) {
  if (auto problem = wall_problem(wall)) return tl::make_unexpected(std::move(*problem));
  if (wall.closed_v) return tl::make_unexpected(std::string("the wall is closed around; it makes a solid"));
  WallBody body;
  body.closed = false;
  const ShellBuilder built(wall);
  const TopoDS_Face face = points_outward(built.surface()) ? built.face() : TopoDS::Face(built.face().Reversed());
  body.walls.push_back({face, "wall"});
  const BRep_Builder builder;
  TopoDS_Shell shell;
  builder.MakeShell(shell);
  builder.Add(shell, face);
  body.shape = shell;
  if (!BRepCheck_Analyzer(shell).IsValid()) {
    return tl::make_unexpected(std::string("OpenCASCADE finds the open wall invalid"));
  }
  return body;
}

}  // namespace celadon
