// When frames are exposed, from sweeps of a board: against a machine whose every number is known.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "acquisition/calibrate/calibration_solver.h"
#include "tests/acquisition/calibrate/true_machine.h"

namespace celadon {
namespace {

using test::kDegree;
using test::Programme;
using test::seen_of;
using test::TrueMachine;

constexpr double kFast = 30 * kDegree, kSlow = 12 * kDegree;

TrueMachine rolling_machine() {
  TrueMachine machine;
  machine.timing = {-0.0123, -0.5, 14.2e-6, -0.03 * kDegree};
  return machine;
}

Programme with_passes() {
  Programme programme;
  programme.board_views = 12;
  programme.laser_views = 6;
  programme.angles = 12;
  programme.angle_step_rad = 6 * kDegree;
  programme.line_step_mm = 2;
  programme.passes = {{kFast, 4e-3}, {-kFast, 4e-3}, {kSlow, 4e-3}, {-kSlow, 4e-3}, {kFast, 1e-3}, {-kFast, 1e-3}};
  return programme;
}

/// What is known before: a stamp within a frame of 60 a second, and nothing of rows.
TimeModel assumed() {
  return {{0, 5e6}, {-0.5, 0}, {0, 1e4}};
}

CalibrationSolution solved(CalibrationInput input) {
  input.assumed_time = assumed();
  auto solution = solve_calibration(input);
  EXPECT_TRUE(solution) << solution.error();
  return solution ? *solution : CalibrationSolution{};
}

const CalibrationStep* time_step(const CalibrationSolution& solution) {
  for (const CalibrationStep& step : solution.steps) {
    if (step.name == "time") return &step;
  }
  return nullptr;
}

TEST(TimeSolver, WithoutNoiseEveryNumberIsFound) {
  // The other way round, too: the camera's stamp before or after, the table's direction, rows from below.
  for (const double sign : {1., -1.}) {
    TrueMachine machine = rolling_machine();
    machine.timing.offset_s *= sign;
    machine.timing.line_s *= sign;
    machine.direction = sign;
    const auto solution = solved(seen_of(machine, 3, with_passes(), {.drawn = false}));
    const TimeModel& time = solution.calibration.time;
    EXPECT_NEAR(time.stamp_offset_ns.value, machine.timing.offset_s * 1e9, 500);
    EXPECT_NEAR(time.exposure_factor.value, -0.5, 2e-4);
    EXPECT_NEAR(time.line_time_ns.value, machine.timing.line_s * 1e9, 1);
    const CalibrationStep* step = time_step(solution);
    ASSERT_TRUE(step);
    EXPECT_EQ(step->verdict, Verdict::good) << step->finding;
    EXPECT_NE(step->finding.find("backlash 0.03 "), std::string::npos) << step->finding;
  }
}

TEST(TimeSolver, StatesHowWellItKnows) {
  // Stamps of a pass are late by a fifth of a millisecond in common, which no corner shows.
  constexpr int kSeeds = 40;
  int covered[3] = {0, 0, 0};
  double squares[3] = {0, 0, 0}, stated[3] = {0, 0, 0};
  const TrueMachine machine = rolling_machine();
  Programme programme = with_passes();
  programme.stamp_jitter_s = 2e-4;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    const TimeModel time = solved(seen_of(machine, static_cast<std::uint64_t>(seed), programme)).calibration.time;
    const Measured found[3] = {time.stamp_offset_ns, time.exposure_factor, time.line_time_ns};
    const double truth[3] = {machine.timing.offset_s * 1e9, machine.timing.exposure_factor,
                             machine.timing.line_s * 1e9};
    for (int i = 0; i < 3; ++i) {
      const double error = found[i].value - truth[i];
      covered[i] += std::abs(error) <= 2 * found[i].u ? 1 : 0;
      squares[i] += error * error / kSeeds;
      stated[i] += found[i].u * found[i].u / kSeeds;
    }
  }
  for (int i = 0; i < 3; ++i) {
    std::printf("rms error %.4g, stated %.4g, covered %d of %d\n", std::sqrt(squares[i]), std::sqrt(stated[i]),
                covered[i], kSeeds);
    EXPECT_GE(covered[i], kSeeds * 85 / 100);
    EXPECT_LT(std::sqrt(stated[i] / squares[i]), 2);
  }
}

TEST(TimeSolver, CornersThatAreOffDoNotCount) {
  const TrueMachine machine = rolling_machine();
  CalibrationInput input = seen_of(machine, 4, with_passes());
  std::size_t k = 0;
  for (BoardSweep& sweep : input.sweeps) {
    for (MovingView& view : sweep.views) {
      for (SeenCorner& corner : view.corners) {
        if (++k % 20 == 0) corner.p_px += Eigen::Vector2d(9, 4);
      }
    }
  }
  const TimeModel time = solved(std::move(input)).calibration.time;
  EXPECT_NEAR(time.stamp_offset_ns.value, machine.timing.offset_s * 1e9, 4 * time.stamp_offset_ns.u);
  EXPECT_NEAR(time.line_time_ns.value, machine.timing.line_s * 1e9, 4 * time.line_time_ns.u);
  EXPECT_LT(time.stamp_offset_ns.u, 1e5);
}

TEST(TimeSolver, OneExposureLeavesTheFactorAssumed) {
  Programme programme = with_passes();
  programme.passes.resize(4);
  const TrueMachine machine = rolling_machine();
  const TimeModel time = solved(seen_of(machine, 5, programme)).calibration.time;
  EXPECT_EQ(time.exposure_factor, (Measured{-0.5, 0}));
  EXPECT_NEAR(time.stamp_offset_ns.value, machine.timing.offset_s * 1e9, 4 * time.stamp_offset_ns.u + 1e3);
}

TEST(TimeSolver, WhatCannotBeToldStaysAssumedAndIsSaid) {
  const TrueMachine machine = rolling_machine();
  const auto assumed_with = [&](const char* what, CalibrationInput input) {
    const auto solution = solved(std::move(input));
    const CalibrationStep* step = time_step(solution);
    ASSERT_TRUE(step) << what;
    EXPECT_EQ(step->verdict, Verdict::usable) << what << step->finding;
    EXPECT_NE(step->finding.find("not measured"), std::string::npos) << what << step->finding;
    EXPECT_NE(step->remedy.find("steps"), std::string::npos) << what;
    EXPECT_EQ(solution.calibration.time.stamp_offset_ns, assumed().stamp_offset_ns) << what;
  };
  // One speed cannot tell a late stamp from a board that stands a little turned.
  Programme one_speed = with_passes();
  one_speed.passes = {{kFast, 4e-3}, {-kFast, 4e-3}, {kFast, 4e-3}, {-kFast, 4e-3}, {-kFast, 4e-3}};
  assumed_with("one speed", seen_of(machine, 6, one_speed));
  CalibrationInput unseen = seen_of(machine, 7, with_passes());
  for (BoardSweep& sweep : unseen.sweeps) {
    for (MovingView& view : sweep.views) view.corners.clear();
  }
  assumed_with("no board", unseen);
  CalibrationInput elsewhere = seen_of(machine, 8, with_passes());
  for (BoardSweep& sweep : elsewhere.sweeps) sweep.placement += 100;
  assumed_with("another placement", elsewhere);

  CalibrationInput none = seen_of(machine, 9, with_passes());
  none.sweeps.clear();
  EXPECT_FALSE(time_step(solved(std::move(none)))) << "nobody looked";
}

}  // namespace
}  // namespace celadon
