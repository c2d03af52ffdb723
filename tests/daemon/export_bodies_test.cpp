// Bodies of several walls, over spheres, of parts of the turn, with rims that are not plane: read back from STEP files.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <memory>
#include <numbers>
#include <set>
#include <vector>

#include "fitting/nurbs_surface.h"
#include "fitting/range_function.h"
#include "tests/daemon/closed_wall.h"
#include "tests/daemon/export_fixture.h"
#include "tests/daemon/step_reader.h"

namespace celadon {
namespace {

using testing::ClosedWall;
using testing::Export;
using ::testing::HasSubstr;
using ::testing::Not;
using testing::StepFile;
using testing::StepSurface;
using testing::wall_of;
using testing::Written;

// A quarter of a tube, a lobed third, a part of a ball with its pole: shells of one face that read back bit for bit.
TEST_F(Export, WallsThatAreOpenAroundAreShells) {
  std::vector<RangeFunction> parts;
  BaseSurface base;
  base.band_end = 40;
  base.arcs = BaseArcs::open(0.3, std::numbers::pi / 2);
  parts.emplace_back(base, 0, 0, std::vector<double>{0, 1}, std::vector<double>{0, 1},
                     Eigen::MatrixXd::Constant(1, 1, 20));
  base.arcs = BaseArcs::open(5, 2.5);
  Eigen::MatrixXd f = Eigen::MatrixXd::Constant(4, 5, 25);
  f.row(1) << 26, 24, 23, 26, 25;
  f.row(3) << 24, 26, 25, 24, 26;
  parts.emplace_back(base, 3, 3, std::vector<double>{0, 0, 0, 0, 1, 1, 1, 1},
                     std::vector<double>{0, 0, 0, 0, 1, 2, 2, 2, 2}, f);
  base.kind = BaseKind::sphere;
  base.band_end = 1.2;
  parts.emplace_back(base, 0, 0, std::vector<double>{0, 1.2}, std::vector<double>{0, 2},
                     Eigen::MatrixXd::Constant(1, 1, 25));
  for (const RangeFunction& part : parts) {
    const NurbsSurface wall = symbolic_product(part);
    const Written written = write(wall);
    EXPECT_TRUE(written.result.valid);
    EXPECT_FALSE(written.result.closed);
    EXPECT_EQ(written.result.faces, 1);
    EXPECT_EQ(written.step.all("ADVANCED_FACE").size(), 1u);
    EXPECT_EQ(written.step.all("OPEN_SHELL").size(), 1u);
    EXPECT_THAT(written.text, Not(HasSubstr("assumed")));
    const StepSurface read = wall_of(written.step);
    // Outward is away from the axis: a cylinder's face is reversed, a sphere's is not.
    EXPECT_THAT(written.text, HasSubstr(part.base().spherical() ? ",.T.);" : ",.F.);"));
    for (double u : {0.1, 0.5, 0.9})
      for (double v : {0.2, 0.7, 0.99}) {
        const double at_u = u * wall.knots_u.back(), at_v = v * wall.knots_v.back();
        EXPECT_LT((read.evaluate(at_u, at_v) - wall.evaluate(at_u, at_v)).norm(), 1e-9);
      }
  }
}

// A cylinder cut by z = 40 + x/2, and one with a scalloped rim: no disc closes the second.
TEST_F(Export, RimsThatAreNotPlane) {
  BaseSurface over;
  over.band_end = 1;
  const std::vector<double> knots = {0, 0, 0, 0.5, 1, 1, 1.5, 2, 2, 2.5, 3, 3, 3.5, 4, 4, 4};
  for (const bool scalloped : {false, true}) {
    Eigen::MatrixXd heights = Eigen::MatrixXd::Constant(2, 13, 0);
    for (int j = 0; j < 13; ++j) heights(1, j) = 40 + (scalloped ? 4 * std::cos(std::numbers::pi * (j % 12)) : 0.0);
    BaseSurface base;
    base.band_end = 1;
    base.heights = std::make_shared<const RangeFunction>(over, 1, 2, std::vector<double>{0, 0, 1, 1}, knots, heights);
    const NurbsSurface wall =
        symbolic_product(RangeFunction(base, 0, 0, {0, 1}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 20)));
    const Written written = write(wall);
    EXPECT_TRUE(written.result.valid);
    EXPECT_EQ(written.result.faces, 3);
    EXPECT_THAT(written.text, HasSubstr("top (assumed)"));
    double mean = 0;
    for (int k = 0; k < 3600; ++k) mean += base.z_mm(2 * std::numbers::pi * k / 3600, 1) / 3600;
    // A fan from the middle of the control points: their mean height weighs a third.
    const double apex = heights.row(1).head(12).mean(), height = (2 * mean + apex) / 3;
    EXPECT_NEAR(written.result.volume_mm3 / (400 * std::numbers::pi * height), 1, 2e-3);
  }
}

// A dome of radius R whose rim lies at a height.
NurbsSurface dome(double R, double height_mm, bool above) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_start = above ? 0 : 1;
  base.band_end = above ? 1 : 2;
  base.X_WB.translation().z() = height_mm;
  return symbolic_product(
      RangeFunction(base, 0, 0, {base.band_start, base.band_end}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, R)));
}

