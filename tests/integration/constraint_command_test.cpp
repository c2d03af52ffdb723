// What is known of a part beforehand, from the command line to the STEP file.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <string>

#include "tests/integration/process.h"
#include "tests/temporary_folder.h"

namespace celadon::testing {
namespace {

using nlohmann::json;
constexpr double kPi = std::numbers::pi;

// A six-lobed knob, leaning nowhere, its lobes at 0.2 rad.
std::string knob(double sigma) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  std::string text = "r,theta,z\n";
  for (int i = 0; i < 240; ++i)
    for (int j = 0; j < 60; ++j) {
      const double t = 2 * kPi * (i + 0.5) / 240, z = 40.0 * j / 59;
      char line[80];
      std::snprintf(line, sizeof line, "%.9f,%.9f,%.9f\n", 25 + 1.5 * std::cos(6 * (t - 0.2)) + sigma * normal(random),
                    t, z);
      text += line;
    }
  return text;
}

TEST(Constraints, SymmetryAndRadiiReachTheFiles) {
  TemporaryFolder folder;
  const auto input = folder.write("knob.csv", knob(0.03));
  const auto outcome =
      run({"celadon", "fit", input, "--model", "general", "--symmetry", "6", "--mirror", "auto", "--fix-angle-above",
           "0", "-o", folder / "knob.step", folder / "surface.json", folder / "report.json", folder / "errors.svg"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("symmetry    6-fold, mirrored at"), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("held        angle 0 degrees at the upper rim"), std::string::npos) << outcome.out;
  const json report = json::parse(read_file(folder / "report.json"));
  EXPECT_EQ(report["symmetry"]["fold"], 6);
  EXPECT_LT(std::abs(std::remainder(report["symmetry"]["mirror_plane_rad"].get<double>() - 0.2, kPi / 6)), 2e-3);
  EXPECT_NEAR(report["constraints"][0]["alone_rad"].get<double>(), 0, 5e-3);
  EXPECT_TRUE(report["solid"]["valid"]);
  EXPECT_NEAR(report["solid"]["volume_mm3"].get<double>() / ((625 + 1.125) * kPi * 40), 1, 1e-4);
  EXPECT_NEAR(report["noise_mm"].get<double>(), 0.03, 0.002);

  // Read back, it is the same at every sixth of a turn, and level at the upper rim.
  const json surface = json::parse(read_file(folder / "surface.json"));
  EXPECT_EQ(surface["base"]["arcs"], 12);
  const auto values = run({"celadon", "evaluate", folder / "surface.json", "--angles", "10:60:310", "--heights", "20"});
  ASSERT_EQ(values.exit_code, 0) << values.err;
  std::vector<double> radii;
  for (std::size_t at = values.out.find('\n') + 1; at < values.out.size(); at = values.out.find('\n', at) + 1) {
    double theta = 0, z = 0, r = 0;
    ASSERT_GE(std::sscanf(values.out.c_str() + at, "%lf,%lf,%lf", &theta, &z, &r), 3) << values.out;
    radii.push_back(r);
  }
  ASSERT_EQ(radii.size(), 6u) << values.out;
  for (const double r : radii) EXPECT_NEAR(r, radii.front(), 1e-9);
}

TEST(Constraints, WhatCannotBeIsRefusedInASentence) {
  TemporaryFolder folder;
  const auto input = folder.write("knob.csv", knob(0.03));
  const auto message = [&](std::vector<std::string> options) {
    options.insert(options.begin(), {"celadon", "fit", input, "-o", folder / "knob.json"});
    const auto outcome = run(options);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.out;
    EXPECT_FALSE(std::filesystem::exists(folder / "knob.json"));
    return outcome.err;
  };
  EXPECT_NE(message({"--fix-radius", "20=30", "20=31"}).find("cannot be both 30 and 31 mm"), std::string::npos);
  EXPECT_NE(message({"--fix-radius", "20:30"}).find("'20:30' is not HEIGHT=RADIUS"), std::string::npos);
  EXPECT_NE(message({"--fix-radius", "200=30"}).find("the surface goes from z = 0 to 40 mm"), std::string::npos);
  EXPECT_NE(message({"--mirror", "left"}).find("'left' must be an angle or auto"), std::string::npos);
  EXPECT_NE(message({"--symmetry", "3", "--shape", "sphere"}).find("for --shape cylinder"), std::string::npos);
  EXPECT_NE(message({"--symmetry", "5", "--model", "revolution", "--mirror", "auto"}).find("round surface"),
            std::string::npos);
}

// A tall vase in two heights of a lift that says 80 mm and went 80.12.
TEST(Raised, TwoHeightsAreOneBody) {
  TemporaryFolder folder;
  std::mt19937 random(9);
  std::normal_distribution<double> normal(0, 0.02);
  const auto samples = [&](double low, double high, double raised) {
    std::string text = "r,theta,z\n";
    for (int i = 0; i < 200; ++i)
      for (int j = 0; j < 60; ++j) {
        const double t = 2 * kPi * (i + 0.5) / 200, z = low + (high - low) * j / 59;
        char line[80];
        std::snprintf(line, sizeof line, "%.9f,%.9f,%.9f\n",
                      30 + 6 * std::sin(z / 25) + 1.5 * std::cos(3 * t) + normal(random), t, z + raised);
        text += line;
      }
    return text;
  };
  // The machine sees 0 to 120 mm: below, and after lowering the object by 80 mm, above.
  const auto below = folder.write("below.csv", samples(0, 120, 0)),
             above = folder.write("above.csv", samples(80, 200, -80.12));
  const auto outcome = run({"celadon", "fit", below, "--raised", above, "--lift", "-80", "-o", folder / "v.step",
                            "--report", folder / "r.json"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("heights     two"), std::string::npos) << outcome.out;
  const json report = json::parse(read_file(folder / "r.json"));
  const double sd = report["raised"]["sd_mm"];
  EXPECT_LT(sd, 0.01);
  EXPECT_NEAR(report["raised"]["lift_mm"].get<double>(), -80.12, 4 * sd);
  EXPECT_NEAR(report["noise_mm"].get<double>(), 0.02, 0.001);
  EXPECT_NEAR(report["band_mm"][1].get<double>(), 200, 0.1);
  EXPECT_TRUE(report["solid"]["valid"]);
  // As it was said, the wall does not lie on itself.
  const auto exact = run({"celadon", "fit", below, "--raised", above, "--lift", "-80", "--lift-exact", "-o",
                          folder / "w.json", "--report", folder / "e.json"});
  ASSERT_EQ(exact.exit_code, 0) << exact.err;
  EXPECT_EQ(json::parse(read_file(folder / "e.json"))["raised"]["sd_mm"], 0);
  EXPECT_GT(json::parse(read_file(folder / "e.json"))["noise_mm"].get<double>(),
            1.02 * report["noise_mm"].get<double>());
  const auto alone = run({"celadon", "fit", below, "--raised", above, "-o", folder / "x.json"});
  EXPECT_EQ(alone.exit_code, 2);
  EXPECT_NE(alone.err.find("--raised and --lift go together"), std::string::npos) << alone.err;
}

}  // namespace
}  // namespace celadon::testing
