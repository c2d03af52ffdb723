// What a raised head and a table that sinks show beyond a turn of the table alone, through real processes.

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "tests/integration/process.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

json scanned(const std::string& scene, const std::vector<std::string>& options, const TemporaryFolder& folder,
             const std::string& name) {
  std::vector<std::string> command{"celadon",   "scan", "--simulate",   scene, "--profiles", "160",
                                   "--formats", "step", "surface.json", "-o",  folder / name};
  command.insert(command.end(), options.begin(), options.end());
  const auto outcome = run(command);
  EXPECT_EQ(outcome.exit_code, 0) << outcome.out << outcome.err;
  if (outcome.exit_code != 0) return {};
  json report = json::parse(read_file(folder / name / "report.json"));
  report["printed"] = outcome.out;
  EXPECT_TRUE(report["solid"]["valid"].get<bool>());
  return report;
}

TEST(ScanAxesOfTheVirtualScanner, ARaisedHeadSeesMoreOfASphere) {
  const TemporaryFolder folder;
  const json level = scanned("sphere", {"--shape", "sphere"}, folder, "level");
  const json raised = scanned("sphere", {"--shape", "sphere", "--elevations", "0,50"}, folder, "raised");
  ASSERT_FALSE(level.is_null() || raised.is_null());
  EXPECT_GE(raised["coverage"].get<double>(), 0.99);
  EXPECT_GT(raised["points"].get<double>(), 1.5 * level["points"].get<double>());
  EXPECT_LT(raised["truth_mm"]["rms"], 0.02);
  ASSERT_EQ(raised["lasers"].size(), 2u);
  EXPECT_NEAR(raised["lasers"][1]["elevation_deg"], 50, 0.01);
  EXPECT_NEAR(raised["size_mm"][0].get<double>(), 70, 0.1);
}

TEST(ScanAxesOfTheVirtualScanner, ARaisedHeadSeesMoreOfAKnob) {
  const TemporaryFolder folder;
  const json level = scanned("knob", {"--shape", "auto"}, folder, "level");
  const json raised = scanned("knob", {"--shape", "auto", "--elevations", "0,45"}, folder, "raised");
  ASSERT_FALSE(level.is_null() || raised.is_null());
  EXPECT_GE(raised["coverage"].get<double>(), level["coverage"].get<double>());
  EXPECT_GT(raised["points"].get<double>(), 1.5 * level["points"].get<double>());
  // Seen from above, what is left of the top is more than a wall about the axis can follow.
  EXPECT_LT(raised["truth_mm"]["rms"], 0.15);
}

double tall_radius(double z_mm) {
  return 24 + 4 * std::sin(z_mm / 25);
}

/// A closed body of revolution, taller than the camera's picture.
void write_tall(const std::filesystem::path& file, double height_mm) {
  std::ofstream out(file);
  out.precision(9);
  constexpr int kAround = 120, kAlong = 140;
  const auto at = [&](int i, int k) {
    const double z = height_mm * i / kAlong, t = 2 * std::numbers::pi * k / kAround, r = tall_radius(z);
    return std::array<double, 3>{r * std::cos(t), r * std::sin(t), z};
  };
  const auto facet = [&](const std::array<double, 3>& a, const std::array<double, 3>& b,
                         const std::array<double, 3>& c) {
    out << "facet normal 0 0 0\n outer loop\n";
    for (const auto& p : {a, b, c}) out << "  vertex " << p[0] << " " << p[1] << " " << p[2] << "\n";
    out << " endloop\nendfacet\n";
  };
  out << "solid tall\n";
  for (int k = 0; k < kAround; ++k) {
    for (int i = 0; i < kAlong; ++i) {
      facet(at(i, k), at(i, k + 1), at(i + 1, k + 1));
      facet(at(i, k), at(i + 1, k + 1), at(i + 1, k));
    }
    facet({0, 0, 0}, at(0, k + 1), at(0, k));
    facet({0, 0, height_mm}, at(kAlong, k), at(kAlong, k + 1));
  }
  out << "endsolid tall\n";
}

TEST(ScanAxesOfTheVirtualScanner, ATallObjectIsOneSolidFromTwoHeights) {
  const TemporaryFolder folder;
  constexpr double kHeight_mm = 190;
  write_tall(folder / "tall.stl", kHeight_mm);
  const std::string scene = "mesh:" + (folder / "tall.stl").string();
  const json low = scanned(scene, {}, folder, "low");
  const json both = scanned(scene, {"--lifts", "0,-85"}, folder, "both");
  ASSERT_FALSE(low.is_null() || both.is_null());
  EXPECT_LT(low["size_mm"][2].get<double>(), kHeight_mm - 30) << "one height does not show it";
  EXPECT_GT(both["size_mm"][2].get<double>(), kHeight_mm - 6);
  EXPECT_LT(both["truth_mm"]["rms"], 0.04);
}

}  // namespace
}  // namespace celadon::testing