// One shell: every edge is used twice, once in either sense.
void expect_closed_shell(const StepFile& step) {
  const auto& shell = step.at(step.only("CLOSED_SHELL")).records.front().arguments.at(1).list();
  std::map<int, std::multiset<bool>> uses;
  for (const auto& face : shell)
    for (const auto& bound_reference : step.at(face.id()).record("ADVANCED_FACE").arguments.at(1).list()) {
      const auto& bound = step.at(bound_reference.id()).records.front().arguments;
      for (const auto& used : step.at(bound.at(1).id()).record("EDGE_LOOP").arguments.at(1).list()) {
        const auto& oriented = step.at(used.id()).record("ORIENTED_EDGE").arguments;
        uses[oriented.at(3).id()].insert(oriented.at(4).boolean() == bound.at(2).boolean());
      }
    }
  for (const auto& [edge, senses] : uses) EXPECT_EQ(senses, (std::multiset<bool>{false, true})) << "edge #" << edge;
}

// Walls that share their rims are one shell.
TEST_F(Export, BodiesOfSeveralWalls) {
  const double R = 25, height = 80, ball = 4.0 / 3 * std::numbers::pi * R * R * R;
  const NurbsSurface wall = testing::cylinder(R, height).surface();
  const std::vector<NurbsSurface> bullet = {wall, dome(R, height, true)},
                                  capsule = {dome(R, 0, false), wall, dome(R, height, true)};
  const Written one = write(bullet), two = write(capsule);
  EXPECT_EQ(one.result.faces, 3);
  EXPECT_EQ(two.result.faces, 3);
  EXPECT_TRUE(one.result.valid && two.result.valid);
  EXPECT_NEAR(one.result.volume_mm3 / (std::numbers::pi * R * R * height + ball / 2), 1, 2e-9);
  EXPECT_NEAR(two.result.volume_mm3 / (std::numbers::pi * R * R * height + ball), 1, 2e-9);
  EXPECT_THAT(one.text, HasSubstr("'bottom (assumed)'"));
  EXPECT_THAT(two.text, Not(HasSubstr("assumed")));
  for (const Written* written : {&one, &two}) {
    EXPECT_THAT(written->text, HasSubstr("'body'"));
    EXPECT_THAT(written->text, HasSubstr("'head'"));
    expect_closed_shell(written->step);
  }
  EXPECT_THAT(refusal(std::vector<NurbsSurface>{wall, dome(R + 0.01, height, true)}), HasSubstr("do not meet"));
  EXPECT_THAT(refusal(std::vector<NurbsSurface>{wall, dome(R, height + 0.01, true)}), HasSubstr("do not meet"));
}

NurbsSurface raised(NurbsSurface wall, double height_mm) {
  for (Eigen::Index i = 0; i < wall.control_points.cols(); ++i)
    wall.control_points(2, i) += height_mm * wall.control_points(3, i);
  return wall;
}

// A shaft of three diameters under a dome, and a lobed wall on a wide foot: rings that look up and down.
TEST_F(Export, ShouldersBetweenWallsArePlaneRings) {
  const std::vector<NurbsSurface> shaft = {testing::cylinder(15, 20).surface(),
                                           raised(testing::cylinder(25, 30).surface(), 20),
                                           raised(testing::cylinder(10, 40).surface(), 50), dome(10, 90, true)};
  const Written written = write(shaft);
  EXPECT_TRUE(written.result.valid);
  EXPECT_EQ(written.result.faces, 7);  // three walls, a head, two rings, a disc
  const double pi = std::numbers::pi;
  EXPECT_NEAR(written.result.volume_mm3 / (pi * (225 * 20 + 625 * 30 + 100 * 40) + 2.0 / 3 * pi * 1000), 1, 2e-9);
  expect_closed_shell(written.step);
  EXPECT_THAT(written.text, HasSubstr("'shoulder'"));
  EXPECT_THAT(written.text, HasSubstr("'bottom (assumed)'"));
  EXPECT_THAT(written.text, Not(HasSubstr("top (assumed)")));
  EXPECT_EQ(written.step.all("PLANE").size(), 3u);

  const ClosedWall lobed = testing::lobed(3, 6, 3, 50);
  const Written on_foot =
      write(std::vector<NurbsSurface>{testing::cylinder(90, 10).surface(), raised(lobed.surface(), 10)});
  EXPECT_TRUE(on_foot.result.valid);
  EXPECT_EQ(on_foot.result.faces, 5);
  EXPECT_NEAR(on_foot.result.volume_mm3 / (pi * 8100 * 10 + lobed.volume_mm3()), 1, 2e-9);
  expect_closed_shell(on_foot.step);

  const NurbsSurface foot = testing::cylinder(20, 10).surface(), wall = testing::cylinder(10, 40).surface();
  EXPECT_THAT(refusal(std::vector<NurbsSurface>{foot, raised(wall, 10.01)}), HasSubstr("mm off one plane"));
  // A circle through the middle of a lobed rim crosses it.
  double least = 1e9, most = 0;
  for (int j = 0; j < 400; ++j) {
    least = std::min(least, lobed.range_mm(1, j / 100.0));
    most = std::max(most, lobed.range_mm(1, j / 100.0));
  }
  EXPECT_GT(most - least, 1);
  EXPECT_THAT(refusal(std::vector<NurbsSurface>{lobed.surface(),
                                                raised(testing::cylinder((least + most) / 2, 40).surface(), 50)}),
              HasSubstr("finds the solid invalid"));
}

}  // namespace
}  // namespace celadon
