#include "daemon/export/wall_solid.h"

#include <BRepCheck_Analyzer.hxx>
#include <BRep_Builder.hxx>
#include <BRep_Tool.hxx>
#include <Geom2d_Line.hxx>
#include <Geom_BSplineCurve.hxx>
#include <Geom_BSplineSurface.hxx>
#include <TColStd_Array1OfInteger.hxx>
#include <TColStd_Array1OfReal.hxx>
#include <TColStd_Array2OfReal.hxx>
#include <TColgp_Array2OfPnt.hxx>
#include <TopExp.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Shell.hxx>
#include <TopoDS_Solid.hxx>
#include <TopoDS_Vertex.hxx>
#include <TopoDS_Wire.hxx>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <sstream>

#include "daemon/export/plane_faces.h"
#include "daemon/export/wall_surface.h"
#include "daemon/export/wall_volume.h"

namespace celadon {
namespace {

/// An end of a wall: its rim, or the edge without length of a pole, and the seam's point on it.
struct WallEnd {
  TopoDS_Edge edge;
  TopoDS_Vertex vertex;
};

/// Builds the face of one wall edge by edge; its parameter rectangle is [u0, u1] x [v0, v1].
class WallBuilder {
 public:
  WallBuilder(const NurbsSurface& wall, bool outward)
      : surface_(surface_of(wall)),
        outward_(outward),
        u0_(wall.knots_u.front()),
        u1_(wall.knots_u.back()),
        v0_(wall.knots_v.front()),
        v1_(wall.knots_v.back()),
        pole0_(is_pole(wall, 0)),
        pole1_(is_pole(wall, wall.count_u() - 1)),
        apex0_(cap_apex(wall.control_points.leftCols(wall.count_v()))),
        apex1_(cap_apex(wall.control_points.rightCols(wall.count_v()))) {
    builder_.MakeFace(wall_, surface_, tolerance_mm);
  }

  bool outward() const { return outward_; }
  bool pole(bool top) const { return is_last(top) ? pole1_ : pole0_; }
  const WallEnd& top() const { return is_last(true) ? last_ : first_; }
  /// An end that is no pole. @pre bound()
  Rim rim(bool top) const {
    const bool last = is_last(top);
    return {last ? last_.edge : first_.edge, Handle(Geom_BSplineCurve)::DownCast(surface_->UIso(last ? u1_ : u0_))};
  }

  /// The face within its ends; the lower one may be the upper one of another wall.
  void bound(const WallEnd* below) {
    for (const bool last : {false, true}) {
      WallEnd& end = last ? last_ : first_;
      const double u = last ? u1_ : u0_;
      if (below && last == is_last(false)) {
        end = *below;
        builder_.UpdateEdge(end.edge, new Geom2d_Line(gp_Pnt2d(u, 0), gp_Dir2d(0, 1)), wall_, tolerance_mm);
        continue;
      }
      end.vertex = vertex(u);
      end.edge = (last ? pole1_ : pole0_) ? degenerate(wall_, u, end.vertex) : rim_edge(u, end.vertex);
    }
    // Counter-clockwise in the parameter plane: along v0, up u1, back along v1, down u0.
    const TopoDS_Edge seam = seam_between(first_.vertex, last_.vertex);
    TopoDS_Wire boundary;
    builder_.MakeWire(boundary);
    builder_.Add(boundary, seam);
    builder_.Add(boundary, last_.edge);
    builder_.Add(boundary, seam.Reversed());
    builder_.Add(boundary, first_.edge.Reversed());
    boundary.Closed(true);
    builder_.Add(wall_, boundary);
  }

  /// As a shell wants it, whose faces point outward.
  TopoDS_Face face() const { return outward_ ? wall_ : TopoDS::Face(wall_.Reversed()); }

  /// What closes an end that is no pole.
  tl::expected<NamedFace, std::string> cap(bool top) {
    const bool last = is_last(top);
    auto face = cap(last ? last_.edge : first_.edge, last);
    if (!face) {
      return tl::make_unexpected(face.error());
    }
    return NamedFace{*face, name_of(last)};
  }

