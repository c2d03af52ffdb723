// STEP files read back by a reader of our own, against closed forms.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <numbers>
#include <set>

#include "daemon/export/cad_client.h"
#include "daemon/export/cad_protocol.h"
#include "fitting/range_function.h"
#include "tests/daemon/closed_wall.h"
#include "tests/daemon/export_fixture.h"
#include "tests/daemon/step_reader.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::ClosedWall;
using testing::Export;
using ::testing::HasSubstr;
using ::testing::Not;
using testing::StepCurve;
using testing::StepFile;
using testing::StepSurface;
using testing::wall_of;
using testing::Written;

/// Largest distance between the surface in the file and the closed form.
double deviation_mm(const StepSurface& surface, const ClosedWall& truth) {
  double worst = 0;
  for (int i = 0; i <= 24; ++i) {
    for (int j = 0; j <= 96; ++j) {
      const double u = i / 24.0;
      const double v = j / 24.0;
      worst = std::max(worst, (surface.evaluate(u, v) - truth.point(u, v)).norm());
    }
  }
  return worst;
}

struct Degrees {
  int u, v;
};

class ExportDegrees : public Export, public ::testing::WithParamInterface<Degrees> {};

TEST_P(ExportDegrees, FileHoldsTheExactSurface) {
  const auto [p, q] = GetParam();
  const ClosedWall truth =
      q == 0 ? testing::revolution(p, {30, 41, 35, 28, 33, 39}, 120) : testing::lobed(p, 9, q, 120);
  const NurbsSurface wall = truth.surface();
  const Written written = write(wall);
  const StepSurface surface = wall_of(written.step);
  EXPECT_EQ(surface.degree_u, p);
  EXPECT_EQ(surface.degree_v, q + 2);
  EXPECT_EQ(surface.knots_u, wall.knots_u);
  EXPECT_EQ(surface.knots_v, wall.knots_v);
  ASSERT_EQ(surface.points.size(), static_cast<std::size_t>(wall.control_points.cols()));
  for (std::size_t i = 0; i < surface.points.size(); ++i) {
    const Eigen::Vector4d point = wall.control_points.col(static_cast<Eigen::Index>(i));
    // Bit for bit: the file loses nothing but the division by the weight.
    EXPECT_EQ(surface.points[i].x(), point.x() / point.w());
    EXPECT_EQ(surface.points[i].y(), point.y() / point.w());
    EXPECT_EQ(surface.points[i].z(), point.z() / point.w());
    EXPECT_EQ(surface.points[i].w(), point.w());
  }
  EXPECT_LT(deviation_mm(surface, truth), 1e-12 * 300);
  EXPECT_TRUE(written.result.valid);
  EXPECT_EQ(written.result.faces, 3);
  EXPECT_NEAR(written.result.volume_mm3 / truth.volume_mm3(), 1, 1e-9);
}

INSTANTIATE_TEST_SUITE_P(All, ExportDegrees,
                         ::testing::Values(Degrees{1, 0}, Degrees{2, 0}, Degrees{3, 0}, Degrees{5, 0}, Degrees{1, 1},
                                           Degrees{1, 3}, Degrees{3, 1}, Degrees{3, 3}, Degrees{2, 2}, Degrees{5, 5}),
                         [](const auto& tested) {
                           return "p" + std::to_string(tested.param.u) + "q" + std::to_string(tested.param.v);
                         });

TEST_F(Export, CylinderHasTheVolumeOfItsFormula) {
  const Written written = write(testing::cylinder(25, 80).surface());
  EXPECT_NEAR(written.result.volume_mm3 / (std::numbers::pi * 25 * 25 * 80), 1, 1e-9);
  for (int i = 0; i <= 400; ++i) {
    EXPECT_NEAR(wall_of(written.step).evaluate(0.37, i / 100.0).head<2>().norm(), 25, 1e-12);
  }
}

TEST_F(Export, ConeFrustumHasTheVolumeOfItsFormula) {
  const Written written = write(testing::revolution(1, {30, 12}, 50).surface());
  EXPECT_NEAR(written.result.volume_mm3 / (std::numbers::pi * 50 / 3 * (30 * 30 + 30 * 12 + 12 * 12)), 1, 1e-9);
}

