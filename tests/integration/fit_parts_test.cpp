// `celadon fit` on what is not one closed smooth wall between plane rims: parts of the turn and of the height, steps,
// rims that are not plane.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <string>

#include "tests/daemon/triangle_reader.h"
#include "tests/integration/process.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

// No smooth wall follows a shoulder: it is told, and what lies below it is fitted by itself.
TEST(FitParts, StepsAreTold) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> normal(0, 0.02);
  std::string samples = "r,theta,z\n";
  for (int k = 0; k < 60000; ++k) {
    const double t = 2 * std::numbers::pi * share(random), z = 80 * share(random);
    const bool shoulder = k % 12 == 0;
    char line[128];
    std::snprintf(line, sizeof line, "%.9g,%.9g,%.9g\n",
                  shoulder ? 20 + 10 * share(random) : (z < 40 ? 20 : 30) + normal(random), t,
                  shoulder ? 40 + normal(random) : z);
    samples += line;
  }
  const TemporaryFolder folder;
  const std::string file = folder.write("shaft.csv", samples);
  const auto whole = run({"celadon", "fit", file, "-o", folder / "w.step", "--report", folder / "w.json"});
  ASSERT_EQ(whole.exit_code, 0) << whole.err;
  EXPECT_NE(whole.out.find("The wall steps by "), std::string::npos) << whole.out;
  EXPECT_NE(whole.out.find("--shape auto makes walls with plane shoulders"), std::string::npos) << whole.out;
  const json report = json::parse(read_file(folder / "w.json"));
  ASSERT_EQ(report["steps"].size(), 1u);
  EXPECT_NEAR(report["steps"][0]["height_mm"].get<double>(), 40, 0.2);
  const auto below =
      run({"celadon", "fit", file, "--heights", "0", "39.8", "-o", folder / "b.step", "--report", folder / "b.json"});
  ASSERT_EQ(below.exit_code, 0) << below.err;
  const json part = json::parse(read_file(folder / "b.json"));
  EXPECT_EQ(part["model"], "cylinder") << part["decided_by"];
  EXPECT_FALSE(part.contains("steps"));
  EXPECT_NEAR(part["size_mm"][0].get<double>(), 40, 0.01);
  EXPECT_EQ(run({"celadon", "fit", file, "--heights", "30", "20", "-o", folder / "x.step"}).exit_code, 2);
}