 private:
  // u runs up a cylinder and down a sphere.
  bool is_last(bool top) const { return top != outward_; }

  TopoDS_Vertex vertex(double u) {
    TopoDS_Vertex result;
    builder_.MakeVertex(result, surface_->Value(u, v0_), tolerance_mm);
    return result;
  }

  TopoDS_Edge seam_between(const TopoDS_Vertex& first, const TopoDS_Vertex& last) {
    TopoDS_Edge edge;
    builder_.MakeEdge(edge, surface_->VIso(v0_), tolerance_mm);
    builder_.Add(edge, first.Oriented(TopAbs_FORWARD));
    builder_.Add(edge, last.Oriented(TopAbs_REVERSED));
    builder_.UpdateEdge(edge, new Geom2d_Line(gp_Pnt2d(0, v0_), gp_Dir2d(1, 0)),
                        new Geom2d_Line(gp_Pnt2d(0, v1_), gp_Dir2d(1, 0)), wall_, tolerance_mm);
    builder_.Range(edge, u0_, u1_);
    builder_.Continuity(edge, wall_, wall_, GeomAbs_C1);
    return edge;
  }

  TopoDS_Edge rim_edge(double u, const TopoDS_Vertex& corner) {
    TopoDS_Edge edge;
    builder_.MakeEdge(edge, surface_->UIso(u), tolerance_mm);
    builder_.Add(edge, corner.Oriented(TopAbs_FORWARD));
    builder_.Add(edge, corner.Oriented(TopAbs_REVERSED));
    builder_.UpdateEdge(edge, new Geom2d_Line(gp_Pnt2d(u, 0), gp_Dir2d(0, 1)), wall_, tolerance_mm);
    builder_.Range(edge, v0_, v1_);
    return edge;
  }

  // An edge without length: all of v at one point.
  TopoDS_Edge degenerate(const TopoDS_Face& face, double u, const TopoDS_Vertex& at) {
    TopoDS_Edge edge;
    builder_.MakeEdge(edge);
    builder_.Add(edge, at.Oriented(TopAbs_FORWARD));
    builder_.Add(edge, at.Oriented(TopAbs_REVERSED));
    builder_.UpdateEdge(edge, new Geom2d_Line(gp_Pnt2d(u, 0), gp_Dir2d(0, 1)), face, tolerance_mm);
    builder_.Range(edge, face, v0_, v1_);
    builder_.Degenerated(edge, true);
    return edge;
  }

  const char* name_of(bool last) const { return last != outward_ ? "top" : "bottom"; }

  tl::expected<TopoDS_Face, std::string> cap(const TopoDS_Edge& edge, bool last) {
    double off_plane = 0;
    auto plane = disc(last, off_plane);
    if (!plane || off_plane <= tolerance_mm) {
      return plane;
    }
    return fan(edge, last);
  }

  /// The plane disc on a rim, of use if no control point lies off the plane. Its edge has the rim's control points,
  /// projected, as exact pcurve.
  tl::expected<TopoDS_Face, std::string> disc(bool last, double& off_plane) {
    const bool top = last != outward_;
    const Rim of_wall = rim(top);
    const Eigen::Vector3d& apex = last ? apex1_ : apex0_;
    const gp_XYZ centre(apex.x(), apex.y(), apex.z()), area = polygon_area(*of_wall.curve, centre);
    if (area.Modulus() < tolerance_mm * tolerance_mm) {
      return tl::make_unexpected(std::string("the ") + name_of(last) + " rim encloses no area");
    }
    const gp_XYZ upward = surface_->Pole(surface_->NbUPoles(), 1).XYZ() - surface_->Pole(1, 1).XYZ();
    if (!outward_ && area.Dot(upward) <= 0) {
      return tl::make_unexpected(std::string("the ") + name_of(last) + " rim is inside out: it runs against its wall");
    }
    const gp_Ax3 plane = plane_at(centre, top ? gp_Dir(area) : gp_Dir(area.Reversed()));
    projected(*of_wall.curve, plane, off_plane);
    return off_plane > tolerance_mm ? TopoDS_Face() : plane_disc(plane, of_wall, top);
  }

