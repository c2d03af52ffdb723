// A whole calibration of the virtual scanner by an operator who holds boards in front of it, and a scan with it: the
// scan's errors are told by the simulator's truth, which the calibration never sees.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "acquisition/calibrate/calibration_solver.h"
#include "daemon/calibration/calibration_session.h"
#include "tests/integration/board_operator.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

constexpr const char* kBoard = "tags:10x7x8";

void expect_within(const char* what, const Measured& found, double truth, double largest_u) {
  std::printf("%s: %.6g, truth %.6g, u %.3g\n", what, found.value, truth, found.u);
  EXPECT_NEAR(found.value, truth, 3 * found.u) << what;
  EXPECT_LT(found.u, largest_u) << what;
}

TEST(Calibrating, AVirtualScannerGivesScansCloseToTheTruth) {
  Station station("cylinder-off", {"--ambient", "8", "--fps", "12", "--encoder-eccentricity", "120"});
  auto machine = open_scanner(station.url, station.camera);
  ASSERT_TRUE(machine) << machine.error().message;
  const CalibrationPlan plan{*TargetBoard::parse(kBoard), 15, 3, 24, 4, {1, 1e-4}, {1, 1e-4}, 8, 0};
  BoardOperator hand(station, kBoard, {"@0,0,55,0,-8,30", "@14,-8,55,0,10,150", "@-10,12,55,5,-12,270"});
  const auto input = take_calibration_views(*machine, plan, hand);
  ASSERT_TRUE(input) << input.error().reason;
  EXPECT_EQ(hand.asked.size(), 5u);
  ASSERT_EQ(hand.table_deg.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(std::remainder(hand.table_deg[i] - 120. * static_cast<double>(i), 360), 0, 0.3) << i;
  }
  std::printf("%d looks, %d without a board; %zu views, %d on the platter\n", hand.looks, hand.unfound,
              input->views.size(), hand.seen);
  const auto solved = solve_calibration(*input);
  ASSERT_TRUE(solved) << solved.error();
  print_steps(*solved);
  EXPECT_NE(solved->verdict, Verdict::refused);
  const auto truth = read_calibration(station.folder / "calibration.toml");
  ASSERT_TRUE(truth);
  const Calibration calibration = for_scans(solved->calibration, *machine);
  std::printf("systematic %.4f mm; corners %.4f px, held out %.4f px, lines %.4f mm\n", calibration.systematic_mm,
              solved->corner_rms_px, solved->held_out_rms_px, solved->line_rms_mm);
  std::printf("%s\ntruth:\n%s\n", format_calibration(calibration).c_str(), format_calibration(*truth).c_str());
  expect_within("encoder, cosine, rad", calibration.encoder.cos_rad, truth->encoder.cos_rad.value, 1e-4);
  expect_within("encoder, sine, rad", calibration.encoder.sin_rad, truth->encoder.sin_rad.value, 1e-4);
  EXPECT_GT(std::abs(truth->encoder.cos_rad.value), 1e-3);
  machine->device.reset();
  machine = tl::make_unexpected(ConnectError{});  // the machine is the daemon's now

  station.folder.write("calibration.toml", format_calibration(calibration));
  ask_simulator(station.folder.path(), "scene cylinder-off");
  station.start_daemon();
  const auto scanned = run({"celadon", "scan", "--server", station.server(), "--mode", "step", "--profiles", "60",
                            "--json", "-o", station.folder / "out"});
  ASSERT_EQ(scanned.exit_code, 0) << scanned.err;
  const auto report = nlohmann::json::parse(read_file(station.folder / "out" / "report.json"));
  std::printf("%s\n", report["truth_mm"].dump().c_str());
  EXPECT_EQ(report["solid"]["valid"], true);
  EXPECT_LT(report["truth_mm"]["rms"].get<double>(), 3 * calibration.systematic_mm);
}

TEST(Calibrating, WhenRowsAreExposedIsThatOfTheTruth) {
  Station station("empty", {"--ambient", "8", "--fps", "6", "--shutter", "rolling", "--width", "960", "--height", "768",
                            "--backlash", "0.2"});
  auto machine = open_scanner(station.url, station.camera);
  ASSERT_TRUE(machine) << machine.error().message;
  const CalibrationPlan plan{*TargetBoard::parse("tags:10x7x10"), 7, 1, 16, 4, {1, 1e-4}, {1, 1e-4}, 8, 1};
  BoardOperator hand(station, "tags:10x7x10", {"@0,0,55,0,-8,30"}, 10);
  const auto input = take_calibration_views(*machine, plan, hand);
  ASSERT_TRUE(input) << input.error().reason;
  EXPECT_EQ(input->sweeps.size(), 6u);
  EXPECT_GT(hand.seen_passing, 40);
  const auto solved = solve_calibration(*input);
  ASSERT_TRUE(solved) << solved.error();
  print_steps(*solved);
  const auto truth = read_calibration(station.folder / "calibration.toml");
  ASSERT_TRUE(truth);
  const TimeModel &found = solved->calibration.time, &is = truth->time;
  ASSERT_GT(is.line_time_ns.value, 1e4);
  expect_within("stamp offset, ns", found.stamp_offset_ns, is.stamp_offset_ns.value, 4e5);
  expect_within("exposure factor", found.exposure_factor, is.exposure_factor.value, 0.15);
  expect_within("line time, ns", found.line_time_ns, is.line_time_ns.value, 600);
  const auto time = std::find_if(solved->steps.begin(), solved->steps.end(),
                                 [](const CalibrationStep& step) { return step.name == "time"; });
  ASSERT_NE(time, solved->steps.end());
  EXPECT_NE(time->finding.find("backlash 0.2"), std::string::npos) << time->finding;
  expect_safe(station);
}

TEST(CalibrateCommand, WrongInputIsNamedBeforeAnythingMoves) {
  const Station station("empty");
  const std::string taken = station.folder.write("taken.toml", "");
  const auto told = [&](const std::vector<std::string>& more, const std::string& output) {
    std::vector<std::string> words = {"celadon",  "calibrate",    "--device", station.url,
                                      "--camera", station.camera, "-o",       output};
    words.insert(words.end(), more.begin(), more.end());
    const auto outcome = run(words);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.out << outcome.err;
    return outcome.err;
  };
  const std::string output = station.folder / "out.toml";
  EXPECT_NE(told({}, taken).find("taken.toml exists"), std::string::npos);
  EXPECT_NE(told({"--board", "circles:3x4x5"}, output).find("--board circles:3x4x5"), std::string::npos);
  EXPECT_NE(told({"--board", "tags:10x7x8", "--width", "120"}, output).find("should be 80 x 56 mm"), std::string::npos);
  EXPECT_NE(told({"--views", "2"}, output).find("--views"), std::string::npos);
  EXPECT_EQ(station.state()["motion"], "unhomed") << "nothing moved";
}

TEST(CalibrateCommand, InterruptedItLeavesTheMachineSafeAndNoFile) {
  const Station station("empty");
  Program program(
      {"celadon", "calibrate", "--device", station.url, "--camera", station.camera, "-o", station.folder / "out.toml"});
  ASSERT_TRUE(program.wait_for_output("> Hold the board")) << program.wait().err;
  program.signal(SIGINT);
  const auto outcome = program.wait();
  EXPECT_EQ(outcome.exit_code, 130) << outcome.err;
  EXPECT_FALSE(std::filesystem::exists(station.folder / "out.toml"));
  expect_safe(station);
}

}  // namespace
}  // namespace celadon::testing