// A shaft that lies somewhere in the file, with its end faces and shoulders: one body of three cylinders.
TEST(FitParts, AShaftWithShouldersIsOneBody) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> normal(0, 0.01);
  const double ends[] = {0, 25, 70, 100}, radii[] = {15, 25, 10};
  std::string cloud;
  for (int k = 0; k < 90000; ++k) {
    const double t = 2 * std::numbers::pi * share(random);
    double r, z;
    if (k % 6 == 0) {  // a plane across the axis
      const int face = k / 6 % 4;
      const double from = face == 0 ? 0 : radii[face - 1], to = face == 3 ? 0 : radii[face];
      r = std::sqrt(from * from + (to * to - from * from) * share(random));
      z = ends[face] + normal(random);
    } else {
      z = 100 * share(random);
      r = radii[z < 25 ? 0 : z < 70 ? 1 : 2] + normal(random);
    }
    char line[128];
    std::snprintf(line, sizeof line, "%.9g %.9g %.9g\n", z - 40, r * std::cos(t) + 7, r * std::sin(t));
    cloud += line;
  }
  const TemporaryFolder folder;
  const std::string file = folder.write("shaft.xyz", cloud);
  const auto outcome =
      run({"celadon", "fit", file, "--shape", "auto", "--form-tolerance", "0.002", "-o", folder / "s.step",
           folder / "s.stl", folder / "s.json", folder / "s.svg", "--report", folder / "s.report.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("  shoulder    z "), std::string::npos) << outcome.out;
  const json report = json::parse(read_file(folder / "s.report.json"));
  ASSERT_EQ(report["pieces"].size(), 3u) << outcome.out;
  ASSERT_EQ(report["shoulders"].size(), 2u);
  const double jump = std::abs(report["shoulders"][0]["jump_mm"].get<double>());
  EXPECT_NEAR(std::min(jump, 25 - jump), 10, 0.01);  // or 15: the file does not say which end is up
  for (const auto& piece : report["pieces"]) EXPECT_EQ(piece["model"], "cylinder") << piece["decided_by"];
  EXPECT_EQ(report["solid"]["faces"], 7);
  EXPECT_TRUE(report["solid"]["valid"].get<bool>());
  EXPECT_NEAR(report["solid"]["volume_mm3"].get<double>() / (std::numbers::pi * (225.0 * 25 + 625 * 45 + 100 * 30)), 1,
              2e-4);
  const auto middle = run({"celadon", "evaluate", folder / "s.json", "--piece", "2", "--angles", "30", "--heights",
                           std::to_string((report["shoulders"][0]["height_mm"].get<double>() +
                                           report["shoulders"][1]["height_mm"].get<double>()) /
                                          2)});
  ASSERT_EQ(middle.exit_code, 0) << middle.err;
  const auto named =
      run({"celadon", "fit", file, "--shape", "composite", "--shoulders", "30", "20", "-o", folder / "x.step"});
  EXPECT_EQ(named.exit_code, 2);
  EXPECT_NE(named.err.find("put them in order"), std::string::npos) << named.err;
  EXPECT_EQ(run({"celadon", "fit", file, "--shoulders", "30", "-o", folder / "x.step"}).exit_code, 2);
}

// A hundred degrees of a tube that lies somewhere, and of one in the scanner's frame.
TEST(FitParts, APartOfTheTurn) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> normal(0, 0.02);
  std::string cloud, native = "r,theta,z\n";
  for (int k = 0; k < 30000; ++k) {
    const double t = 5.5 + 1.75 * share(random), z = 50 * share(random), r = 30 + normal(random);
    char line[128];
    std::snprintf(line, sizeof line, "%.9g %.9g %.9g\n", r * std::cos(t) + 10, z, r * std::sin(t));
    cloud += line;
    std::snprintf(line, sizeof line, "%.9g,%.9g,%.9g\n", r + 2 * std::cos(3 * t), t, z);
    native += line;
  }
  const TemporaryFolder folder;
  const std::string anywhere = folder.write("tube.xyz", cloud), here = folder.write("part.csv", native);
  const auto refused = run({"celadon", "fit", here, "-o", folder / "x.step"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_NE(refused.err.find("A part of the turn alone is fitted with --angles auto"), std::string::npos)
      << refused.err;
  auto outcome = run({"celadon", "fit", anywhere, "--angles", "auto", "-o", folder / "t.step", folder / "t.stl",
                      folder / "t.json", folder / "t.svg", "--report", folder / "t.report.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("shell       valid, 1 face"), std::string::npos) << outcome.out;
  json report = json::parse(read_file(folder / "t.report.json"));
  EXPECT_EQ(report["model"], "cylinder") << report["decided_by"];
  EXPECT_FALSE(report.contains("solid"));
  EXPECT_NEAR(report["angles_rad"][1].get<double>() - report["angles_rad"][0].get<double>(), 1.75, 0.01);
  outcome = run({"celadon", "fit", here, "--angles", "320", "400", "-o", folder / "n.step", folder / "n.json",
                 "--report", folder / "n.report.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  report = json::parse(read_file(folder / "n.report.json"));
  EXPECT_EQ(report["model"], "translational");
  EXPECT_NEAR(report["geometric_mm"]["rms"].get<double>(), 0.02, 0.001);
  const auto outside = run({"celadon", "evaluate", folder / "n.json", "--angles", "90"});
  EXPECT_EQ(outside.exit_code, 2);
  EXPECT_NE(outside.err.find("angle 90 degrees is outside"), std::string::npos) << outside.err;
  EXPECT_EQ(run({"celadon", "evaluate", folder / "n.json", "--angles", "330,30"}).exit_code, 0);
  for (const char* wrong : {"5", "abc"}) {
    const auto bad = run({"celadon", "fit", here, "--angles", wrong, "-o", folder / "b.step"});
    EXPECT_EQ(bad.exit_code, 2) << wrong;
  }
}

// A tube that was cut slantwise below a scalloped rim.
TEST(FitParts, RimsAreFollowed) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> normal(0, 0.02);
  const auto lower = [](double t) { return 6 * std::cos(t); };
  const auto upper = [](double t) { return 60 + 3 * std::cos(4 * t); };
  std::string samples = "r,theta,z\n";
  for (int k = 0; k < 60000; ++k) {
    const double t = 2 * std::numbers::pi * share(random), z = lower(t) + (upper(t) - lower(t)) * share(random);
    char line[128];
    std::snprintf(line, sizeof line, "%.9g,%.9g,%.9g\n", 25 + normal(random), t, z);
    samples += line;
  }
  const TemporaryFolder folder;
  const std::string file = folder.write("tube.csv", samples);
  const auto plane = run({"celadon", "fit", file, "-o", folder / "p.step"});
  ASSERT_EQ(plane.exit_code, 0) << plane.err;
  EXPECT_NE(plane.out.find("--rims follow keeps what was cut"), std::string::npos) << plane.out;
  const auto outcome = run({"celadon", "fit", file, "--rims", "follow", "-o", folder / "t.step", folder / "t.stl",
                            folder / "t.json", "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(folder / "r.json"));
  EXPECT_EQ(report["model"], "cylinder") << report["decided_by"];
  EXPECT_EQ(report["degree"][0], 1);
  EXPECT_TRUE(report["solid"]["valid"].get<bool>());
  EXPECT_NEAR(report["rims_mm"]["lower"][0].get<double>(), -6, 1.2);
  EXPECT_NEAR(report["rims_mm"]["lower"][1].get<double>(), 6, 1.2);
  EXPECT_NEAR(report["rims_mm"]["upper"][0].get<double>(), 57, 1.2);
  EXPECT_NEAR(report["rims_mm"]["upper"][1].get<double>(), 63, 1.2);
  EXPECT_NEAR(report["solid"]["volume_mm3"].get<double>() / (625 * std::numbers::pi * 60), 1, 0.04);
  const auto inside = run({"celadon", "evaluate", folder / "t.json", "--angles", "180", "--heights", "0,30"});
  ASSERT_EQ(inside.exit_code, 0) << inside.err;
  EXPECT_NE(inside.out.find("180,30,2"), std::string::npos) << inside.out;
  const auto outside = run({"celadon", "evaluate", folder / "t.json", "--angles", "0", "--heights", "0"});
  EXPECT_EQ(outside.exit_code, 2);
  EXPECT_NE(outside.err.find("height 0 mm is outside the surface's band"), std::string::npos) << outside.err;
  const auto both = run({"celadon", "fit", file, "--rims", "follow", "--shape", "sphere", "-o", folder / "s.step"});
  EXPECT_EQ(both.exit_code, 2);
}

// A general body about an axis of its own is fitted twice: what is said of the rims is said once.
TEST(FitParts, NotesAreNotRepeated) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> normal(0, 0.02);
  std::string cloud;
  for (int k = 0; k < 40000; ++k) {
    const double t = 2 * std::numbers::pi * share(random), z = 40 + 20 * std::cos(t) * 0.2 * share(random);
    const double r = 30 + 0.1 * std::cos(2 * t) + std::sin(z / 10) + normal(random),
                 up = (z + 5 * std::cos(t)) * share(random);
    char line[128];
    std::snprintf(line, sizeof line, "%.9g %.9g %.9g\n", r * std::cos(t) + 50, up, r * std::sin(t));
    cloud += line;
  }
  const TemporaryFolder folder;
  const auto outcome =
      run({"celadon", "fit", folder.write("c.xyz", cloud), "--rims", "follow", "-o", folder / "c.step"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const std::string said = "The rims follow the ends";
  const auto first = outcome.out.find(said);
  ASSERT_NE(first, std::string::npos) << outcome.out;
  EXPECT_EQ(outcome.out.find(said, first + 1), std::string::npos) << outcome.out;
}

// 57 degrees of a ball, from 29 to 115 degrees below its pole: a sheet with the area of the closed form, a shell of one
// face.
TEST(FitParts, APartOfASphere) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> share(0, 1);
  std::string native = "rho,phi,theta\n";
  for (int k = 0; k < 20000; ++k) {
    char line[128];
    std::snprintf(line, sizeof line, "25,%.9g,%.9g\n", 0.5 + 1.5 * share(random), 1 + share(random));
    native += line;
  }
  const TemporaryFolder folder;
  const std::string file = folder.write("ball.csv", native);
  const auto shell = run({"celadon", "fit", file, "--shape", "sphere", "--angles", "auto", "-o", folder / "b.step",
                          folder / "b.stl", folder / "b.ply"});
  ASSERT_EQ(shell.exit_code, 0) << shell.err;
  EXPECT_NE(shell.out.find("shell       valid"), std::string::npos) << shell.out;
  const Triangles stl = read_stl(read_file(folder / "b.stl")), ply = read_ply_triangles(read_file(folder / "b.ply"));
  EXPECT_EQ(stl.faces.size(), ply.faces.size());
  EXPECT_EQ(stl.euler_characteristic(), 1);
  double area = 0;
  for (const auto& face : ply.faces) {
    const Eigen::Vector3d a = ply.vertices[face[0]], b = ply.vertices[face[1]], c = ply.vertices[face[2]];
    area += (b - a).cross(c - a).norm() / 2;
  }
  EXPECT_NEAR(area / (25 * 25 * (std::cos(0.5) - std::cos(2.0))), 1, 0.01);
}

}  // namespace
}  // namespace celadon::testing
