// Meshes against closed forms: distance of densely sampled wall points, closedness, volume.

#include "daemon/files/mesh_files.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "fitting/range_function.h"
#include "tests/daemon/closed_wall.h"
#include "tests/daemon/triangle_reader.h"

namespace celadon {
namespace {

using testing::ClosedWall;
using testing::Triangles;

using std::numbers::pi;

/// The range function of a wall in closed form: its Bernstein coefficients are B-spline coefficients at full knots.
RangeFunction range_of(const ClosedWall& wall, const Eigen::Isometry3d& X_WB = Eigen::Isometry3d::Identity()) {
  BaseSurface base;
  base.band_start = wall.z_start_mm;
  base.band_end = wall.z_end_mm;
  base.X_WB = X_WB;
  const int q = wall.degree_v;
  std::vector<double> knots_v = {0.0};
  const auto rows = static_cast<Eigen::Index>(wall.bernstein.size());
  if (q == 0) {
    knots_v = {0, 4};
  } else {
    for (int joint = 0; joint <= 4; ++joint) {
      knots_v.insert(knots_v.end(), static_cast<std::size_t>(q), joint);
    }
    knots_v.push_back(4);
  }
  Eigen::MatrixXd coefficients(rows, q == 0 ? 1 : 4 * q + 1);
  for (Eigen::Index i = 0; i < rows; ++i) {
    for (Eigen::Index j = 0; j < coefficients.cols(); ++j) {
      const auto arc = static_cast<std::size_t>(q == 0 ? 0 : std::min<Eigen::Index>(3, j / q));
      const auto k = static_cast<std::size_t>(q == 0 ? 0 : j - static_cast<Eigen::Index>(arc) * q);
      coefficients(i, j) = wall.bernstein[static_cast<std::size_t>(i)][arc][k];
    }
  }
  return {base, wall.degree_u, q, wall.knots_u, knots_v, coefficients};
}

Triangles triangles_of(const TriangleMesh& mesh) {
  return {mesh.vertices_mm, mesh.triangles, {}};
}

struct MeshCase {
  const char* name;
  ClosedWall wall;
  double chord_mm;
  std::size_t most_triangles;  ///< guards against needless refinement
};

class Meshes : public ::testing::TestWithParam<MeshCase> {};

TEST_P(Meshes, AreClosedAndWithinTheirTolerance) {
  const auto& [name, wall, chord_mm, most] = GetParam();
  const RangeFunction range = range_of(wall);
  const TriangleMesh mesh = mesh_of(range, chord_mm);
  const Triangles triangles = triangles_of(mesh);
  EXPECT_TRUE(triangles.watertight());
  EXPECT_EQ(triangles.euler_characteristic(), 2);
  double worst = 0;
  // Steps that share no divisor with the grid's.
  for (int i = 0; i <= 24; ++i) {
    for (int j = 0; j < 97; ++j) {
      worst = std::max(worst, triangles.distance(wall.point(i / 24.0, 4 * (j + 0.37) / 97)));
    }
  }
  EXPECT_LE(worst, chord_mm);
  EXPECT_LE(mesh.triangles.size(), most);
  // An inscribed body's volume is off by at most chord x area.
  const double volume = wall.volume_mm3();
  const double area = 2 * pi * 60 * (wall.z_end_mm - wall.z_start_mm) * 2;
  EXPECT_GT(triangles.volume(), 0);
  EXPECT_NEAR(triangles.volume(), volume, chord_mm * area);
  RecordProperty("worst_mm", std::to_string(worst));
  RecordProperty("triangles", std::to_string(mesh.triangles.size()));
}

ClosedWall steep_lobes() {
  ClosedWall wall = testing::lobed(3, 8, 3, 60);
  for (auto& row : wall.bernstein) {
    for (auto& arc : row) {
      for (double& value : arc) {
        value = 40 + 3 * (value - 40);
      }
    }
  }
  return wall;
}

INSTANTIATE_TEST_SUITE_P(
    All, Meshes,
    ::testing::Values(MeshCase{"cylinder", testing::cylinder(30, 100), 0.05, 300},
                      MeshCase{"cylinder_coarse", testing::cylinder(30, 100), 2, 80},
                      MeshCase{"cone", testing::revolution(1, {50, 10}, 60), 0.05, 3000},
                      MeshCase{"polyline", testing::revolution(1, {30, 50, 20, 40}, 60), 0.1, 5000},
                      MeshCase{"vase", testing::revolution(3, {30, 41, 35, 28, 33, 39}, 120), 0.05, 9000},
                      MeshCase{"lobes", testing::lobed(3, 9, 3, 120), 0.1, 10000},
                      MeshCase{"lobes_of_degree_1", testing::lobed(1, 5, 1, 80), 0.2, 6000},
                      MeshCase{"lobes_of_degree_5", testing::lobed(5, 9, 5, 80), 0.2, 8000},
                      MeshCase{"steep_lobes", steep_lobes(), 0.5, 20000}),
    [](const auto& tested) { return std::string(tested.param.name); });

// Of a part of the turn: one sheet, normals outward.
TEST(MeshFiles, APartOfTheTurnIsASheet) {
  BaseSurface base;
  base.band_end = 40;
  base.arcs = BaseArcs::open(5, 2.5);
  Eigen::MatrixXd f = Eigen::MatrixXd::Constant(4, 5, 25);
  f.row(1) << 26, 24, 23, 26, 25;
  f.row(3) << 24, 26, 25, 24, 26;
  const RangeFunction range(base, 3, 3, {0, 0, 0, 0, 1, 1, 1, 1}, {0, 0, 0, 0, 1, 2, 2, 2, 2}, f);
  const NurbsSurface surface = symbolic_product(range);
  const Triangles triangles = triangles_of(mesh_of(range, 0.05));
  EXPECT_FALSE(triangles.watertight());
  EXPECT_EQ(triangles.euler_characteristic(), 1);
  double worst = 0;
  for (int i = 0; i <= 24; ++i)
    for (int j = 0; j <= 48; ++j) worst = std::max(worst, triangles.distance(surface.evaluate(i / 24.0, 2 * j / 48.0)));
  EXPECT_LE(worst, 0.05);
  for (const auto& face : triangles.faces) {
    const Eigen::Vector3d a = triangles.vertices[face[0]], b = triangles.vertices[face[1]],
                          c = triangles.vertices[face[2]];
    EXPECT_GT((b - a).cross(c - a).dot(Eigen::Vector3d(a.x(), a.y(), 0)), 0);
  }
}

// Lobes between rims that wave: against points of the exact surface.
TEST(MeshFiles, RimsThatAreNotPlaneAreFollowedWithinTheTolerance) {
  RangeFunction range = range_of(testing::lobed(3, 6, 3, 60));
  BaseSurface base = range.base(), over = base;
  Eigen::MatrixXd heights(2, range.coefficients().cols());
  for (Eigen::Index j = 0; j < heights.cols(); ++j) {
    const double t = 2 * pi * static_cast<double>(j) / static_cast<double>(heights.cols() - 1);
    heights.col(j) << 4 * std::cos(3 * t), 60 + 9 * std::cos(2 * t + 1);
  }
  base.heights =
      std::make_shared<const RangeFunction>(over, 1, 3, std::vector<double>{0, 0, 1, 1}, range.knots_v(), heights);
  range = {base, range.degree_u(), range.degree_v(), range.knots_u(), range.knots_v(), range.coefficients()};
  const NurbsSurface surface = symbolic_product(range);
  for (const double chord_mm : {0.5, 0.05}) {
    const Triangles triangles = triangles_of(mesh_of(range, chord_mm));
    EXPECT_TRUE(triangles.watertight());
    EXPECT_EQ(triangles.euler_characteristic(), 2);
    EXPECT_LE(triangles.faces.size(), chord_mm < 0.1 ? 100000u : 20000u);
    double worst = 0;
    for (int i = 0; i <= 24; ++i)
      for (int j = 0; j < 97; ++j)
        worst = std::max(worst, triangles.distance(surface.evaluate(i / 24.0, 4 * (j + 0.37) / 97)));
    EXPECT_LE(worst, chord_mm);
    EXPECT_GT(worst, 0.05 * chord_mm);
  }
}

// Three lobes, with both poles, one and none: against points of the exact surface.
TEST(MeshFiles, BodiesOverASphereAreClosedAndWithinTheirTolerance) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_end = 2;
  Eigen::MatrixXd f = Eigen::MatrixXd::Constant(6, 9, 25);
  for (int j = 0; j < 9; ++j) f(3, j) += 3 * std::cos(2 * pi * 3 * (j % 8) / 8);
  const RangeFunction lobed(base, 2, 2, {0, 0, 0, 0.5, 1, 1.5, 2, 2, 2}, {0, 0, 0, 0.5, 1, 1.5, 2, 2.5, 3, 4, 4, 4}, f);
  for (const RangeFunction& range : {lobed, lobed.clipped(0.4, 2), lobed.clipped(0.4, 1.5)}) {
    const double chord_mm = 0.02;
    const TriangleMesh mesh = mesh_of(range, chord_mm);
    const Triangles triangles = triangles_of(mesh);
    EXPECT_TRUE(triangles.watertight());
    EXPECT_EQ(triangles.euler_characteristic(), 2);
    EXPECT_LE(mesh.triangles.size(), 60000u);
    double worst = 0;
    const NurbsSurface surface = symbolic_product(range);
    const double start = range.base().band_start, end = range.base().band_end;
    for (int i = 0; i <= 24; ++i)
      for (int j = 0; j < 97; ++j)
        worst = std::max(worst,
                         triangles.distance(surface.evaluate(start + (end - start) * i / 24.0, 4 * (j + 0.37) / 97)));
    EXPECT_LE(worst, chord_mm);
    EXPECT_GT(triangles.volume(), 0);
  }
  const RangeFunction ball(base, 0, 0, {0, 2}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25));
  EXPECT_NEAR(triangles_of(mesh_of(ball, 0.005)).volume() / (4.0 / 3 * pi * 25 * 25 * 25), 1, 1e-3);
}

