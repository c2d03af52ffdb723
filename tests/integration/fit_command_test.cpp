// `celadon fit` and `celadon evaluate` as a user calls them: exact shapes come back exact, and every bad input gets one
// sentence, the right exit code and no file.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <sstream>

#include "tests/daemon/step_reader.h"
#include "tests/integration/process.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// Points r(theta, z) on scattered places, as text with 17 digits.
template <class Radius>
std::string cloud_of(Radius radius, int count, double noise_mm = 0) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> turn(0, 2 * std::numbers::pi), height(0, 80);
  std::normal_distribution<double> noise(0, 1);
  std::string text;
  char line[128];
  for (int k = 0; k < count; ++k) {
    const double t = turn(random), z = height(random), r = radius(t, z) + noise_mm * noise(random);
    std::snprintf(line, sizeof line, "%.17g %.17g %.17g\n", r * std::cos(t), r * std::sin(t), z);
    text += line;
  }
  return text;
}

// The only spline surface of a STEP file, in millimetres.
StepSurface wall_of(const fs::path& file) {
  const auto step = StepFile::parse(read_file(file));
  for (const char* type : {"B_SPLINE_SURFACE_WITH_KNOTS", "RATIONAL_B_SPLINE_SURFACE"}) {
    const auto found = step.all(type);
    if (found.size() == 1) return StepSurface::of(step, found[0]);
  }
  throw std::runtime_error("not one spline surface in " + file.string());
}

Eigen::Vector3d at_fraction(const StepSurface& wall, double u, double v) {
  const auto mix = [](const std::vector<double>& knots, double t) {
    return knots.front() + t * (knots.back() - knots.front());
  };
  return wall.evaluate(mix(wall.knots_u, u), mix(wall.knots_v, v));
}