TEST_F(Export, PlacedAnywhereInSpace) {
  // Turned about an oblique axis and moved: the discs follow.
  const ClosedWall truth = testing::lobed(3, 6, 3, 70);
  NurbsSurface wall = truth.surface();
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, -0.5).normalized()).toRotationMatrix();
  const Eigen::Vector3d move(120, -35, 410);
  for (Eigen::Index i = 0; i < wall.control_points.cols(); ++i) {
    const Eigen::Vector4d p = wall.control_points.col(i);
    wall.control_points.col(i).head<3>() = turn * p.head<3>() + move * p.w();
  }
  const Written written = write(wall);
  EXPECT_NEAR(written.result.volume_mm3 / truth.volume_mm3(), 1, 1e-9);
  const StepSurface surface = wall_of(written.step);
  EXPECT_LT((surface.evaluate(0.3, 1.7) - (turn * truth.point(0.3, 1.7) + move)).norm(), 1e-9);
}

/// Directed uses of edges and the ends of each edge, from the file alone.
TEST_F(Export, ShellIsClosedAndOrientedOutward) {
  const ClosedWall truth = testing::lobed(3, 7, 3, 90);
  const StepFile step = write(truth.surface()).step;
  const auto& shell = step.at(step.only("CLOSED_SHELL")).records.front().arguments.at(1).list();
  ASSERT_EQ(shell.size(), 3U);
  std::map<int, std::multiset<bool>> uses;
  for (const auto& face_reference : shell) {
    const auto& face = step.at(face_reference.id()).record("ADVANCED_FACE").arguments;
    const bool same_sense = face.at(3).boolean();
    for (const auto& bound_reference : face.at(1).list()) {
      const auto& bound = step.at(bound_reference.id()).records.front().arguments;
      const bool bound_sense = bound.at(2).boolean();
      for (const auto& oriented_reference : step.at(bound.at(1).id()).record("EDGE_LOOP").arguments.at(1).list()) {
        const auto& oriented = step.at(oriented_reference.id()).record("ORIENTED_EDGE").arguments;
        uses[oriented.at(3).id()].insert(oriented.at(4).boolean() == bound_sense);
      }
    }
    const int geometry = face.at(2).id();
    if (step.at(geometry).is("PLANE")) {
      const auto& axes = step.at(step.at(geometry).record("PLANE").arguments.at(1).id()).records.front().arguments;
      const double z = step.triple(axes.at(1).id()).z();
      const double height = step.triple(axes.at(2).id()).z() * (same_sense ? 1 : -1);
      EXPECT_TRUE(z == 0 || z == 90) << z;
      EXPECT_NEAR(height, z == 0 ? -1 : 1, 1e-15);
      EXPECT_EQ(face.at(0).string(), z == 0 ? "bottom (assumed)" : "top (assumed)");
    } else {
      // S_u x S_v points inward, so the face turns it round.
      EXPECT_FALSE(same_sense);
      EXPECT_EQ(face.at(0).string(), "wall");
    }
  }
  ASSERT_EQ(uses.size(), 3U);
  std::set<int> vertices;
  for (const auto& [edge, senses] : uses) {
    EXPECT_EQ(senses, (std::multiset<bool>{false, true})) << "edge #" << edge;
    const auto& curve = step.at(edge).record("EDGE_CURVE").arguments;
    vertices.insert(curve.at(1).id());
    vertices.insert(curve.at(2).id());
  }
  const int euler = static_cast<int>(vertices.size()) - static_cast<int>(uses.size()) + static_cast<int>(shell.size());
  EXPECT_EQ(euler, 2);
}

TEST_F(Export, EdgesAreTheExactBoundaryCurves) {
  const ClosedWall truth = testing::lobed(3, 7, 3, 90);
  const StepFile step = write(truth.surface()).step;
  int rims = 0;
  int seams = 0;
  for (const int id : step.all("EDGE_CURVE")) {
    const auto& edge = step.at(id).record("EDGE_CURVE").arguments;
    const auto& geometry = step.at(edge.at(3).id());
    const StepCurve curve = StepCurve::of(step, geometry.records.front().arguments.at(1).id());
    const bool seam = geometry.is("SEAM_CURVE");
    const double u = std::abs(curve.evaluate(0).z()) < 1 ? 0 : 1;
    for (int i = 0; i <= 100; ++i) {
      const double t = i / 100.0;
      const Eigen::Vector3d expected = seam ? truth.point(t, 0) : truth.point(u, 4 * t);
      EXPECT_LT((curve.evaluate(seam ? t : 4 * t) - expected).norm(), 1e-11);
    }
    (seam ? seams : rims) += 1;
  }
  EXPECT_EQ(seams, 1);
  EXPECT_EQ(rims, 2);
}

