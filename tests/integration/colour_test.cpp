// Colours of a painted object, scanned by a colour camera through the daemon, against the simulator's painting.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "tests/daemon/ply_points.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr double kTurn = 2 * std::numbers::pi;

std::vector<std::string> machine(const std::string& format, const std::string& ambient) {
  return {"--paint", "sectors",  "--format", format,  "--ambient", ambient,         "--width",
          "640",     "--height", "512",      "--fps", "30",        "--line-levels", "250"};
}

fs::path scan_to(const Station& station, const std::string& name, const std::string& profiles,
                 const std::vector<std::string>& more) {
  const fs::path out = station.folder / name;
  std::vector<std::string> command = {"celadon", "scan", "--server", station.server(), "--mode", "step", "--profiles",
                                      profiles,  "-o",   out};
  command.insert(command.end(), more.begin(), more.end());
  const auto outcome = run(command);
  EXPECT_LE(outcome.exit_code, 1) << outcome.err;
  return out;
}

json report_in(const fs::path& folder) {
  return json::parse(read_file(folder / "report.json"));
}

/// A sample's colour as shares of its own sum: how brightly a place is lit falls out.
std::array<double, 3> hue(const std::array<double, 3>& c) {
  const double sum = c[0] + c[1] + c[2];
  return {c[0] / sum, c[1] / sum, c[2] / sum};
}

TEST(Colour, SamplesHaveThePaintThatTheyLieOn) {
  Station station("cylinder", machine("yuyv", "6"));
  station.start_daemon();
  const fs::path out = scan_to(station, "out", "72", {"--formats", "ply"});
  const json report = report_in(out);
  const auto cloud = read_ply_points(read_file(out / "object-samples.ply"));
  const std::size_t n = cloud.at("x").size();
  EXPECT_EQ(report["points"].get<std::size_t>(), n);
  EXPECT_GT(report["coloured"].get<double>(), 0.97 * static_cast<double>(n));

  // The room's light as a white surface shows it, and the black level, are constants of the simulated camera; the black
  // level tints dark places, so that brightness is compared with it taken off.
  const std::array<double, 3> room{1, 0.9, 0.8};
  constexpr double kBlack = 4, kOff = 0.06;
  std::array<double, 3> worst{}, squares{};
  std::size_t inside = 0, beside = 0;
  double mixed_mm = 0;  // how far from an edge colours of two sectors are mixed
  for (std::size_t i = 0; i < n; ++i) {
    const std::array<double, 3> found{cloud.at("red")[i], cloud.at("green")[i], cloud.at("blue")[i]};
    if (found[0] + found[1] + found[2] == 0) continue;
    const double theta = std::atan2(cloud.at("y")[i], cloud.at("x")[i]),
                 r = std::hypot(cloud.at("x")[i], cloud.at("y")[i]);
    const double sectors = (theta < 0 ? theta + kTurn : theta) / (kTurn / 3);
    const double edge_mm = std::min(sectors - std::floor(sectors), std::ceil(sectors) - sectors) * kTurn / 3 * r;
    const bool far = edge_mm > 4.5;  // windows end 4 s + 2 + 5 px from the line; 0.5 mm of the paint's own edge
    if (far && i % 37 != 0) continue;
    const json truth =
        ask_simulator(station.folder.path(), "truth " + std::to_string(theta) + " " + std::to_string(cloud.at("z")[i]));
    // Above the rim, and stray light that was taken for the line.
    if (!truth.value("ok", false) || std::abs(r - truth["r_mm"].get<double>()) > 1) continue;
    std::array<double, 3> wanted{}, lit{};
    for (std::size_t c = 0; c < 3; ++c) {
      wanted[c] = truth["reflectance"][c].get<double>() * room[c];
      lit[c] = std::max(found[c] - kBlack, 1.);
    }
    const auto a = hue(lit), b = hue(wanted);
    double off = 0;
    for (std::size_t c = 0; c < 3; ++c) off = std::max(off, std::abs(a[c] - b[c]));
    if (far) {
      ++inside;
      for (std::size_t c = 0; c < 3; ++c) {
        worst[c] = std::max(worst[c], std::abs(a[c] - b[c]));
        squares[c] += (a[c] - b[c]) * (a[c] - b[c]);
      }
    } else {
      ++beside;
      if (off > kOff) mixed_mm = std::max(mixed_mm, edge_mm);
    }
  }
  ASSERT_GT(inside, 300u);
  std::printf(
      "%zu samples inside sectors: shares of red, green, blue off by rms %.4f %.4f %.4f, at most %.4f %.4f %.4f; mixed "
      "up to %.2f mm from an edge\n",
      inside, std::sqrt(squares[0] / static_cast<double>(inside)), std::sqrt(squares[1] / static_cast<double>(inside)),
      std::sqrt(squares[2] / static_cast<double>(inside)), worst[0], worst[1], worst[2], mixed_mm);
  for (std::size_t c = 0; c < 3; ++c) EXPECT_LT(worst[c], kOff) << c;
  EXPECT_GT(beside, 100u);
  EXPECT_GT(mixed_mm, 1) << "windows lie on both sides of an edge";

  // The log fits again as ever, and the cloud is a cloud.
  fs::path log;
  for (const auto& entry : fs::recursive_directory_iterator(station.folder / "store"))
    if (entry.path().filename() == "profiles.log") log = entry.path();
  const auto again = run({"celadon", "fit", log, "-o", station.folder / "again.stl"});
  EXPECT_EQ(again.exit_code, 0) << again.err;
  const auto of_cloud =
      run({"celadon", "fit", out / "object-samples.ply", "--unit", "mm", "-o", station.folder / "cloud.stl"});
  EXPECT_EQ(of_cloud.exit_code, 0) << of_cloud.err;
}

