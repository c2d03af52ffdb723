#include "daemon/export/wall_solid.h"

#include <BRepCheck_Analyzer.hxx>
#include <BRep_Builder.hxx>
#include <Geom2d_BSplineCurve.hxx>
#include <Geom2d_Line.hxx>
#include <Geom_BSplineCurve.hxx>
#include <Geom_BSplineSurface.hxx>
#include <Geom_Plane.hxx>
#include <TColStd_Array1OfInteger.hxx>
#include <TColStd_Array1OfReal.hxx>
#include <TColStd_Array2OfReal.hxx>
#include <TColgp_Array1OfPnt2d.hxx>
#include <TColgp_Array2OfPnt.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Shell.hxx>
#include <TopoDS_Vertex.hxx>
#include <TopoDS_Wire.hxx>
#include <algorithm>
#include <cmath>
#include <optional>
#include <sstream>

#include "daemon/export/wall_volume.h"

namespace celadon {
namespace {

/// OpenCASCADE's own confusion distance; also the uncertainty written into the file.
constexpr double tolerance_mm = 1e-7;

std::string number(double value) {
  std::ostringstream text;
  text.precision(6);
  text << value;
  return text.str();
}

/// Distinct knots with their multiplicities.
struct KnotTable {
  std::vector<double> values;
  std::vector<int> multiplicities;
  explicit KnotTable(const std::vector<double>& knots) {
    for (const double knot : knots) {
      if (values.empty() || knot > values.back()) {
        values.push_back(knot);
        multiplicities.push_back(0);
      }
      ++multiplicities.back();
    }
  }
  TColStd_Array1OfReal knots() const {
    TColStd_Array1OfReal array(1, static_cast<int>(values.size()));
    std::copy(values.begin(), values.end(), array.begin());
    return array;
  }
  TColStd_Array1OfInteger counts() const {
    TColStd_Array1OfInteger array(1, static_cast<int>(multiplicities.size()));
    std::copy(multiplicities.begin(), multiplicities.end(), array.begin());
    return array;
  }
};

std::optional<std::string> knot_problem(const char* direction, const std::vector<double>& knots, int degree) {
  if (!std::all_of(knots.begin(), knots.end(), [](double knot) { return std::isfinite(knot); }) ||
      !std::is_sorted(knots.begin(), knots.end())) {
    return std::string("the knots in ") + direction + " are not ascending finite numbers";
  }
  const KnotTable table(knots);
  for (std::size_t i = 0; i < table.values.size(); ++i) {
    const bool end = i == 0 || i + 1 == table.values.size();
    if (end ? table.multiplicities[i] != degree + 1 : table.multiplicities[i] > degree) {
      return std::string("the knot ") + number(table.values[i]) + " in " + direction + " has multiplicity " +
             std::to_string(table.multiplicities[i]) + " at degree " + std::to_string(degree);
    }
  }
  return std::nullopt;
}

std::optional<std::string> wall_problem(const NurbsSurface& wall) {
  if (auto problem = knot_problem("u", wall.knots_u, wall.degree_u)) {
    return problem;
  }
  if (auto problem = knot_problem("v", wall.knots_v, wall.degree_v)) {
    return problem;
  }
  for (Eigen::Index i = 0; i < wall.control_points.cols(); ++i) {
    const Eigen::Vector4d point = wall.control_points.col(i);
    if (!point.allFinite() || !(point.w() > 1e-12)) {
      return "control point " + std::to_string(i) + " is not finite or its weight is not positive";
    }
  }
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

Handle(Geom_BSplineSurface) surface_of(const NurbsSurface& wall) {
  TColgp_Array2OfPnt poles(1, wall.count_u(), 1, wall.count_v());
  TColStd_Array2OfReal weights(1, wall.count_u(), 1, wall.count_v());
  for (int i = 0; i < wall.count_u(); ++i) {
    for (int j = 0; j < wall.count_v(); ++j) {
      const Eigen::Vector4d point = wall.control_point(i, j);
      poles(i + 1, j + 1) = gp_Pnt(point.x() / point.w(), point.y() / point.w(), point.z() / point.w());
      weights(i + 1, j + 1) = point.w();
    }
  }
  const KnotTable u(wall.knots_u);
  const KnotTable v(wall.knots_v);
  return new Geom_BSplineSurface(poles, weights, u.knots(), v.knots(), u.counts(), v.counts(), wall.degree_u,
                                 wall.degree_v);
}

/// Builds the body edge by edge; the parameter rectangle of the wall is [u0, u1] x [v0, v1].
class BodyBuilder {
 public:
  explicit BodyBuilder(const NurbsSurface& wall)
      : surface_(surface_of(wall)),
        u0_(wall.knots_u.front()),
        u1_(wall.knots_u.back()),
        v0_(wall.knots_v.front()),
        v1_(wall.knots_v.back()) {
    builder_.MakeFace(wall_, surface_, tolerance_mm);
  }

  tl::expected<WallSolid, std::string> build() {
    const TopoDS_Vertex bottom_vertex = vertex(u0_);
    const TopoDS_Vertex top_vertex = vertex(u1_);
    const TopoDS_Edge seam = seam_between(bottom_vertex, top_vertex);
    const TopoDS_Edge bottom_rim = rim(u0_, bottom_vertex);
    const TopoDS_Edge top_rim = rim(u1_, top_vertex);

    // Counter-clockwise in the parameter plane: along v0, up u1, back along v1, down u0.
    TopoDS_Wire boundary;
    builder_.MakeWire(boundary);
    builder_.Add(boundary, seam);
    builder_.Add(boundary, top_rim);
    builder_.Add(boundary, seam.Reversed());
    builder_.Add(boundary, bottom_rim.Reversed());
    boundary.Closed(true);
    builder_.Add(wall_, boundary);

    const auto bottom = disc(bottom_rim, End::bottom);
    const auto top = disc(top_rim, End::top);
    for (const auto* end : {&bottom, &top}) {
      if (!*end) {
        return tl::make_unexpected(end->error());
      }
    }
    WallSolid body;
    // S_u x S_v points inward (the contract of symbolic_product), a shell's faces point outward.
    body.wall = TopoDS::Face(wall_.Reversed());
    body.bottom = *bottom;
    body.top = *top;
    TopoDS_Shell shell;
    builder_.MakeShell(shell);
    builder_.Add(shell, body.wall);
    builder_.Add(shell, body.bottom);
    builder_.Add(shell, body.top);
    shell.Closed(true);
    builder_.MakeSolid(body.solid);
    builder_.Add(body.solid, shell);
    return body;
  }

 private:
  enum class End { bottom, top };

  TopoDS_Vertex vertex(double u) {
    TopoDS_Vertex result;
    builder_.MakeVertex(result, surface_->Value(u, v0_), tolerance_mm);
    return result;
  }

  TopoDS_Edge seam_between(const TopoDS_Vertex& bottom, const TopoDS_Vertex& top) {
    TopoDS_Edge edge;
    builder_.MakeEdge(edge, surface_->VIso(v0_), tolerance_mm);
    builder_.Add(edge, bottom.Oriented(TopAbs_FORWARD));
    builder_.Add(edge, top.Oriented(TopAbs_REVERSED));
    builder_.UpdateEdge(edge, new Geom2d_Line(gp_Pnt2d(0, v0_), gp_Dir2d(1, 0)),
                        new Geom2d_Line(gp_Pnt2d(0, v1_), gp_Dir2d(1, 0)), wall_, tolerance_mm);
    builder_.Range(edge, u0_, u1_);
    builder_.Continuity(edge, wall_, wall_, GeomAbs_C1);
    return edge;
  }

  TopoDS_Edge rim(double u, const TopoDS_Vertex& corner) {
    TopoDS_Edge edge;
    builder_.MakeEdge(edge, surface_->UIso(u), tolerance_mm);
    builder_.Add(edge, corner.Oriented(TopAbs_FORWARD));
    builder_.Add(edge, corner.Oriented(TopAbs_REVERSED));
    builder_.UpdateEdge(edge, new Geom2d_Line(gp_Pnt2d(u, 0), gp_Dir2d(0, 1)), wall_, tolerance_mm);
    builder_.Range(edge, v0_, v1_);
    return edge;
  }

  /// The plane disc on a rim. Its edge has the rim's control points, projected, as exact pcurve.
  tl::expected<TopoDS_Face, std::string> disc(const TopoDS_Edge& edge, End end) {
    const bool top = end == End::top;
    const auto curve = Handle(Geom_BSplineCurve)::DownCast(surface_->UIso(top ? u1_ : u0_));
    const int count = curve->NbPoles();
    gp_XYZ centre(0, 0, 0);
    for (int i = 1; i < count; ++i) {
      centre += curve->Pole(i).XYZ() / (count - 1);
    }
    // Newell's normal of the control polygon; +v runs counter-clockwise seen from the top.
    gp_XYZ normal(0, 0, 0);
    for (int i = 1; i < count; ++i) {
      normal += (curve->Pole(i).XYZ() - centre).Crossed(curve->Pole(i + 1).XYZ() - centre);
    }
    const gp_XYZ upward = surface_->Pole(surface_->NbUPoles(), 1).XYZ() - surface_->Pole(1, 1).XYZ();
    if (normal.Modulus() < tolerance_mm * tolerance_mm) {
      return tl::make_unexpected(std::string(top ? "the top" : "the bottom") + " rim encloses no area");
    }
    if (normal.Dot(upward) <= 0) {
      return tl::make_unexpected(std::string("the wall is inside out: S_u x S_v must point inward"));
    }
    const gp_Dir outward = top ? gp_Dir(normal) : gp_Dir(normal.Reversed());
    // Any direction in the plane will do; the axis furthest from the normal keeps a level disc's numbers simple.
    const gp_Dir x_hint = std::abs(outward.X()) < 0.9 ? gp_Dir(1, 0, 0) : gp_Dir(0, 1, 0);
    const gp_Ax3 frame(gp_Pnt(centre), outward, x_hint);

    TColgp_Array1OfPnt2d poles(1, count);
    TColStd_Array1OfReal weights(1, count);
    double off_plane = 0;
    for (int i = 1; i <= count; ++i) {
      const gp_Vec from_centre(frame.Location(), curve->Pole(i));
      poles(i) = gp_Pnt2d(from_centre.Dot(gp_Vec(frame.XDirection())), from_centre.Dot(gp_Vec(frame.YDirection())));
      weights(i) = curve->Weight(i);
      off_plane = std::max(off_plane, std::abs(from_centre.Dot(gp_Vec(frame.Direction()))));
    }
    if (off_plane > tolerance_mm) {
      return tl::make_unexpected(std::string("the ") + (top ? "top" : "bottom") + " rim leaves its plane by " +
                                 number(off_plane) + " mm; a disc cannot close it: clip the wall at one height");
    }
    TColStd_Array1OfReal knots(1, curve->NbKnots());
    TColStd_Array1OfInteger multiplicities(1, curve->NbKnots());
    curve->Knots(knots);
    curve->Multiplicities(multiplicities);

    TopoDS_Face face;
    builder_.MakeFace(face, new Geom_Plane(frame), tolerance_mm);
    builder_.UpdateEdge(edge, new Geom2d_BSplineCurve(poles, weights, knots, multiplicities, curve->Degree()), face,
                        tolerance_mm);
    TopoDS_Wire boundary;
    builder_.MakeWire(boundary);
    builder_.Add(boundary, top ? edge : TopoDS::Edge(edge.Reversed()));
    boundary.Closed(true);
    builder_.Add(face, boundary);
    return face;
  }

  BRep_Builder builder_;
  Handle(Geom_BSplineSurface) surface_;
  double u0_, u1_, v0_, v1_;
  TopoDS_Face wall_;
};

}  // namespace

tl::expected<WallSolid, std::string> solid_of_wall(const NurbsSurface& wall) {
  if (auto problem = wall_problem(wall)) {
    return tl::make_unexpected(std::move(*problem));
  }
  auto body = BodyBuilder(wall).build();
  if (!body) {
    return body;
  }
  if (!BRepCheck_Analyzer(body->solid).IsValid()) {
    return tl::make_unexpected(std::string("OpenCASCADE finds the solid invalid"));
  }
  body->volume_mm3 = enclosed_volume_mm3(wall);
  if (!(body->volume_mm3 > 0)) {
    return tl::make_unexpected("the solid has a volume of " + number(body->volume_mm3) + " mm3, not a positive one");
  }
  return body;
}

}  // namespace celadon
