// A whole calibration of the virtual scanner by an operator who holds boards in front of it, and a scan with it: the
// scan's errors are told by the simulator's truth, which the calibration never sees.
#include <gtest/gtest.h>

#include <csignal>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "acquisition/calibrate/calibration_solver.h"
#include "daemon/calibration/calibration_session.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

constexpr const char* kBoard = "tags:10x7x8";

/// Poses of a board in front of the camera: middle in mm, turns in degrees (sim/README.md, "Calibration targets").
std::vector<std::string> held_poses() {
  std::vector<std::string> poses;
  int i = 0;
  for (const double side : {-45., 0., 45.}) {
    for (const double z : {34., 60., 94.}) {
      for (const double near : {-30., 35.}) {
        const double tilts[][3] = {{0, 38, 35}, {0, -30, 25}, {10, 0, 60}, {-10, 38, 0}, {20, 15, 45}, {-20, -25, 15}};
        const auto& tilt = tilts[i++ % 6];
        // The camera stands 30 degrees beside the x axis.
        const double x = 0.87 * near - 0.5 * side, y = 0.5 * near + 0.87 * side;
        char text[120];
        std::snprintf(text, sizeof text, "@held:%g,%g,%g,%g,%g,%g", x, y, z, tilt[0], tilt[1], tilt[2]);
        poses.emplace_back(text);
      }
    }
  }
  return poses;
}

/// Moves boards in the simulator as a session asks for them.
class Operator final : public CalibrationGuide {
 public:
  explicit Operator(const Station& station) : station_(station), poses_(held_poses()) {}

  void ask(const std::string& instruction) override {
    asked.push_back(instruction);
    if (instruction.starts_with("Hold")) {
      hold();
    } else if (instruction.starts_with("Stand")) {
      static constexpr const char* kPlaced[] = {"@0,0,55,0,-8,30", "@14,-8,55,0,10,150", "@-10,12,55,5,-12,270"};
      place("board:" + std::string(kBoard) + kPlaced[placed_++ % 3]);
    } else {
      place("empty");
    }
  }
  bool done() override { return true; }
  void on_look(const BoardLook& look) override {
    ++looks;
    if (!look.found) ++unfound;
    std::printf("%s: %s%s %d. %s\n", poses_[pose_ % poses_.size()].c_str(), look.problem.c_str(),
                look.still ? " still" : "", look.views, look.advice.c_str());
    const bool taken = look.views > views_;
    views_ = look.views;
    if (taken || !look.found || (look.still && look.known)) {
      ++pose_;
      hold();
    }
  }
  void on_turn(int, int, int, bool found) override { seen += found ? 1 : 0; }
  std::optional<std::string> cancelled() override {
    return pose_ > 3 * poses_.size() ? std::optional<std::string>("because no pose is left") : std::nullopt;
  }

  std::vector<std::string> asked;
  int looks = 0, unfound = 0, seen = 0;

 private:
  void hold() { place("board:" + std::string(kBoard) + poses_[pose_ % poses_.size()]); }
  void place(const std::string& scene) const {
    const auto answer = ask_simulator(station_.folder.path(), "scene " + scene);
    EXPECT_EQ(answer["ok"], true) << answer;
  }

  const Station& station_;
  std::vector<std::string> poses_;
  std::size_t pose_ = 0, placed_ = 0;
  int views_ = 0;
};

TEST(Calibrating, AVirtualScannerGivesScansCloseToTheTruth) {
  Station station("cylinder-off", {"--ambient", "8", "--fps", "12"});
  auto machine = open_scanner(station.url, station.camera);
  ASSERT_TRUE(machine) << machine.error().message;
  const CalibrationPlan plan{*TargetBoard::parse(kBoard), 15, 3, 24, 4, {1, 1e-4}, {1, 1e-4}};
  Operator hand(station);
  const auto input = take_calibration_views(*machine, plan, hand);
  ASSERT_TRUE(input) << input.error().reason;
  EXPECT_EQ(hand.asked.size(), 5u);
  std::printf("%d looks, %d without a board; %zu views, %d on the platter\n", hand.looks, hand.unfound,
              input->views.size(), hand.seen);
  const auto solved = solve_calibration(*input);
  ASSERT_TRUE(solved) << solved.error();
  for (const CalibrationStep& step : solved->steps) {
    std::printf("%s: %d %s %s\n", step.name.c_str(), static_cast<int>(step.verdict), step.finding.c_str(),
                step.remedy.c_str());
  }
  EXPECT_NE(solved->verdict, Verdict::refused);
  Calibration calibration = solved->calibration;
  const auto truth = read_calibration(station.folder / "calibration.toml");
  ASSERT_TRUE(truth);
  calibration.machine = machine->device->identity().machine;
  calibration.camera = machine->camera->mode().identity;
  calibration.date = "2026-01-01T00:00:00Z";
  calibration.simulated = true;
  calibration.time = truth->time;
  std::printf("systematic %.4f mm; corners %.4f px, held out %.4f px, lines %.4f mm\n", calibration.systematic_mm,
              solved->corner_rms_px, solved->held_out_rms_px, solved->line_rms_mm);
  std::printf("%s\ntruth:\n%s\n", format_calibration(calibration).c_str(), format_calibration(*truth).c_str());
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