TEST_F(Export, UnitsNamesColoursAndHeader) {
  CadOptions options;
  options.name = "Vase d'\xC3\x89tude \xF0\x9F\x8F\xBA \\1";
  options.simulated = true;
  options.date = "2026-03-04T05:06:07Z";
  const StepFile step = write(testing::cylinder(20, 30).surface(), options).step;

  const auto& name = step.header.at("FILE_NAME").arguments;
  EXPECT_EQ(name.at(0).string(), options.name);
  EXPECT_EQ(name.at(1).string(), options.date);
  EXPECT_THAT(step.header.at("FILE_DESCRIPTION").arguments.at(0).list().at(0).string(), HasSubstr("simulated"));
  EXPECT_THAT(step.header.at("FILE_SCHEMA").arguments.at(0).list().at(0).string(), HasSubstr("AP242"));

  const auto& product = step.at(step.only("PRODUCT")).records.front().arguments;
  EXPECT_EQ(product.at(0).string(), options.name);
  EXPECT_EQ(product.at(1).string(), options.name);
  EXPECT_EQ(product.at(2).string(), "simulated scan");

  int lengths = 0;
  for (const int id : step.all("LENGTH_UNIT")) {
    const auto& unit = step.at(id).record("SI_UNIT").arguments;
    EXPECT_EQ(unit.at(0).text, "MILLI");
    EXPECT_EQ(unit.at(1).text, "METRE");
    ++lengths;
  }
  EXPECT_GE(lengths, 1);

  // STYLED_ITEM -> PRESENTATION_STYLE_ASSIGNMENT -> SURFACE_STYLE_USAGE -> ... -> COLOUR_RGB.
  std::map<std::string, Eigen::Vector3d> colours;
  for (const int id : step.all("STYLED_ITEM")) {
    const auto& item = step.at(id).records.front().arguments;
    const auto& face = step.at(item.at(2).id()).record("ADVANCED_FACE").arguments;
    const std::function<const std::vector<testing::StepValue>*(int)> colour_below =
        [&](int from) -> const std::vector<testing::StepValue>* {
      const auto& record = step.at(from).records.front();
      if (record.type == "COLOUR_RGB") {
        return &record.arguments;
      }
      std::vector<testing::StepValue> pending = record.arguments;
      while (!pending.empty()) {
        const testing::StepValue value = pending.back();
        pending.pop_back();
        if (value.kind == testing::StepValue::Kind::reference) {
          if (const auto* found = colour_below(value.id())) {
            return found;
          }
        }
        pending.insert(pending.end(), value.items.begin(), value.items.end());
      }
      return nullptr;
    };
    const auto* colour = colour_below(item.at(1).list().at(0).id());
    ASSERT_NE(colour, nullptr);
    colours[face.at(0).string()] = {colour->at(1).real(), colour->at(2).real(), colour->at(3).real()};
  }
  ASSERT_EQ(colours.size(), 3U);
  EXPECT_LT((colours.at("bottom (assumed)") - colours.at("top (assumed)")).norm(), 1e-12);
  EXPECT_GT((colours.at("bottom (assumed)") - colours.at("wall")).norm(), 0.3);
  EXPECT_LT((colours.at("wall") - Eigen::Vector3d(0.66, 0.80, 0.72)).norm(), 1e-6);
}

TEST_F(Export, OfRealObjectsDoesNotSaySimulated) {
  EXPECT_THAT(write(testing::cylinder(20, 30).surface()).text, Not(HasSubstr("simulated")));
}

TEST_F(Export, Ap214ByOption) {
  CadOptions options;
  options.ap214 = true;
  const StepFile step = write(testing::lobed(3, 5, 3, 40).surface(), options).step;
  EXPECT_THAT(step.header.at("FILE_SCHEMA").arguments.at(0).list().at(0).string(), HasSubstr("AUTOMOTIVE_DESIGN"));
  const auto& protocol = step.at(step.only("APPLICATION_PROTOCOL_DEFINITION")).records.front().arguments;
  EXPECT_EQ(protocol.at(1).string(), "automotive_design");
  EXPECT_LT(deviation_mm(wall_of(step), testing::lobed(3, 5, 3, 40)), 1e-10);
}