  /// The ruled face from the rim's middle to the rim: every ray from the axis meets both once.
  TopoDS_Face fan(const TopoDS_Edge& edge, bool last) {
    const auto curve = Handle(Geom_BSplineCurve)::DownCast(surface_->UIso(last ? u1_ : u0_));
    const Eigen::Vector3d& apex = last ? apex1_ : apex0_;
    const int count = curve->NbPoles();
    TColgp_Array2OfPnt poles(1, 2, 1, count);
    TColStd_Array2OfReal weights(1, 2, 1, count);
    for (int i = 1; i <= count; ++i) {
      poles(1, i) = gp_Pnt(apex.x(), apex.y(), apex.z());
      poles(2, i) = curve->Pole(i);
      weights(1, i) = weights(2, i) = curve->Weight(i);
    }
    TColStd_Array1OfReal knots_v(1, curve->NbKnots()), knots_u(1, 2);
    TColStd_Array1OfInteger counts_v(1, curve->NbKnots()), counts_u(1, 2);
    curve->Knots(knots_v);
    curve->Multiplicities(counts_v);
    knots_u(1) = 0, knots_u(2) = 1;
    counts_u.Init(2);
    TopoDS_Face face;
    builder_.MakeFace(face,
                      new Geom_BSplineSurface(poles, weights, knots_u, knots_v, counts_u, counts_v, 1, curve->Degree()),
                      tolerance_mm);
    const auto surface = Handle(Geom_BSplineSurface)::DownCast(BRep_Tool::Surface(face));
    TopoDS_Vertex middle, on_rim = TopExp::FirstVertex(edge);
    builder_.MakeVertex(middle, gp_Pnt(apex.x(), apex.y(), apex.z()), tolerance_mm);
    TopoDS_Edge seam;
    builder_.MakeEdge(seam, surface->VIso(v0_), tolerance_mm);
    builder_.Add(seam, middle.Oriented(TopAbs_FORWARD));
    builder_.Add(seam, on_rim.Oriented(TopAbs_REVERSED));
    builder_.UpdateEdge(seam, new Geom2d_Line(gp_Pnt2d(0, v0_), gp_Dir2d(1, 0)),
                        new Geom2d_Line(gp_Pnt2d(0, v1_), gp_Dir2d(1, 0)), face, tolerance_mm);
    builder_.Range(seam, 0, 1);
    builder_.Continuity(seam, face, face, GeomAbs_C0);
    const TopoDS_Edge point = degenerate(face, 0, middle);
    builder_.UpdateEdge(edge, new Geom2d_Line(gp_Pnt2d(1, 0), gp_Dir2d(0, 1)), face, tolerance_mm);
    TopoDS_Wire boundary;
    builder_.MakeWire(boundary);
    builder_.Add(boundary, seam);
    builder_.Add(boundary, edge.Oriented(TopAbs_FORWARD));
    builder_.Add(boundary, seam.Reversed());
    builder_.Add(boundary, point.Reversed());
    boundary.Closed(true);
    builder_.Add(face, boundary);
    // Its normal points to the side from which v runs counter-clockwise: up.
    return last != outward_ ? face : TopoDS::Face(face.Reversed());
  }

