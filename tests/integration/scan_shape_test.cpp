// Scans of bodies that are not one wall over a cylinder, through real processes: what the samples ask for is found.

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/integration/process.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

json scanned(const char* scene, const char* shape, const TemporaryFolder& folder) {
  const auto outcome = run({"celadon", "scan", "--simulate", scene, "--shape", shape, "--profiles", "240", "--formats",
                            "step", "stl", "-o", folder / "out"});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  if (outcome.exit_code != 0) return {};
  json report = json::parse(read_file(folder / "out" / "report.json"));
  report["printed"] = outcome.out;
  EXPECT_TRUE(report["solid"]["valid"].get<bool>());
  return report;
}

TEST(ScanShape, AVaseStaysOneWall) {
  const TemporaryFolder folder;
  const json report = scanned("vase", "auto", folder);
  ASSERT_FALSE(report.is_null());
  EXPECT_EQ(report["base"], "cylinder") << report["shape_reason"];
  EXPECT_EQ(report["model"], "revolution") << report["decided_by"];
  EXPECT_LT(report["truth_mm"]["rms"], 0.02);
}

// What stands on the table hides its lowest part.
TEST(ScanShape, ASphereIsASphere) {
  const TemporaryFolder folder;
  const json report = scanned("sphere", "auto", folder);
  ASSERT_FALSE(report.is_null());
  EXPECT_EQ(report["base"], "sphere") << report["shape_reason"];
  EXPECT_LT(report["truth_mm"]["rms"], 0.02);
  EXPECT_NEAR(report["size_mm"][0].get<double>(), 70, 0.1);
}

TEST(ScanShape, AShaftHasShouldersBetweenItsWalls) {
  const TemporaryFolder folder;
  const json report = scanned("stepped-shaft", "auto", folder);
  ASSERT_FALSE(report.is_null());
  ASSERT_EQ(report["base"], "composite") << report["printed"].get<std::string>();
  const double heights[] = {22, 48, 62, 66, 80};
  ASSERT_EQ(report["shoulders"].size(), 5u) << report["printed"].get<std::string>();
  for (std::size_t k = 0; k < 5; ++k) {
    const auto& shoulder = report["shoulders"][k];
    EXPECT_NEAR(shoulder["height_mm"].get<double>(), heights[k], 0.02 + 2 * shoulder["sd_mm"].get<double>())
        << shoulder;
    EXPECT_LT(shoulder["sd_mm"], 0.08);
  }
  for (const auto& piece : report["pieces"]) EXPECT_EQ(piece["model"], "cylinder") << piece["decided_by"];
  EXPECT_LT(report["truth_mm"]["rms"], 0.02);
}

// Its head is a range over the cylinder, too.
TEST(ScanShape, AKnobIsFollowed) {
  const TemporaryFolder folder;
  const json report = scanned("knob", "auto", folder);
  ASSERT_FALSE(report.is_null());
  EXPECT_LT(report["truth_mm"]["rms"], 0.03);
}

}  // namespace
}  // namespace celadon::testing