TEST_F(Export, SameInputGivesTheSameBytes) {
  CadOptions options;
  options.date = "2026-03-04T05:06:07Z";
  const NurbsSurface wall = testing::lobed(3, 6, 3, 60).surface();
  const std::string first = write(wall, options).text;
  EXPECT_EQ(first, write(wall, options).text);
  auto worker = CadWorker::start();
  ASSERT_TRUE(worker) << worker.error();
  ASSERT_TRUE(worker->write_step(single(wall), scratch_.path() / "warm.step", options));
  EXPECT_EQ(first, testing::read_file(scratch_.path() / "warm.step"));
}

TEST_F(Export, WorkerServesAgainAndSurvivesTheEndOfItsProcess) {
  auto worker = CadWorker::start();
  ASSERT_TRUE(worker) << worker.error();
  ASSERT_GT(worker->pid(), 0);
  ASSERT_EQ(::kill(worker->pid(), SIGKILL), 0);
  const NurbsSurface wall = testing::cylinder(10, 20).surface();
  // The killed process may still look alive to the first call: then its end is reported, and the second call succeeds.
  auto result = worker->write_step(single(wall), scratch_.path() / "a.step", {});
  if (!result) {
    EXPECT_THAT(result.error(), HasSubstr("signal 9"));
    result = worker->write_step(single(wall), scratch_.path() / "a.step", {});
  }
  ASSERT_TRUE(result) << result.error();
  const auto again = worker->write_step(single(wall), scratch_.path() / "b.step", {});
  ASSERT_TRUE(again) << again.error();
  EXPECT_EQ(testing::read_file(scratch_.path() / "a.step"), testing::read_file(scratch_.path() / "b.step"));
}

TEST_F(Export, RefusesWallsThatMakeNoSolid) {
  const NurbsSurface good = testing::lobed(3, 6, 3, 60).surface();

  NurbsSurface wall = good;
  wall.closed_v = false;
  const NurbsSurface open_and_closed[] = {wall, good};
  EXPECT_THAT(refusal(open_and_closed), HasSubstr("open around the axis"));

  wall = good;
  wall.control_points.col(wall.count_v() - 1).x() += 0.01;
  EXPECT_THAT(refusal(wall), HasSubstr("does not close: its row 0"));

  wall = good;
  wall.control_points(0, 40) = std::nan("");
  EXPECT_THAT(refusal(wall), HasSubstr("control point 40 is not finite"));

  wall = good;
  wall.control_points(3, 40) = -1;
  EXPECT_THAT(refusal(wall), HasSubstr("weight is not positive"));

  wall = good;
  wall.knots_u[3] = 0.1;
  EXPECT_THAT(refusal(wall), HasSubstr("multiplicity"));

  wall = good;
  wall.control_points.row(2).setZero();
  EXPECT_THAT(refusal(wall), HasSubstr("encloses no volume"));
}

// Upside down in u, S_u x S_v points outward: the same body.
TEST_F(Export, TakesWallsOfEitherOrientation) {
  NurbsSurface wall = testing::lobed(3, 6, 3, 60).surface();
  const CadResult upright = write(wall).result;
  wall.control_points.row(2) *= -1;
  const CadResult reversed = write(wall).result;
  EXPECT_NEAR(upright.volume_mm3, reversed.volume_mm3, 1e-9 * upright.volume_mm3);
  EXPECT_EQ(reversed.faces, 3);
}

// An end that runs together in a point is a pole: no disc.
TEST_F(Export, AnEndInAPointIsAPole) {
  const CadResult cone = write(testing::revolution(1, {0, 20}, 50).surface()).result;
  EXPECT_NEAR(cone.volume_mm3, std::numbers::pi * 400 * 50 / 3, 1e-6);
  EXPECT_EQ(cone.faces, 2);
}

