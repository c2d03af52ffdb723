#pragma once
// An operator of the virtual scanner: puts boards where a calibration asks for them.

#include <gtest/gtest.h>

#include <cstdio>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "daemon/calibration/calibration_session.h"
#include "daemon/scan_stops.h"
#include "tests/integration/held_poses.h"
#include "tests/integration/station.h"

namespace celadon::testing {

/// Moves boards in the simulator as a session asks for them.
class BoardOperator : public CalibrationGuide {
 public:
  /// @param placements poses of the board on the platter, one after the other
  BoardOperator(const Station& station, std::string board, std::vector<std::string> placements, double raised_mm = 0)
      : station_(station),
        board_(std::move(board)),
        poses_(held_poses(raised_mm)),
        placements_(std::move(placements)) {}

  void ask(const std::string& instruction) override {
    asked.push_back(instruction);
    if (instruction.starts_with("Hold")) {
      hold();
    } else if (instruction.starts_with("Stand")) {
      table_deg.push_back(station_.state()["angle_rad"].get<double>() * 180 / std::numbers::pi);
      place("board:" + board_ + placements_[placed_++ % placements_.size()]);
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
  void on_passes(int placement, int frames) override {
    std::printf("placement %d: %d frames of the turning table\n", placement + 1, frames);
    seen_passing += frames;
  }
  void on_stop(int placement, const AxisStop& stop, bool found) override {
    std::printf("placement %d, %s: %s\n", placement + 1, text_of(stop).c_str(), found ? "seen" : "not seen");
    seen_at_stops += found ? 1 : 0;
  }
  std::optional<std::string> cancelled() override {
    return pose_ > 3 * poses_.size() ? std::optional<std::string>("because no pose is left") : std::nullopt;
  }

  std::vector<std::string> asked;
  std::vector<double> table_deg;  ///< where the table stood when a board was to be stood on it
  int looks = 0, unfound = 0, seen = 0, seen_passing = 0, seen_at_stops = 0;

 private:
  void hold() { place("board:" + board_ + poses_[pose_ % poses_.size()]); }
  void place(const std::string& scene) const {
    const auto answer = ask_simulator(station_.folder.path(), "scene " + scene);
    EXPECT_EQ(answer["ok"], true) << answer;
  }

  const Station& station_;
  std::string board_;
  std::vector<std::string> poses_, placements_;
  std::size_t pose_ = 0, placed_ = 0;
  int views_ = 0;
};

inline void print_steps(const CalibrationSolution& solved) {
  for (const CalibrationStep& step : solved.steps) {
    std::printf("%s: %d %s %s\n", step.name.c_str(), static_cast<int>(step.verdict), step.finding.c_str(),
                step.remedy.c_str());
  }
}

/// With the names of the machine that scans with it.
inline Calibration for_scans(Calibration solved, const ScannerConnection& machine) {
  solved.machine = machine.device->identity().machine;
  solved.camera = machine.camera->mode().identity;
  solved.date = "2026-01-01T00:00:00Z";
  solved.simulated = true;
  return solved;
}

}  // namespace celadon::testing