// Part of a ball's turn, with both poles, one and none: points, area and chords in closed form.
TEST(MeshFiles, APartOfTheTurnOfABallIsASheet) {
  constexpr double kRadius = 25, kChord = 0.01, kStart = 5.2, kRange = 2;
  const BaseArcs& meridian = BaseSurface::meridian();
  for (const auto& [start, end] :
       {std::pair{0.0, 2.0}, std::pair{0.0, 1.2}, std::pair{0.7, 2.0}, std::pair{0.4, 1.5}}) {
    BaseSurface base;
    base.kind = BaseKind::sphere;
    base.arcs = BaseArcs::open(kStart, kRange);
    base.band_start = start, base.band_end = end;
    base.X_WB.translation() << 3, -4, 7;
    const RangeFunction ball(base, 0, 0, {start, end}, {0, 2}, Eigen::MatrixXd::Constant(1, 1, kRadius));
    const Triangles triangles = triangles_of(mesh_of(ball, kChord));
    EXPECT_FALSE(triangles.watertight());
    EXPECT_EQ(triangles.euler_characteristic(), 1);
    EXPECT_LE(triangles.faces.size(), 30000u);
    for (const Eigen::Vector3d& p : triangles.vertices) {
      const Eigen::Vector3d at = p - base.X_WB.translation();
      EXPECT_NEAR(at.norm(), kRadius, 1e-12);
      if (at.head<2>().norm() < 1e-9) continue;
      EXPECT_LE(std::abs(std::remainder(std::atan2(at.y(), at.x()) - kStart - kRange / 2, 2 * pi)), kRange / 2 + 1e-12);
    }
    double area = 0;
    for (const auto& face : triangles.faces) {
      const Eigen::Vector3d a = triangles.vertices[face[0]], b = triangles.vertices[face[1]],
                            c = triangles.vertices[face[2]], normal = (b - a).cross(c - a),
                            middle = (a + b + c) / 3 - base.X_WB.translation();
      EXPECT_GT(normal.dot(middle), 0);
      EXPECT_GT(middle.norm(), kRadius - kChord);
      area += normal.norm() / 2;
    }
    const double expected =
        kRadius * kRadius * kRange * (std::cos(meridian.theta_of_v(start)) - std::cos(meridian.theta_of_v(end)));
    EXPECT_NEAR(area / expected, 1, 2 * kChord / kRadius);
  }
}