// The same frames from a recording give the same files.
TEST(Colour, ARecordingOfYuyvFramesHasTheSameColours) {
  Station station("cylinder", machine("yuyv", "6"));
  station.start_daemon({"--record", station.folder / "recorded"});
  const fs::path out = scan_to(station, "out", "24", {"--shape", "none"});
  station.daemon.reset();
  fs::path recording;
  for (const auto& entry : fs::recursive_directory_iterator(station.folder / "recorded"))
    if (entry.path().filename() == "index.csv") recording = entry.path().parent_path();
  ASSERT_FALSE(recording.empty());
  EXPECT_NE(read_file(recording / "index.csv").find("\nyuv,601,full\n"), std::string::npos);
  Program replayed({"celadond", "--camera", "replay:" + recording.string(), "--calibration",
                    station.folder / "calibration.toml", "--store", station.folder / "again", "--http", "0",
                    "--unix-socket", station.folder / "again.sock"});
  ASSERT_TRUE(replayed.wait_for_output("\n"));
  const auto outcome = run({"celadon", "scan", "--server", "unix:" + (station.folder / "again.sock").string(),
                            "--shape", "none", "-o", station.folder / "replayed"});
  ASSERT_LE(outcome.exit_code, 1) << outcome.err;
  const std::string cloud = read_file(out / "object-samples.ply");
  EXPECT_GT(cloud.size(), 10'000u);
  EXPECT_EQ(cloud, read_file(station.folder / "replayed" / "object-samples.ply"));
}

TEST(Colour, AGreyCameraHasNoneAndADarkRoomIsSaid) {
  Station grey("cylinder", machine("grey", "6"));
  grey.start_daemon();
  const fs::path out = scan_to(grey, "out", "24", {"--shape", "none"});
  EXPECT_FALSE(fs::exists(out / "object-samples.ply"));
  EXPECT_FALSE(report_in(out).contains("coloured"));
  const std::string log = read_file(out / "profiles.log");
  EXPECT_EQ(log[10], 2) << "the version that grey logs always had";
  EXPECT_EQ(log.find("\"colour\""), std::string::npos);

  Station dark("cylinder", machine("yuyv", "0"));
  dark.start_daemon();
  const fs::path night = scan_to(dark, "out", "24", {"--shape", "none"});
  EXPECT_FALSE(fs::exists(night / "object-samples.ply"));
  EXPECT_EQ(report_in(night)["coloured"], 0);
  EXPECT_EQ(read_file(night / "profiles.log")[10], 3);
}

}  // namespace
}  // namespace celadon::testing
