// A scan by stereo with real processes: no laser shines, the fit is as good as the samples, and what cannot be matched
// is said.

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

const std::vector<std::string> kSmall = {"--width", "640", "--height", "512"};

std::vector<std::string> small_and(std::vector<std::string> more) {
  more.insert(more.end(), kSmall.begin(), kSmall.end());
  return more;
}

Outcome scan_by(const Station& station, const std::string& method, const std::string& profiles,
                const std::filesystem::path& out) {
  return run({"celadon", "scan", "--server", station.server(), "--method", method, "--profiles", profiles, "--formats",
              "surface.json", "-o", out});
}

json check_named(const json& report, const std::string& name) {
  for (const auto& check : report["checks"]) {
    if (check["name"] == name) return check;
  }
  return nullptr;
}

// Stereo wants a good lamp, a laser none.
TEST(StereoScan, MeasuresWhatTheLaserMeasures) {
  Station station("vase", small_and({"--texture", "3", "--ambient", "6"}));
  station.start_daemon();
  const auto stereo = scan_by(station, "stereo", "60", station.folder / "stereo");
  Station dim("vase", small_and({"--texture", "3"}));
  dim.start_daemon();
  const auto laser = scan_by(dim, "laser", "240", station.folder / "laser");
  ASSERT_EQ(laser.exit_code, 0) << laser.err;
  ASSERT_EQ(stereo.exit_code, 0) << stereo.err << stereo.out;
  const json by_laser = json::parse(read_file(station.folder / "laser" / "report.json")),
             by_stereo = json::parse(read_file(station.folder / "stereo" / "report.json"));
  std::printf("laser %s\nstereo %s\n%s\n", by_laser["truth_mm"].dump().c_str(), by_stereo["truth_mm"].dump().c_str(),
              by_stereo["stereo"].dump().c_str());

  EXPECT_LT(std::abs(by_stereo["truth_mm"]["bias"].get<double>()), 0.02);
  EXPECT_LT(by_stereo["truth_mm"]["rms"].get<double>(), 0.04);
  EXPECT_GT(by_stereo["coverage"].get<double>(), 0.95);
  EXPECT_EQ(by_stereo["stereo"]["pairs"], 60);
  const json& windows = by_stereo["stereo"];
  EXPECT_EQ(by_stereo["points"].get<int>(),
            windows["found"].get<int>() - windows["outside"].get<int>() - windows["standing"].get<int>());
  EXPECT_FALSE(by_laser.contains("stereo"));
  EXPECT_EQ(check_named(by_stereo, "closure")["verdict"], "not verifiable");
  for (const auto& check : by_stereo["checks"]) EXPECT_NE(check["verdict"], "failed") << check;
  expect_safe(station);

  // The log holds the samples for another fit.
  const auto fit = run({"celadon", "fit", station.folder / "store" / "scans" / "000001" / "profiles.log", "--report",
                        station.folder / "again.json", "-o", station.folder / "again.surface.json"});
  ASSERT_EQ(fit.exit_code, 0) << fit.err;
  EXPECT_EQ(json::parse(read_file(station.folder / "again.json"))["points"], by_stereo["points"]);
}

TEST(StereoScan, ASurfaceWithoutTextureIsNamed) {
  Station station("vase", small_and({"--ambient", "6"}));
  station.start_daemon();
  const auto outcome = scan_by(station, "stereo", "60", station.folder / "out");
  EXPECT_EQ(outcome.exit_code, 3);
  EXPECT_NE(outcome.err.find("too little texture"), std::string::npos) << outcome.err;
  expect_safe(station);
}

TEST(StereoScan, AnOverexposedPictureIsNamed) {
  Station station("vase", small_and({"--texture", "3", "--ambient", "90"}));
  station.start_daemon();
  const auto outcome = scan_by(station, "stereo", "60", station.folder / "out");
  EXPECT_EQ(outcome.exit_code, 3);
  EXPECT_NE(outcome.err.find("is saturated; expose for a shorter time"), std::string::npos) << outcome.err;
  expect_safe(station);
}

TEST(StereoScan, WhatItCannotDoIsRefused) {
  Station station("vase", small_and({}));
  station.start_daemon();
  const auto refusal = [&](const std::vector<std::string>& more) {
    std::vector<std::string> command{"celadon", "scan", "--server", station.server(), "--method", "stereo"};
    command.insert(command.end(), more.begin(), more.end());
    const auto outcome = run(command);
    EXPECT_EQ(outcome.exit_code, 2);
    return outcome.err;
  };
  EXPECT_NE(refusal({"--mode", "sweep"}).find("give step with the method stereo"), std::string::npos);
  EXPECT_NE(refusal({"--profiles", "20"}).find("from 36 to 720"), std::string::npos);
  EXPECT_NE(refusal({"--lasers", "0"}).find("no lasers with the method stereo"), std::string::npos);
  EXPECT_NE(refusal({"--dry-turn"}).find("no dry turn"), std::string::npos);
  EXPECT_NE(refusal({"--lifts", "0,20"}).find("no heights"), std::string::npos);
  EXPECT_EQ(station.state()["motion"], "unhomed");
}

}  // namespace
}  // namespace celadon::testing