// All of a body over a sphere is one face; over an open hole it has a fan that is named as assumed.
TEST_F(Export, BodiesOverASphere) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_end = 2;
  const RangeFunction whole(base, 0, 0, {0, 2}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25));
  const Written sphere = write(symbolic_product(whole));
  EXPECT_NEAR(sphere.result.volume_mm3, 4.0 / 3 * std::numbers::pi * 25 * 25 * 25, 1e-4);
  EXPECT_EQ(sphere.result.faces, 1);
  EXPECT_THAT(sphere.text, Not(HasSubstr("assumed")));
  EXPECT_TRUE(sphere.result.valid);
  const StepSurface surface = wall_of(sphere.step);
  EXPECT_EQ(surface.degree_u, 2);
  EXPECT_EQ(surface.degree_v, 2);
  for (double u = 0; u <= 2; u += 0.1)
    for (double v = 0; v <= 4; v += 0.1) EXPECT_NEAR(surface.evaluate(u, v).norm(), 25, 1e-9);

  const CadResult plane = write(symbolic_product(whole.clipped(0.5, 2))).result;
  EXPECT_EQ(plane.faces, 2);
  const double height = 25 * (1 - std::cos(BaseSurface::meridian().theta_of_v(0.5)));  // of the cap that is missing
  EXPECT_NEAR(plane.volume_mm3, sphere.result.volume_mm3 - std::numbers::pi * height * height * (75 - height) / 3,
              1e-4);

  // Three lobes: the rim is not plane.
  Eigen::MatrixXd f = Eigen::MatrixXd::Constant(5, 9, 25);
  for (int j = 0; j < 9; ++j) f.col(j).array() += 2 * std::cos(2 * std::numbers::pi * 3 * (j % 8) / 8);
  for (int i : {0, 1, 2}) f.row(4 - i).setConstant(25);
  const RangeFunction lobed(base, 2, 2, {0, 0, 0, 0.5, 1, 2, 2, 2}, {0, 0, 0, 0.5, 1, 1.5, 2, 2.5, 3, 4, 4, 4}, f);
  const Written fan = write(symbolic_product(lobed.clipped(0.3, 2)));
  EXPECT_EQ(fan.result.faces, 2);
  EXPECT_TRUE(fan.result.valid);
  EXPECT_THAT(fan.text, HasSubstr("top (assumed)"));
  EXPECT_THAT(fan.text, HasSubstr("discs at the ends assumed"));
}

TEST_F(Export, NamesTheFolderItCannotWriteTo) {
  const auto result =
      write_step(single(testing::cylinder(10, 20).surface()), scratch_.path() / "missing" / "a.step", {});
  ASSERT_FALSE(result);
  EXPECT_THAT(result.error(), HasSubstr("missing/a.step: No such file or directory; check the name and the folder"));
}

TEST(CadProtocol, RequestsComeBackAsSent) {
  const NurbsSurface wall = testing::lobed(3, 6, 3, 60).surface();
  CadOptions options;
  options.ap214 = true;
  options.name = "a \"b\"\n\xC3\xA9";
  options.simulated = true;
  options.date = "2026";
  options.time_limit_s = 7;
  const auto back = parse_step_request(step_request(single(wall), options));
  ASSERT_TRUE(back) << back.error();
  EXPECT_EQ(back->walls.at(0).knots_u, wall.knots_u);
  EXPECT_EQ(back->walls.at(0).knots_v, wall.knots_v);
  EXPECT_EQ(back->walls.at(0).control_points, wall.control_points);
  EXPECT_EQ(back->options.name, options.name);
  EXPECT_EQ(back->options.time_limit_s, 7);
  EXPECT_TRUE(back->options.ap214);
}

TEST(CadProtocol, RefusesWhatDoesNotAgree) {
  EXPECT_FALSE(decode_first_line("CELADON-CAD 3 1 1"));
  EXPECT_FALSE(decode_first_line("CELADON-CAD 2 10"));
  EXPECT_FALSE(decode_first_line("CELADON-CAD 2 10 -1"));
  EXPECT_FALSE(decode_first_line("CELADON-CAD 2 10 18446744073709551615"));
  EXPECT_FALSE(decode_first_line("CELADON-CAD 2 10 1 "));
  EXPECT_TRUE(decode_first_line("CELADON-CAD 2 10 1"));
  CadMessage message = step_request(single(testing::cylinder(1, 1).surface()), {});
  message.payload.pop_back();
  EXPECT_THAT(parse_step_request(message).error(), HasSubstr("bytes in place of"));
  message.head["walls"][0]["degree"] = {1000000, 2};
  EXPECT_THAT(parse_step_request(message).error(), HasSubstr("degree"));
  message.head = nlohmann::json::parse("[1]");
  EXPECT_FALSE(parse_step_request(message));
}

}  // namespace
}  // namespace celadon
