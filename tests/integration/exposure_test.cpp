// Scans of a virtual scanner whose object is painted dark in places: exposures by the line's own peaks, and two turns
// where one is not enough, against the simulator's truth.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

struct ExposedScan {
  json report;
  std::string printed;
};

ExposedScan scan_exposed(const Station& station, const std::string& exposure, const std::string& mode = "sweep") {
  const std::filesystem::path out = station.folder / ("by-" + exposure + mode);
  const auto outcome = run({"celadon", "scan", "--server", station.server(), "--exposure", exposure, "--mode", mode,
                            "--profiles", "180", "--formats", "surface.json", "-o", out});
  EXPECT_LE(outcome.exit_code, 1) << outcome.err;  // 1: a check failed, or there is no surface of so little
  if (!std::filesystem::exists(out / "report.json")) return {nullptr, outcome.err};
  return {json::parse(read_file(out / "report.json")), outcome.out};
}

Station painted(const std::string& paint) {
  return Station("vase-squeezed", {"--paint", paint, "--width", "640", "--height", "512", "--line-levels", "600"});
}

void print_result(const std::string& what, const json& report) {
  std::printf("%s: covered %.1f %%, rms %.1f, largest %.1f micrometres; failed checks:", what.c_str(),
              100 * report["coverage"].get<double>(), 1e3 * report["truth_mm"]["rms"].get<double>(),
              1e3 * report["truth_mm"]["max"].get<double>());
  for (const json& check : report["checks"]) {
    if (check["verdict"] == "failed") std::printf(" %s", check["name"].get<std::string>().c_str());
  }
  std::printf("\n");
}

double rms_mm(const json& report) {
  return report["truth_mm"]["rms"].get<double>();
}

int failed_checks(const json& report) {
  return static_cast<int>(std::count_if(report["checks"].begin(), report["checks"].end(),
                                        [](const json& check) { return check["verdict"] == "failed"; }));
}

TEST(Exposure, ADarkThirdIsCoveredByAutoAndNotByAFixedOne) {
  Station station = painted("third:0.03");
  station.start_daemon();
  const json fixed = scan_exposed(station, "1").report;
  EXPECT_TRUE(fixed.is_null() || fixed["coverage"] < 0.75) << fixed;
  // Again where the table stands then: on the dark third.
  for (const char* mode : {"sweep", "step", "sweep"}) {
    const ExposedScan found = scan_exposed(station, "auto", mode);
    ASSERT_FALSE(found.report.is_null());
    print_result(std::string("a dark third, auto, ") + mode, found.report);
    EXPECT_GT(found.report["coverage"], 0.98) << mode;
    EXPECT_LT(std::abs(found.report["truth_mm"]["bias"].get<double>()), 0.02) << mode << found.report["truth_mm"];
    EXPECT_LT(rms_mm(found.report), 0.03) << mode << found.report["truth_mm"];
    EXPECT_LT(found.report["truth_mm"]["max"], 0.4) << mode << found.report["truth_mm"];
    const bool swept = mode == std::string("sweep");
    EXPECT_EQ(found.report["exposures"]["bracketed"], swept);
    EXPECT_EQ(found.report["exposures"]["turns"].back()["stretches"].size(), 2u) << found.report["exposures"];
    EXPECT_NE(found.printed.find("by the line's peaks"), std::string::npos) << found.printed;
    expect_safe(station);
  }
}

TEST(Exposure, BrightAndDarkBandsAreCoveredByTwoTurnsAndAsAccurately) {
  Station plain = painted("none");
  plain.start_daemon();
  const json even = scan_exposed(plain, "1").report;

  Station station = painted("bands:0.03");
  station.start_daemon();
  const json found = scan_exposed(station, "auto").report;
  ASSERT_FALSE(found.is_null() || even.is_null());
  print_result("one colour, 1 ms", even);
  print_result("bands, auto", found);
  EXPECT_EQ(found["exposures"]["bracketed"], true);
  ASSERT_EQ(found["lasers"].size(), 2u);
  EXPECT_GT(found["coverage"], 0.98);
  EXPECT_EQ(failed_checks(found), 0) << found["checks"];
  EXPECT_LT(rms_mm(found), 1.3 * rms_mm(even)) << found["truth_mm"] << even["truth_mm"];

  // Neither of its two exposures does it alone.
  const auto exposure_of = [&](std::size_t turn) {
    return std::to_string(found["exposures"]["turns"][turn]["stretches"][0]["exposure_ms"].get<double>());
  };
  const json shorter = scan_exposed(station, exposure_of(0)).report,
             longer = scan_exposed(station, exposure_of(1)).report;
  if (!shorter.is_null()) print_result("bands, the shorter exposure", shorter);
  if (!longer.is_null()) print_result("bands, the longer exposure", longer);
  EXPECT_TRUE(shorter.is_null() || shorter["coverage"] < 0.75) << shorter;
  EXPECT_TRUE(longer.is_null() || longer["coverage"] < 0.9 || rms_mm(longer) > 1.2 * rms_mm(found)) << longer;
}

TEST(Exposure, WhatNoExposureReachesIsSaid) {
  Station station("cylinder", {"--paint", "third:0.004", "--width", "640", "--height", "512"});
  station.start_daemon();
  const ExposedScan found = scan_exposed(station, "auto");
  EXPECT_NE(found.printed.find("matting spray"), std::string::npos) << found.printed;
  EXPECT_NE(found.printed.find("slower frame rate"), std::string::npos) << found.printed;
}

TEST(Exposure, FaultsInTheQuickTurnsEndTheScanSafely) {
  for (const char* fault : {"drop-frame,5", "interlock-open", "laser-dead"}) {
    Station station("cylinder", {"--paint", "third:0.05", "--width", "640", "--height", "512", "--fault",
                                 std::string(fault) + "@4"});
    station.start_daemon();
    const auto outcome = run(
        {"celadon", "scan", "--server", station.server(), "--exposure", "auto", "--profiles", "96", "--shape", "none"});
    EXPECT_EQ(outcome.exit_code, std::string(fault).starts_with("drop") ? 0 : 3) << fault << outcome.err;
    EXPECT_TRUE(laser_off(station.state())) << fault;
    EXPECT_EQ(station.state()["motor_speed_rad_per_s"], 0.0) << fault;
  }
}

}  // namespace
}  // namespace celadon::testing