// With lobes: against points of the exact surface.
TEST(MeshFiles, APartOfTheTurnOfALobedBallIsWithinItsTolerance) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.arcs = BaseArcs::open(5.2, 2);
  base.band_end = 1.4;
  Eigen::MatrixXd f = Eigen::MatrixXd::Constant(5, 5, 25);
  f.row(2) << 26, 24, 23, 26, 25;
  f.row(4) << 24, 26, 25, 24, 26;
  const RangeFunction range(base, 3, 3, {0, 0, 0, 0, 0.7, 1.4, 1.4, 1.4, 1.4}, {0, 0, 0, 0, 1, 2, 2, 2, 2}, f);
  const NurbsSurface surface = symbolic_product(range);
  for (const double chord_mm : {0.2, 0.03}) {
    const Triangles triangles = triangles_of(mesh_of(range, chord_mm));
    EXPECT_EQ(triangles.euler_characteristic(), 1);
    double worst = 0;
    for (int i = 0; i <= 24; ++i)
      for (int j = 0; j <= 48; ++j)
        worst = std::max(worst, triangles.distance(surface.evaluate(1.4 * i / 24.0, 2 * j / 48.0)));
    EXPECT_LE(worst, chord_mm);
    EXPECT_GT(worst, 0.05 * chord_mm);
  }
}