  BRep_Builder builder_;
  Handle(Geom_BSplineSurface) surface_;
  bool outward_;
  double u0_, u1_, v0_, v1_;
  bool pole0_, pole1_;
  Eigen::Vector3d apex0_, apex1_;
  TopoDS_Face wall_;
  WallEnd first_, last_;
};

std::optional<std::string> closing_problem(const NurbsSurface& wall) {
  if (!wall.closed_v) {
    return "the wall is open around the axis; only closed walls make a solid";
  }
  for (int i = 0; i < wall.count_u(); ++i) {
    const Eigen::Vector4d first = wall.control_point(i, 0);
    const Eigen::Vector4d last = wall.control_point(i, wall.count_v() - 1);
    const double gap = (first.head<3>() / first.w() - last.head<3>() / last.w()).norm();
    if (gap > tolerance_mm) {
      return "the wall does not close: its row " + std::to_string(i) + " of control points ends " + number(gap) +
             " mm from its start";
    }
  }
  return std::nullopt;
}

/// How far the rims of two walls are apart, control point by control point; infinite if their knots or weights differ.
double gap_between(const NurbsSurface& below, bool below_outward, const NurbsSurface& above, bool above_outward) {
  const int row_below = below_outward ? 0 : below.count_u() - 1, row_above = above_outward ? above.count_u() - 1 : 0;
  if (below.degree_v != above.degree_v || below.knots_v != above.knots_v) {
    return std::numeric_limits<double>::infinity();
  }
  double gap = 0;
  for (int j = 0; j < below.count_v(); ++j) {
    const Eigen::Vector4d a = below.control_point(row_below, j), b = above.control_point(row_above, j);
    gap = std::max(gap, (a.head<3>() / a.w() - b.head<3>() / b.w()).norm());
    if (std::abs(a.w() / b.w() - 1) > tolerance_mm) {
      return std::numeric_limits<double>::infinity();
    }
  }
  return gap;
}

}  // namespace

tl::expected<WallBody, std::string> solid_of_walls(std::span<const NurbsSurface> walls) {
  if (walls.empty()) {
    return tl::make_unexpected(std::string("there is no wall"));
  }
  WallBody body;
  std::vector<WallBuilder> builders;
  for (const NurbsSurface& wall : walls) {
    if (auto problem = wall_problem(wall)) {
      return tl::make_unexpected(std::move(*problem));
    }
    if (auto problem = closing_problem(wall)) {
      return tl::make_unexpected(std::move(*problem));
    }
    // Discs on the rims that walls share cancel.
    const double volume = signed_volume_mm3(wall);
    if (!std::isfinite(volume) || volume == 0) {
      return tl::make_unexpected(std::string("the wall encloses no volume"));
    }
    body.volume_mm3 += std::abs(volume);
    builders.emplace_back(wall, volume < 0);
  }
  const BRep_Builder builder;
  TopoDS_Shell shell;
  builder.MakeShell(shell);
  for (std::size_t k = 0; k < builders.size(); ++k) {
    // A wall and a head share their rim; two walls have a ring between theirs.
    const double gap =
        k == 0 ? 0 : gap_between(walls[k - 1], builders[k - 1].outward(), walls[k], builders[k].outward());
    const bool shared = k > 0 && gap <= tolerance_mm;
    builders[k].bound(shared ? &builders[k - 1].top() : nullptr);
    const char* const name = walls.size() == 1 ? "wall" : builders[k].outward() ? "head" : "body";
    body.walls.push_back({builders[k].face(), name});
    builder.Add(shell, body.walls.back().face);
    if (k == 0 || shared) {
      continue;
    }
    if (builders[k - 1].outward() || builders[k].outward()) {
      return tl::make_unexpected(std::isfinite(gap)
                                     ? "two walls do not meet: their rims are " + number(gap) + " mm apart"
                                     : std::string("two walls have other knots around and share no rim"));
    }
    auto ring = plane_ring(builders[k - 1].rim(true), builders[k].rim(false));
    if (!ring) {
      return tl::make_unexpected(ring.error());
    }
    builder.Add(shell, *ring);
    body.walls.push_back({*ring, "shoulder"});
  }
  for (const bool top : {false, true}) {
    WallBuilder& wall = top ? builders.back() : builders.front();
    if (wall.pole(top)) {
      continue;
    }
    auto cap = wall.cap(top);
    if (!cap) {
      return tl::make_unexpected(cap.error());
    }
    builder.Add(shell, cap->face);
    body.caps.push_back(*cap);
  }
  shell.Closed(true);
  TopoDS_Solid solid;
  builder.MakeSolid(solid);
  builder.Add(solid, shell);
  body.shape = solid;
  if (!BRepCheck_Analyzer(solid).IsValid()) {
    return tl::make_unexpected(std::string("OpenCASCADE finds the solid invalid"));
  }
  return body;
}

}  // namespace celadon