TEST(FitCommand, CylinderComesBackExactFromTheStepFile) {
  const TemporaryFolder folder;
  const auto input = folder.write("cylinder.xyz", cloud_of([](double, double) { return 25.0; }, 20000));
  const auto outcome = run({"celadon", "fit", input, "-o", folder / "c.step", "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(folder / "r.json"));
  EXPECT_EQ(report["model"], "cylinder");
  EXPECT_EQ(report["degree"], json({1, 2}));
  EXPECT_EQ(report["simulated"], false);
  const StepSurface wall = wall_of(folder / "c.step");
  double worst = 0;
  for (int i = 0; i <= 20; ++i) {
    for (int j = 0; j <= 97; ++j) {
      const auto p = at_fraction(wall, i / 20.0, j / 97.0);
      worst = std::max(worst, std::abs(std::hypot(p[0], p[1]) - 25.0));
    }
  }
  EXPECT_LT(worst, 1e-9);
}

// A ball whose centre is off the origin, on the axis: one exact face of degree (2, 2).
TEST(FitCommand, SphereComesBackExactFromTheStepFile) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> turn(0, 2 * std::numbers::pi), height(-1, 1);
  std::string text;
  for (int k = 0; k < 20000; ++k) {
    const double t = turn(random), c = height(random), s = std::sqrt(1 - c * c);
    char line[128];
    std::snprintf(line, sizeof line, "%.17g %.17g %.17g\n", 25 * s * std::cos(t), 25 * s * std::sin(t), 40 + 25 * c);
    text += line;
  }
  const TemporaryFolder folder;
  const auto input = folder.write("ball.xyz", text);
  const auto outcome = run({"celadon", "fit", input, "--shape", "sphere", "-o", folder / "b.step", folder / "b.json",
                            "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(folder / "r.json"));
  EXPECT_EQ(report["base"], "sphere");
  EXPECT_EQ(report["model"], "sphere");
  EXPECT_EQ(report["degree"], json({2, 2}));
  EXPECT_EQ(report["solid"]["faces"], 1);
  EXPECT_NEAR(report["band_rad"][1], std::numbers::pi, 1e-15);
  EXPECT_NEAR(report["frame"]["origin"][2], 40, 1e-9);
  const StepSurface wall = wall_of(folder / "b.step");
  double worst = 0;
  for (int i = 0; i <= 40; ++i)
    for (int j = 0; j <= 97; ++j)
      worst =
          std::max(worst, std::abs((at_fraction(wall, i / 40.0, j / 97.0) - Eigen::Vector3d(0, 0, 40)).norm() - 25));
  EXPECT_LT(worst, 1e-9);

  const auto points = run({"celadon", "evaluate", folder / "b.json", "--polar", "0,90", "--angles", "30"});
  ASSERT_EQ(points.exit_code, 0) << points.err;
  EXPECT_TRUE(points.out.starts_with("angle_deg,polar_deg,rho_mm,"));
  EXPECT_EQ(run({"celadon", "evaluate", folder / "b.json", "--heights", "3"}).exit_code, 2);
  EXPECT_EQ(run({"celadon", "fit", input, "--centre-z", "3"}).exit_code, 2);
  EXPECT_EQ(run({"celadon", "fit", input, "--shape", "sphere", "--model", "cylinder"}).exit_code, 2);
}

TEST(FitCommand, RevolutionComesBackExactFromTheStepFile) {
  // A cubic in z lies in every space of degree 3.
  const auto radius = [](double, double z) { return 30 + 0.2 * z - 0.006 * z * z + 4e-5 * z * z * z; };
  const TemporaryFolder folder;
  const auto input = folder.write("revolution.xyz", cloud_of(radius, 20000));
  const auto outcome =
      run({"celadon", "fit", input, "-o", folder / "c.step", folder / "surface.json", "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(folder / "r.json"));
  EXPECT_EQ(report["model"], "revolution");
  EXPECT_EQ(report["degree"], json({3, 2}));
  const StepSurface wall = wall_of(folder / "c.step");
  double worst = 0;
  for (int i = 0; i <= 40; ++i) {
    for (int j = 0; j <= 97; ++j) {
      const auto p = at_fraction(wall, i / 40.0, j / 97.0);
      worst = std::max(worst, std::abs(std::hypot(p[0], p[1]) - radius(0, p[2])));
    }
  }
  EXPECT_LT(worst, 1e-9);

  // evaluate: the same radius, and the normal and curvatures of the closed form.
  const auto evaluated =
      run({"celadon", "evaluate", folder / "surface.json", "--angles", "0:45:315", "--heights", "20,40"});
  ASSERT_EQ(evaluated.exit_code, 0) << evaluated.err;
  std::istringstream lines(evaluated.out);
  std::string line;
  std::getline(lines, line);
  int rows = 0;
  for (; std::getline(lines, line); ++rows) {
    std::vector<double> v;
    std::istringstream cells(line);
    for (std::string cell; std::getline(cells, cell, ',');) v.push_back(std::stod(cell));
    ASSERT_EQ(v.size(), 12u);
    EXPECT_LT(v[11], 1e-6);  // no noise: what the sums resolve
    const double z = v[1], slope = 0.2 - 0.012 * z + 12e-5 * z * z, bend = -0.012 + 24e-5 * z;
    const double r = radius(0, z), metric = std::sqrt(1 + slope * slope);
    EXPECT_NEAR(v[2], r, 1e-9);
    EXPECT_NEAR(v[8], -slope / metric, 1e-8);
    const double along = -bend / (metric * metric * metric), around = 1 / (r * metric);
    EXPECT_NEAR(v[9], std::max(along, around), 1e-8);
    EXPECT_NEAR(v[10], std::min(along, around), 1e-8);
  }
  EXPECT_EQ(rows, 16);
}

// The mean of n samples is off by sigma/sqrt(n).
TEST(FitCommand, EvaluateTellsTheStandardDeviation) {
  const TemporaryFolder folder;
  const auto input = folder.write("noisy.xyz", cloud_of([](double, double) { return 25.0; }, 20000, 0.02));
  const auto outcome = run({"celadon", "fit", input, "-o", folder / "s.json", "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const json report = json::parse(read_file(folder / "r.json"));
  ASSERT_EQ(report["model"], "cylinder");
  EXPECT_NEAR(report["sd_mm"]["mean"].get<double>(), 0.02 / std::sqrt(20000), 0.05 * 0.02 / std::sqrt(20000));
  EXPECT_EQ(report["sd_mm"]["mean"], report["sd_mm"]["max"]);
  const auto evaluated = run({"celadon", "evaluate", folder / "s.json", "--angles", "77", "--heights", "41"});
  ASSERT_EQ(evaluated.exit_code, 0) << evaluated.err;
  EXPECT_NE(evaluated.out.find(",sd_mm\n"), std::string::npos);
  EXPECT_EQ(std::stod(evaluated.out.substr(evaluated.out.rfind(',') + 1)), report["sd_mm"]["max"].get<double>());
}

// A vase that leans beside the origin: the surface in the file is on the true one, in the file's coordinates.
TEST(FitCommand, AxisAutoFindsAPartAnywhere) {
  const auto radius = [](double, double z) { return 30 + 0.2 * z - 0.006 * z * z + 4e-5 * z * z * z; };
  Eigen::Isometry3d X_FP = Eigen::Isometry3d::Identity();
  X_FP.linear() = Eigen::AngleAxisd(0.9, Eigen::Vector3d(3, -2, 1).normalized()).toRotationMatrix();
  X_FP.translation() << 150, -80, 40;
  std::istringstream upright(cloud_of(radius, 20000));
  std::string leaning;
  char line[128];
  for (Eigen::Vector3d p; upright >> p.x() >> p.y() >> p.z();) {
    const Eigen::Vector3d q = X_FP * p;
    std::snprintf(line, sizeof line, "%.17g %.17g %.17g\n", q.x(), q.y(), q.z());
    leaning += line;
  }
  const TemporaryFolder folder;
  const auto input = folder.write("leaning.xyz", leaning);
  const auto outcome =
      run({"celadon", "fit", input, "--axis", "auto", "-o", folder / "c.step", "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("axis        through"), std::string::npos) << outcome.out;
  const json report = json::parse(read_file(folder / "r.json"));
  EXPECT_EQ(report["own_axis"]["shape"], "surface of revolution");
  const auto z = report["frame"]["z"];
  const Eigen::Vector3d k(z[0].get<double>(), z[1].get<double>(), z[2].get<double>());
  EXPECT_LT(k.cross(X_FP.linear().col(2)).norm(), 1e-5);
  const StepSurface wall = wall_of(folder / "c.step");
  double worst = 0, low = 100, high = -100;
  for (int i = 0; i <= 40; ++i) {
    for (int j = 0; j <= 97; ++j) {
      const Eigen::Vector3d p = X_FP.inverse() * at_fraction(wall, i / 40.0, j / 97.0);
      worst = std::max(worst, std::abs(std::hypot(p[0], p[1]) - radius(0, p[2])));
      low = std::min(low, p[2]), high = std::max(high, p[2]);
    }
  }
  EXPECT_LT(worst, 1e-3);
  EXPECT_LT(low, 1);
  EXPECT_GT(high, 79);
  // Without it the file is no body around the origin's axis.
  EXPECT_NE(run({"celadon", "fit", input, "--axis", "z", "-o", folder / "d.step"}).exit_code, 0);
  // It is what happens where no axis is named, too.
  ASSERT_EQ(run({"celadon", "fit", input, "-o", folder / "e.step"}).exit_code, 0);
  EXPECT_EQ(wall_of(folder / "e.step").points, wall.points);
}

// A wall of radius 25 from 0 to 80 under half a ball: what the samples are is found, exactly.
TEST(FitCommand, ShapeAutoFindsABodyWithAHead) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> turn(0, 2 * std::numbers::pi), share(0, 1);
  std::string cloud;
  char line[128];
  for (int k = 0; k < 30000; ++k) {
    const double t = turn(random), at = 105 * share(random), c = share(random);
    const double r = at < 80 ? 25 : 25 * std::sqrt(1 - c * c), z = at < 80 ? at : 80 + 25 * c;
    std::snprintf(line, sizeof line, "%.17g %.17g %.17g\n", r * std::cos(t), r * std::sin(t), z);
    cloud += line;
  }
  const TemporaryFolder folder;
  const auto input = folder.write("bullet.xyz", cloud);
  const auto outcome = run({"celadon", "fit", input, "--shape", "auto", "-o", folder / "c.step", folder / "c.stl",
                            folder / "surface.json", "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("shape       the axis sees"), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("joint       z 80.000"), std::string::npos) << outcome.out;
  const json report = json::parse(read_file(folder / "r.json"));
  EXPECT_EQ(report["base"], "composite");
  EXPECT_EQ(report["points"], 30000);
  ASSERT_EQ(report["pieces"].size(), 2u);
  EXPECT_EQ(report["pieces"][0]["model"], "cylinder");
  EXPECT_EQ(report["pieces"][1]["model"], "sphere");
  EXPECT_NEAR(report["joints"][0]["height_mm"].get<double>(), 80, 1e-6);
  EXPECT_LT(report["joints"][0]["after"]["angle_rad"].get<double>(), 1e-9);
  EXPECT_EQ(report["solid"]["faces"], 3);
  EXPECT_TRUE(report["solid"]["valid"].get<bool>());
  const double z0 = report["pieces"][0]["band_mm"][0];
  EXPECT_NEAR(report["solid"]["volume_mm3"].get<double>(),
              std::numbers::pi * 625 * (80 - z0) + 2.0 / 3 * std::numbers::pi * 25 * 25 * 25, 0.01);
  const auto top =
      run({"celadon", "evaluate", folder / "surface.json", "--piece", "2", "--polar", "0,45", "--angles", "30"});
  ASSERT_EQ(top.exit_code, 0) << top.err;
  EXPECT_NE(top.out.find("30,0,2"), std::string::npos) << top.out;
  const auto none = run({"celadon", "evaluate", folder / "surface.json", "--piece", "3"});
  EXPECT_EQ(none.exit_code, 2);
  EXPECT_NE(none.err.find("has no piece 3; it has 2"), std::string::npos) << none.err;
  const auto wrong = run({"celadon", "fit", input, "--split-above", "80", "-o", folder / "d.step"});
  EXPECT_EQ(wrong.exit_code, 2);
  EXPECT_NE(wrong.err.find("--shape composite"), std::string::npos) << wrong.err;
}

// A named axis of the file becomes z, by the cyclic permutation that keeps the frame right-handed.
TEST(FitCommand, NamedAxesAreThoseOfTheFile) {
  const auto radius = [](double t, double z) { return 20 + 3 * std::cos(2 * t) + 0.1 * z; };
  std::istringstream upright(cloud_of(radius, 6000));
  std::string along_x, along_y, along_z;
  char line[128];
  for (Eigen::Vector3d p; upright >> p.x() >> p.y() >> p.z();) {
    const auto put = [&](std::string& text, double x, double y, double z) {
      std::snprintf(line, sizeof line, "%.17g %.17g %.17g\n", x, y, z);
      text += line;
    };
    put(along_z, p.x(), p.y(), p.z());
    put(along_y, p.y(), p.z(), p.x());
    put(along_x, p.z(), p.x(), p.y());
  }
  const TemporaryFolder folder;
  std::vector<std::string> surfaces;
  for (const auto& [axis, cloud] : {std::pair{"z", along_z}, std::pair{"y", along_y}, std::pair{"x", along_x}}) {
    const auto input = folder.write(std::string(axis) + ".xyz", cloud);
    const auto outcome =
        run({"celadon", "fit", input, "--axis", axis, "-o", folder / (std::string(axis) + ".json"), "--name", "part"});
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
    surfaces.push_back(read_file(folder / (std::string(axis) + ".json")));
  }
  EXPECT_EQ(surfaces[1], surfaces[0]);
  EXPECT_EQ(surfaces[2], surfaces[0]);
}

// Points of a bellied body with lobes, closed by domes at z = 0 and 60, as a scanner sees what stands at X: all but the
// lowest part of it.
std::string seen_of_body(const Eigen::Isometry3d& X, double lowest, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> turn(0, 2 * std::numbers::pi), share(0, 1);
  std::normal_distribution<double> noise(0, 0.01);
  std::string text;
  char line[128];
  for (int k = 0; k < 60000; ++k) {
    const double t = turn(random), at = 110 * share(random), lobes = 1.5 * std::cos(3 * t);
    Eigen::Vector3d p;
    if (at < 60) {
      const double s = at / 60, r = 25 + lobes + 40 * s * s * (1 - s) * (1 - s) * (1.4 - s) + noise(random);
      p << r * std::cos(t), r * std::sin(t), at;
    } else {
      const double c = share(random), d = std::sqrt(1 - c * c), rho = 25 + lobes * std::pow(d, 4) + noise(random);
      p << rho * d * std::cos(t), rho * d * std::sin(t), at < 85 ? 60 + rho * c : -rho * c;
    }
    p = X * p;
    if (p.z() < lowest) continue;
    std::snprintf(line, sizeof line, "%.17g %.17g %.17g\n", p.x(), p.y(), p.z());
    text += line;
  }
  return text;
}

// An egg stands on the table twice, once on its head: together both scans show all of it.
TEST(FitCommand, TurnedOverClosesTheOtherEnd) {
  Eigen::Isometry3d first = Eigen::Isometry3d::Identity(), second = first;
  first.translate(Eigen::Vector3d(40, -7, 25));
  second.translate(Eigen::Vector3d(-12, 5, 85));
  second.rotate(Eigen::AngleAxisd(1.9, Eigen::Vector3d::UnitZ()));
  second.rotate(Eigen::AngleAxisd(std::numbers::pi + 0.01, Eigen::Vector3d::UnitX()));
  const TemporaryFolder folder;
  const auto upright = folder.write("upright.xyz", seen_of_body(first, 20, 1)),
             over = folder.write("over.xyz", seen_of_body(second, 20, 2));
  const auto outcome = run({"celadon", "fit", upright, "--turned-over", over, "--shape", "auto", "-o",
                            folder / "c.step", "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("poses       two"), std::string::npos) << outcome.out;
  const json report = json::parse(read_file(folder / "r.json"));
  ASSERT_EQ(report["pieces"].size(), 3u) << report["shape_reason"];
  EXPECT_EQ(report["pieces"][0]["band_rad"][1], std::numbers::pi);
  EXPECT_EQ(report["pieces"][2]["band_rad"][0], 0);
  EXPECT_EQ(report["solid"]["faces"], 3);
  EXPECT_NEAR(report["geometric_mm"]["rms"].get<double>(), 0.01, 0.002);
  EXPECT_NEAR(report["turned_over"]["scale_mm"].get<double>(), 0.01, 0.003);
  EXPECT_LT(report["turned_over"]["shift_sd_mm"].get<double>(), 0.01);
  // About an axis that is named, the second pose is found beside it.
  first.translation() << 0, 0, 25;
  second.translation() << 0.4, -0.2, 85;
  const auto upright_z = folder.write("upright_z.xyz", seen_of_body(first, 20, 3)),
             over_z = folder.write("over_z.xyz", seen_of_body(second, 20, 4));
  const auto named = run({"celadon", "fit", upright_z, "--turned-over", over_z, "--shape", "auto", "--axis", "z", "-o",
                          folder / "z.step", "--report", folder / "z.report.json"});
  ASSERT_EQ(named.exit_code, 0) << named.err;
  EXPECT_NEAR(json::parse(read_file(folder / "z.report.json"))["geometric_mm"]["rms"].get<double>(), 0.01, 0.002);
  // What the second pose shows of the wrong object is refused.
  const auto other = folder.write("other.xyz", cloud_of([](double, double z) { return 8 + 0.1 * z; }, 5000));
  const auto wrong =
      run({"celadon", "fit", upright, "--turned-over", other, "--shape", "auto", "-o", folder / "d.step"});
  EXPECT_EQ(wrong.exit_code, 2);
  EXPECT_NE(wrong.err.find("other.xyz"), std::string::npos) << wrong.err;
}

// A cylinder with its top face, standing on a table that is larger than it.
TEST(FitCommand, TopAndTableAreNoWall) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> normal(0, 0.02);
  std::string samples;
  const auto add = [&](double r, double z) {
    const double t = 2 * std::numbers::pi * share(random);
    char line[128];
    std::snprintf(line, sizeof line, "%.9g %.9g %.9g\n", r * std::cos(t), r * std::sin(t), z);
    samples += line;
  };
  for (int k = 0; k < 20000; ++k) add(30 + normal(random), 80 * share(random));
  for (int k = 0; k < 4000; ++k) add(30 * std::sqrt(share(random)), 80 + normal(random));
  for (int k = 0; k < 9000; ++k) add(std::sqrt(900 + 4000 * share(random)), normal(random));
  const TemporaryFolder folder;
  const auto outcome = run({"celadon", "fit", folder.write("part.xyz", samples), "-o", folder / "c.step",
                            folder / "c.stl", "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("face        the upper end is flat at z"), std::string::npos) << outcome.out;
  const json report = json::parse(read_file(folder / "r.json"));
  EXPECT_EQ(report["model"], "cylinder") << report["decided_by"];
  EXPECT_NEAR(report["noise_mm"].get<double>(), 0.02, 0.001);
  EXPECT_NEAR(report["size_mm"][2].get<double>(), 80, 0.01);
  EXPECT_NEAR(report["solid"]["volume_mm3"].get<double>(), 900 * std::numbers::pi * 80, 60);
  const std::string step = read_file(folder / "c.step");
  EXPECT_NE(step.find("top (measured)"), std::string::npos);
  EXPECT_NE(step.find("bottom (measured)"), std::string::npos);
  EXPECT_EQ(step.find("assumed"), std::string::npos);
}

// The same of native samples whose wall ends before its faces: off the axis, and as one sector of five.
TEST(FitCommand, WallsGoOnToTheirFacesInOtherFramesAndSectors) {
  const auto samples = [](double off, double lobes) {
    std::mt19937 random(5);
    std::uniform_real_distribution<double> share(0, 1);
    std::normal_distribution<double> normal(0, 0.02);
    std::string text = "r,theta,z\n";
    const auto add = [&](double t, double r, double z) {
      const double x = off + r * std::cos(t), y = r * std::sin(t);
      char line[128];
      std::snprintf(line, sizeof line, "%.9g,%.9g,%.9g\n", std::hypot(x, y), std::atan2(y, x), z);
      text += line;
    };
    const auto turn = [&] { return 2 * std::numbers::pi * share(random); };
    for (int k = 0; k < 20000; ++k) {
      const double t = turn();
      add(t, 25 + lobes * std::cos(5 * t) + normal(random), 0.7 + 78.3 * share(random));
    }
    for (int k = 0; k < 4000; ++k) add(turn(), 23 * std::sqrt(share(random)), 80 + normal(random));
    for (int k = 0; k < 9000; ++k) add(turn(), std::sqrt(1000 + 5000 * share(random)), normal(random));
    return text;
  };
  const TemporaryFolder folder;
  const auto report_of = [&](const std::string& input, std::vector<std::string> more) {
    std::vector<std::string> command = {"celadon",        "fit", input, "-o", folder / "c.step", "--report",
                                        folder / "r.json"};
    command.insert(command.end(), more.begin(), more.end());
    const auto outcome = run(command);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    return json::parse(read_file(folder / "r.json"));
  };
  const json off = report_of(folder.write("off.csv", samples(6, 0)), {});
  EXPECT_EQ(off["model"], "cylinder");
  EXPECT_NEAR(off["frame"]["origin"][0].get<double>(), 6, 0.01);
  EXPECT_NEAR(off["size_mm"][2].get<double>(), 80, 0.01);
  const json lobed = report_of(folder.write("lobed.csv", samples(0, 1.5)), {"--symmetry", "5", "--mirror", "auto"});
  EXPECT_EQ(lobed["symmetry"]["fold"], 5);
  EXPECT_NEAR(lobed["size_mm"][2].get<double>(), 80, 0.01);
  EXPECT_NEAR(lobed["noise_mm"].get<double>(), 0.02, 0.002);
}

// Native samples are the scanner's: a cylinder off its axis is one about its own, unless the axis is named.
TEST(FitCommand, NativeSamplesOfAPartOffTheAxis) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> turn(0, 2 * std::numbers::pi), height(0, 80);
  std::string samples = "r,theta,z\n";
  char line[128];
  for (int k = 0; k < 20000; ++k) {
    const double t = turn(random), x = 6 + 25 * std::cos(t), y = 3 + 25 * std::sin(t);
    std::snprintf(line, sizeof line, "%.17g,%.17g,%.17g\n", std::hypot(x, y), std::atan2(y, x), height(random));
    samples += line;
  }
  const TemporaryFolder folder;
  const auto input = folder.write("off.csv", samples);
  const auto report_of = [&](std::vector<std::string> more) {
    std::vector<std::string> command = {"celadon",        "fit", input, "-o", folder / "c.step", "--report",
                                        folder / "r.json"};
    command.insert(command.end(), more.begin(), more.end());
    const auto outcome = run(command);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    return json::parse(read_file(folder / "r.json"));
  };
  const json own = report_of({});
  EXPECT_EQ(own["model"], "cylinder");
  EXPECT_NEAR(own["frame"]["origin"][0].get<double>(), 6, 1e-6);
  EXPECT_NEAR(own["frame"]["origin"][1].get<double>(), 3, 1e-6);
  EXPECT_NE(own["about_scanner_axis"]["model"], "cylinder");
  const json named = report_of({"--axis", "z"});
  EXPECT_NE(named["model"], "cylinder");
  EXPECT_FALSE(named.contains("own_axis"));
}

TEST(FitCommand, SameInputGivesTheSameBytes) {
  const TemporaryFolder folder;
  const auto input = folder.write(
      "part.xyz", cloud_of([](double t, double z) { return 30 + std::cos(3 * t) + 0.02 * z; }, 8000, 0.02));
  for (const char* name : {"a", "b"}) {
    const auto outcome =
        run({"celadon", "fit", input, "-o", folder / (std::string(name) + ".step"),
             folder / (std::string(name) + ".stl"), folder / (std::string(name) + ".json"), "--name", "part"});
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  }
  for (const char* end : {".step", ".stl", ".json"}) {
    EXPECT_EQ(read_file(folder / (std::string("a") + end)), read_file(folder / (std::string("b") + end))) << end;
  }
}

TEST(FitCommand, EveryBadInputGetsOneSentenceAndNoFile) {
  const TemporaryFolder folder;
  const std::string good = cloud_of([](double, double) { return 25.0; }, 3000);
  std::string on_axis, not_numbers, native = "r,theta,z\n";
  for (int k = 0; k < 3000; ++k) native += "25," + std::to_string(0.1 * k) + "," + std::to_string(0.01 * k) + "\n";
  for (int k = 0; k < 3000; ++k) on_axis += "0 0 " + std::to_string(k) + "\n";
  for (int k = 0; k < 3000; ++k) not_numbers += "nan inf " + std::to_string(k) + "\n";
  struct Case {
    const char* name;
    std::string bytes;
    std::vector<std::string> more;
    const char* says;
  };
  const std::vector<Case> cases = {
      {"empty.xyz", "", {}, "empty"},
      {"axis.xyz", on_axis, {}, "axis"},
      {"nan.xyz", not_numbers, {}, "infinite"},
      {"three.xyz", "1 0 0\n0 1 1\n-1 0 2\n", {}, "fewer than the 16 unknowns"},
      {"few.xyz", cloud_of([](double, double) { return 25.0; }, 60), {"--model", "general", "--knots", "4", "4"}, "60"},
      {"lying.ply",
       "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\nproperty float y\n"
       "property float z\nend_header\n1234567890ab",
       {},
       "1 000 000 000 000"},
      {"lying.pcd",
       "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1000000000000\nHEIGHT 1\nPOINTS "
       "1000000000000\n"
       "DATA binary\n123456789012",
       {},
       "1 000 000 000 000"},
      {"words.xyz", good + "one two three\n", {}, "3 001"},
      {"picture.xyz", std::string("\x89PNG\r\n\x1a\n\0\0\0\rIHDR", 16), {}, "picture.xyz"},
      {"unit.xyz", good, {"--unit", "furlong"}, "furlong"},
      {"axis-name.xyz", good, {"--axis", "w"}, "w"},
      {"native.csv", native, {"--axis", "x"}, "leave --axis x out"},
      {"line.xyz", on_axis, {"--axis", "auto"}, "line"},
      {"degree.xyz", good, {"--degree", "9", "3"}, "9"},
  };
  for (const Case& c : cases) {
    const auto input = folder.write(c.name, c.bytes);
    const auto output = folder / "out.step";
    std::vector<std::string> command = {"celadon", "fit", input, "-o", output};
    command.insert(command.end(), c.more.begin(), c.more.end());
    const auto outcome = run(command);
    EXPECT_EQ(outcome.exit_code, 2) << c.name << ": " << outcome.out << outcome.err;
    EXPECT_NE(outcome.err.find(c.says), std::string::npos) << c.name << ": " << outcome.err;
    EXPECT_FALSE(fs::exists(output)) << c.name;
  }
  const auto missing = run({"celadon", "fit", folder / "nowhere.xyz", "-o", folder / "o.step"});
  EXPECT_EQ(missing.exit_code, 2);
  EXPECT_NE(missing.err.find("nowhere.xyz"), std::string::npos) << missing.err;
  const auto ending = run({"celadon", "fit", folder / "empty.xyz", "-o", folder / "o.dwg"});
  EXPECT_EQ(ending.exit_code, 2);
  EXPECT_NE(ending.err.find(".dwg"), std::string::npos) << ending.err;
}

TEST(FitCommand, FullDiskLeavesNothingUnderTheFinalName) {
  const TemporaryFolder folder;
  const auto input =
      folder.write("part.xyz", cloud_of([](double t, double) { return 25.0 + std::cos(2 * t); }, 5000, 0.01));
  for (const char* name : {"o.step", "o.stl", "surface.json"}) {
    const auto outcome = run({"celadon", "fit", input, "-o", folder / name}, 2000);
    EXPECT_EQ(outcome.exit_code, 4) << name << outcome.err;
    EXPECT_FALSE(fs::exists(folder / name)) << name;
    EXPECT_NE(outcome.err.find(name), std::string::npos) << outcome.err;
  }
}

TEST(LineCommand, BadPicturesAreRefused) {
  const TemporaryFolder folder;
  const auto black = folder.write("black.pgm", "P5\n128 32\n255\n" + std::string(128 * 32, '\0'));
  const auto nothing = run({"celadon", "line", black});
  EXPECT_EQ(nothing.exit_code, 1) << nothing.err;
  const auto narrow = folder.write("narrow.pgm", "P5\n32 8\n255\n" + std::string(256, '\0'));
  EXPECT_EQ(run({"celadon", "line", narrow}).exit_code, 2);
  const auto mixed = run({"celadon", "line", black, "--off", narrow});
  EXPECT_EQ(mixed.exit_code, 2);
  EXPECT_NE(mixed.err.find("128 x 32"), std::string::npos) << mixed.err;
  const auto torn = folder.write("torn.pgm", "P5\n128 3200\n255\nabc");
  EXPECT_EQ(run({"celadon", "line", torn}).exit_code, 2);
}

// A line across the picture at row 40.25, four times as wide as high.
TEST(LineCommand, LyingLinesAreFoundAlongColumns) {
  const TemporaryFolder folder;
  std::string pixels;
  for (int y = 0; y < 96; ++y) {
    const double u = (y - 40.25) / 2.5;
    pixels += std::string(400, static_cast<char>(std::lround(20 + 150 * std::exp(-0.5 * u * u))));
  }
  const auto picture = folder.write("lying.pgm", "P5\n400 96\n255\n" + pixels);
  EXPECT_EQ(run({"celadon", "line", picture}).exit_code, 1) << "no row has a line";
  const auto csv = folder / "line.csv", overlay = folder / "line.png";
  const auto outcome = run({"celadon", "line", picture, "--along", "columns", "-o", csv, "--overlay", overlay});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("columns     400, with a line 400"), std::string::npos) << outcome.out;
  EXPECT_GT(fs::file_size(overlay), 100u);
  std::ifstream lines(csv);
  std::string line;
  std::getline(lines, line);
  EXPECT_EQ(line.rfind("column,y_px,sigma_px", 0), 0u) << line;
  int columns = 0;
  for (; std::getline(lines, line); ++columns) {
    EXPECT_NEAR(std::stod(line.substr(line.find(',') + 1)), 40.25, 0.05) << line;
  }
  EXPECT_EQ(columns, 400);
}

TEST(Help, ShowsUnitsAndDefaults) {
  for (const char* command : {"fit", "merge", "scan", "line", "evaluate", "watch"}) {
    const auto outcome = run({"celadon", command, "--help"});
    EXPECT_EQ(outcome.exit_code, 0);
    EXPECT_NE(outcome.out.find("-o"), std::string::npos) << command;
  }
  EXPECT_NE(run({"celadon", "fit", "--help"}).out.find("[mm]"), std::string::npos);
  EXPECT_EQ(run({"celadon"}).exit_code, 2);
  EXPECT_EQ(run({"celadon", "fly"}).exit_code, 2);
}

}  // namespace
}  // namespace celadon::testing