// A lobed wall under a dome with its rim, over an open bottom: against points of both exact surfaces.
TEST(MeshFiles, PiecesShareTheirRims) {
  const ClosedWall wall = testing::lobed(3, 6, 3, 50);
  const RangeFunction body = range_of(wall);
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_end = 1;
  base.X_WB.translation().z() = body.base().band_end;
  // The dome's rim is the body's; its rows shrink to a level pole.
  Eigen::MatrixXd f(5, body.coefficients().cols());
  for (int i = 0; i < 5; ++i)
    f.row(i) = i == 4
                   ? Eigen::MatrixXd(body.coefficients().bottomRows(1))
                   : Eigen::MatrixXd(Eigen::MatrixXd::Constant(1, f.cols(), body.coefficients().bottomRows(1).mean()));
  const RangeFunction head(base, 3, body.degree_v(), {0, 0, 0, 0, 0.5, 1, 1, 1, 1}, body.knots_v(), f);
  const std::vector<const RangeFunction*> pieces = {&body, &head};
  const double chord_mm = 0.2;
  const Triangles triangles = triangles_of(mesh_of(pieces, chord_mm));
  EXPECT_TRUE(triangles.watertight());
  EXPECT_EQ(triangles.euler_characteristic(), 2);
  EXPECT_LE(triangles.faces.size(), 50000u);
  double worst = 0;
  for (const RangeFunction* piece : pieces) {
    const NurbsSurface surface = symbolic_product(*piece);
    for (int i = 0; i <= 12; ++i)
      for (int j = 0; j < 49; ++j)
        worst = std::max(worst, triangles.distance(surface.evaluate(i / 12.0, 4 * (j + 0.37) / 49)));
  }
  EXPECT_LE(worst, chord_mm);
  EXPECT_GT(triangles.volume(), wall.volume_mm3());
}

// A lobed wall on a foot that reaches beyond it: knots around of the one are not those of the other.
TEST(MeshFiles, ShouldersAreRingsBetweenWalls) {
  const ClosedWall lobed = testing::lobed(3, 6, 3, 50), foot = testing::cylinder(90, 10);
  Eigen::Isometry3d raised = Eigen::Isometry3d::Identity();
  raised.translation().z() = 10;
  const RangeFunction below = range_of(foot), above = range_of(lobed, raised);
  const std::vector<const RangeFunction*> pieces = {&below, &above};
  const double chord_mm = 0.05;
  const Triangles triangles = triangles_of(mesh_of(pieces, chord_mm));
  EXPECT_TRUE(triangles.watertight());
  EXPECT_EQ(triangles.euler_characteristic(), 2);
  const double volume = pi * 8100 * 10 + lobed.volume_mm3();
  EXPECT_NEAR(triangles.volume() / volume, 1, 1e-3);
  double worst = 0;
  for (const RangeFunction* piece : pieces)
    for (int i = 0; i <= 12; ++i)
      for (int j = 0; j < 49; ++j) {
        const double along = piece->base().band_start + (piece->base().band_end - piece->base().band_start) * i / 12;
        worst = std::max(worst, triangles.distance(piece->surface_point(2 * pi * (j + 0.37) / 49, along).p_W));
      }
  EXPECT_LE(worst, chord_mm);
}

