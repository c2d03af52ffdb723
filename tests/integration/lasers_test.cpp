// Scans with the two lasers of a virtual scanner: they agree, they see more together, and a plane that left its
// calibration is named.

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

struct LaserScan {
  json report;
  std::string printed;
};

/// @param exit_code  1 where a check of the scan is to fail
LaserScan scan_by(const Station& station, const std::string& lasers, const std::string& profiles, int exit_code = 0) {
  const std::filesystem::path out = station.folder / ("by-" + lasers);
  const auto outcome = run({"celadon", "scan", "--server", station.server(), "--lasers", lasers, "--profiles", profiles,
                            "--formats", "surface.json", "-o", out});
  EXPECT_EQ(outcome.exit_code, exit_code)
      << outcome.err << (outcome.exit_code == 1 ? read_file(out / "report.json") : "");
  if (outcome.exit_code != exit_code) return {};
  return {json::parse(read_file(out / "report.json")), outcome.out};
}

void expect_agreement(const json& report) {
  int passed = 0;
  for (const auto& check : report["checks"]) {
    if (check["name"] == "laser_agreement" || check["name"] == "laser_scatter") passed += check["verdict"] == "passed";
  }
  EXPECT_EQ(passed, 2) << report["checks"];
}

TEST(Lasers, TwoAreNoWorseThanOneAndAgree) {
  Station station("vase", {"--lasers", "2"});
  station.start_daemon();
  const json one = scan_by(station, "0", "240").report, two = scan_by(station, "all", "240").report;
  ASSERT_FALSE(two.is_null());
  EXPECT_EQ(one["lasers"].size(), 1u);
  EXPECT_FALSE(one.contains("agreement_mm"));
  ASSERT_EQ(two["lasers"].size(), 2u);
  EXPECT_NEAR(two["points"].get<double>(), 2 * one["points"].get<double>(), 0.01 * one["points"].get<double>());
  EXPECT_LE(two["truth_mm"]["rms"].get<double>(), 1.05 * one["truth_mm"]["rms"].get<double>());
  EXPECT_LT(std::abs(two["agreement_mm"]["bias"].get<double>()), 0.002);
  EXPECT_GT(two["agreement_mm"]["cells"], 1000);
  expect_agreement(two);

  // The log has both, for another fit.
  const auto fit = run({"celadon", "fit", station.folder / "store" / "scans" / "000002" / "profiles.log", "--report",
                        station.folder / "again.json", "-o", station.folder / "again.surface.json"});
  ASSERT_EQ(fit.exit_code, 0) << fit.err;
  EXPECT_EQ(json::parse(read_file(station.folder / "again.json"))["points"], two["points"]);
}

TEST(Lasers, OneThatIsNotThereIsRefused) {
  Station station("vase");
  station.start_daemon();
  const auto outcome = run({"celadon", "scan", "--server", station.server(), "--lasers", "0,1"});
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_NE(outcome.err.find("Laser 1 was asked for, but the machine has lasers 0"), std::string::npos) << outcome.err;
  EXPECT_EQ(station.state()["motion"], "unhomed");
  EXPECT_EQ(run({"celadon", "scan", "--server", station.server(), "--lasers", "all,0"}).exit_code, 2);
}

/// A column of five lobes with flanks so steep that a camera beside the laser does not see all of them.
std::string lobes() {
  constexpr int kAround = 720;
  constexpr double kHeight_mm = 40;
  std::string facets = "solid lobes\n";
  const auto vertex = [](double angle_steps, double z) {
    const double theta = 2 * std::numbers::pi * angle_steps / kAround;
    const double r = 26 + 7 * std::tanh(2 * std::sin(5 * theta)) / std::tanh(2.);
    return "vertex " + std::to_string(r * std::cos(theta)) + " " + std::to_string(r * std::sin(theta)) + " " +
           std::to_string(z) + "\n";
  };
  const auto facet = [&](const std::string& a, const std::string& b, const std::string& c) {
    facets += "facet normal 0 0 0\nouter loop\n" + a + b + c + "endloop\nendfacet\n";
  };
  const std::string bottom = "vertex 0 0 0\n", top = "vertex 0 0 40\n";
  for (int k = 0; k < kAround; ++k) {
    const std::string a = vertex(k, 0), b = vertex((k + 1) % kAround, 0), c = vertex((k + 1) % kAround, kHeight_mm),
                      d = vertex(k, kHeight_mm);
    facet(a, b, c);
    facet(a, c, d);
    facet(bottom, b, a);
    facet(top, d, c);
  }
  return facets + "endsolid lobes\n";
}

TEST(Lasers, WhatOneDoesNotSeeTheOtherDoes) {
  const TemporaryFolder files;
  Station station("mesh:" + files.write("lobes.stl", lobes()).string(), {"--lasers", "2"});
  station.start_daemon();
  const json left = scan_by(station, "0", "360").report, both = scan_by(station, "0,1", "360").report;
  ASSERT_FALSE(left.is_null() || both.is_null());
  EXPECT_LT(left["coverage"], 0.92) << "the scene hides nothing";
  EXPECT_GT(both["coverage"], 0.99);
  EXPECT_LT(both["truth_mm"]["rms"].get<double>(), 0.5 * left["truth_mm"]["rms"].get<double>());
  expect_agreement(both);
}

TEST(Lasers, APlaneThatLeftItsCalibrationIsNamed) {
  Station station("cylinder", {"--lasers", "2"});
  std::string text = read_file(station.folder / "calibration.toml");
  const std::string key = "\ndistance_mm = ";
  const auto at = text.rfind(key) + key.size(), end = text.find('\n', at);
  ASSERT_NE(end, std::string::npos);
  text.replace(at, end - at, std::to_string(std::stod(text.substr(at, end - at)) + 0.1));
  station.folder.write("calibration.toml", text);
  station.start_daemon();
  const LaserScan scan = scan_by(station, "all", "240", 1);
  ASSERT_FALSE(scan.report.is_null());
  EXPECT_NEAR(std::abs(scan.report["agreement_mm"]["bias"].get<double>()), 0.15, 0.02);
  for (const auto& check : scan.report["checks"]) {
    const bool of_lasers = check["name"] == "laser_agreement" || check["name"] == "laser_scatter";
    // Its line on the platter tells which of the two it is.
    EXPECT_EQ(check["verdict"] == "failed", of_lasers || check["name"] == "datum_laser 1") << check;
    if (of_lasers) {
      EXPECT_EQ(check["cause"], "the plane of laser 0 or 1 is no longer where it was calibrated");
    }
  }
  EXPECT_NE(scan.printed.find("agreement   laser 1 minus laser 0: 0.15"), std::string::npos) << scan.printed;
}

}  // namespace
}  // namespace celadon::testing
