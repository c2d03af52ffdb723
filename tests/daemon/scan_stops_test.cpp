// Which stops a scan makes, and what is refused before anything moves.

#include "daemon/scan_stops.h"

#include <gtest/gtest.h>

#include <numbers>
#include <vector>

#include "daemon/scan_lasers.h"
#include "tests/daemon/fake_machine.h"

namespace celadon {
namespace {

using testing::FakeMachine;

constexpr double kDegree = std::numbers::pi / 180;

Calibration with_axes() {
  Calibration c = FakeMachine().calibration(2);
  c.elevation = ElevationAxis{};
  c.lift = LiftAxis{};
  return c;
}

const AxisTravels kBoth{AxisTravel{-10, 60}, AxisTravel{0, 100}};

TEST(StopsOf, EveryElevationAtEveryHeightTheLiftMovingLeast) {
  ScanRequest request;
  const auto none = stops_of(request, with_axes(), kBoth);
  ASSERT_TRUE(none);
  EXPECT_EQ(*none, std::vector{AxisStop()});
  request.elevations_deg = {30, 0};
  request.lifts_mm = {0, 80};
  const auto all = stops_of(request, with_axes(), kBoth);
  ASSERT_TRUE(all) << all.error();
  const AxisStop low_down{30 * kDegree, 0}, high_down{30 * kDegree, 80};
  EXPECT_EQ(*all, (std::vector{low_down, AxisStop(), high_down, AxisStop{0, 80}}));
}

TEST(StopsOf, WhatMachineOrCalibrationLackIsRefusedWithTheRemedy) {
  ScanRequest request;
  request.elevations_deg = {30};
  EXPECT_EQ(stops_of(request, with_axes(), {}).error(),
            "Elevation 30 degrees was asked for, but the machine has no such axis; leave elevations_deg out.");
  Calibration without = with_axes();
  without.elevation.reset();
  EXPECT_EQ(stops_of(request, without, kBoth).error(),
            "Elevation 30 degrees was asked for, but the calibration of 2026-01-01T00:00:00Z does not hold this axis; "
            "calibrate it (celadon calibrate), or leave elevations_deg out.");
  request.elevations_deg = {30, 60.5};
  EXPECT_EQ(stops_of(request, with_axes(), kBoth).error(),
            "Elevation 60.5 degrees was asked for, but the axis goes from -10 to 60 degrees; choose within.");
  request.elevations_deg = {-10, 60};
  EXPECT_TRUE(stops_of(request, with_axes(), kBoth));
  request.lifts_mm = {-1};
  EXPECT_EQ(stops_of(request, with_axes(), kBoth).error(),
            "Lift -1 mm was asked for, but the axis goes from 0 to 100 mm; choose within.");
}

TEST(StopsOf, ARecordingHasItsOwn) {
  RecordedScan recorded;
  EXPECT_EQ(*stops_of(recorded, with_axes()), std::vector{AxisStop()});
  recorded.stops = {{0, 0}, {0.25, 0}};
  EXPECT_EQ(*stops_of(recorded, with_axes()), recorded.stops);
  Calibration without = with_axes();
  without.elevation.reset();
  EXPECT_EQ(stops_of(recorded, without).error(),
            "The recording was made at elevation 14.32 degrees, but the calibration of 2026-01-01T00:00:00Z does not "
            "hold that axis; give the calibration of that machine.");
}

TEST(Turns, AreWithEachLaserAtEachStop) {
  const Calibration c = with_axes();
  const std::vector<int> lasers = {1, 0};
  const std::vector<AxisStop> stops = {{0, 0}, {0.25, 10}};
  std::vector<LaserTurn> turns = turns_with(std::vector<LaserExposures>{{1, {}}, {0, {}}}, stops, c, {});
  ASSERT_EQ(turns.size(), 4u);
  for (std::size_t k = 0; k < 4; ++k) {
    EXPECT_EQ(turns[k].laser, lasers[k % 2]);
    EXPECT_EQ(turns[k].stop, stops[k / 2]);
  }
  const auto second = turns_at(1, turns);
  ASSERT_EQ(second.size(), 2u);
  EXPECT_EQ(second.data(), &turns[2]);
}

TEST(TextOf, SaysWhatIsNot0) {
  EXPECT_EQ(text_of({}), "");
  EXPECT_EQ(text_of({30 * kDegree, 0}), "elevation 30.00 degrees");
  EXPECT_EQ(text_of({0, 12.5}), "lift 12.50 mm");
  EXPECT_EQ(text_of({-5 * kDegree, 12.5}), "elevation -5.00 degrees, lift 12.50 mm");
}

}  // namespace
}  // namespace celadon