TEST(MeshFiles, FollowThePlacementOfTheBase) {
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  X_WB.rotate(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, -1, 2).normalized()));
  X_WB.pretranslate(Eigen::Vector3d(100, -50, 20));
  const ClosedWall wall = testing::lobed(3, 6, 3, 50);
  const Triangles placed = triangles_of(mesh_of(range_of(wall, X_WB), 0.2));
  const Triangles upright = triangles_of(mesh_of(range_of(wall), 0.2));
  ASSERT_EQ(placed.vertices.size(), upright.vertices.size());
  EXPECT_LT((placed.vertices[17] - X_WB * upright.vertices[17]).norm(), 1e-12);
  EXPECT_NEAR(placed.volume() / upright.volume(), 1, 1e-12);
}

TEST(MeshFiles, FinerToleranceGivesMoreTriangles) {
  const RangeFunction range = range_of(testing::lobed(3, 6, 3, 50));
  const std::size_t coarse = mesh_of(range, 0.1).triangles.size();
  const std::size_t fine = mesh_of(range, 0.01).triangles.size();
  // Both directions refine with the square root.
  EXPECT_GT(fine, 6 * coarse);
  EXPECT_LT(fine, 15 * coarse);
}

TEST(MeshFiles, StlAndPlyHoldTheMesh) {
  const RangeFunction range = range_of(testing::revolution(3, {30, 41, 35, 28}, 70));
  const TriangleMesh mesh = mesh_of(range, 0.1);
  const std::string header = "solid is not what this line says, chord 0.1 mm\nsecond line";
  const std::string stl = binary_stl(mesh, header);
  const Triangles from_stl = testing::read_stl(stl);
  EXPECT_EQ(stl.substr(1, 40), header.substr(1, 40));
  EXPECT_EQ(from_stl.faces.size(), mesh.triangles.size());
  EXPECT_EQ(from_stl.vertices.size(), mesh.vertices_mm.size());
  EXPECT_TRUE(from_stl.watertight());
  EXPECT_EQ(from_stl.euler_characteristic(), 2);
  EXPECT_NEAR(from_stl.volume() / triangles_of(mesh).volume(), 1, 1e-6);
  for (std::size_t i = 0; i < from_stl.faces.size(); ++i) {
    const auto& face = from_stl.faces[i];
    const Eigen::Vector3d& a = from_stl.vertices[face[0]];
    const Eigen::Vector3d n = (from_stl.vertices[face[1]] - a).cross(from_stl.vertices[face[2]] - a).normalized();
    ASSERT_GT(n.dot(from_stl.normals[i]), 0.9999);
  }

  const std::string ply = binary_ply(mesh, header);
  const Triangles from_ply = testing::read_ply_triangles(ply);
  EXPECT_TRUE(from_ply.watertight());
  EXPECT_EQ(from_ply.faces, mesh.triangles);
  EXPECT_THAT(ply, ::testing::HasSubstr("\ncomment solid is not what this line says, chord 0.1 mm second line\n"));
  EXPECT_EQ(ply, binary_ply(mesh_of(range, 0.1), header));
  EXPECT_EQ(stl, binary_stl(mesh_of(range, 0.1), header));
}

TEST(MeshFiles, RefuseWhatMakesNoSense) {
  const RangeFunction range = range_of(testing::cylinder(30, 100));
  EXPECT_THROW(mesh_of(range, 0), std::invalid_argument);
  EXPECT_THROW(mesh_of(range, std::nan("")), std::invalid_argument);
  EXPECT_THROW(mesh_of(range_of(testing::lobed(3, 6, 3, 50)), 1e-12), std::length_error);
  EXPECT_THROW(mesh_of(range_of(testing::revolution(3, {30, 30, -40, 30}, 50)), 0.1), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
