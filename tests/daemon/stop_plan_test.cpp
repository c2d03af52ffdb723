// At which stops of head and lift a calibration looks at its board.

#include "daemon/calibration/stop_plan.h"

#include <gtest/gtest.h>

#include <numbers>
#include <set>
#include <vector>

namespace celadon {
namespace {

constexpr double kDegreeOfHead = std::numbers::pi / 180;

DeviceCapabilities machine_with(double lowest_deg, double highest_deg, double lowest_mm, double highest_mm) {
  DeviceCapabilities out;
  out.elevation = AxisLimits{lowest_deg * kDegreeOfHead, highest_deg * kDegreeOfHead, 1, 1, 1e-5};
  out.lift = AxisLimits{lowest_mm, highest_mm, 1, 1, 1e-3};
  return out;
}

TEST(StopPlan, OneAxisAtATimeUpwardsThroughTheTravel) {
  const std::vector<AxisStop> stops = stops_to_visit(machine_with(-10, 70, -150, 150), 4, 0, 1, 30);
  ASSERT_EQ(stops.size(), 8u);
  // A quarter into four equal parts of -30 ... 30 mm and of -10 ... 70 degrees.
  const double heights_mm[] = {-26.25, -11.25, 3.75, 18.75}, elevations_deg[] = {-5, 15, 35, 55};
  for (std::size_t k = 0; k < 4; ++k) {
    EXPECT_EQ(stops[k].elevation_rad, 0);
    EXPECT_NEAR(stops[k].lift_mm, heights_mm[k], 1e-12);
    EXPECT_NEAR(stops[4 + k].elevation_rad / kDegreeOfHead, elevations_deg[k], 1e-12);
    EXPECT_EQ(stops[4 + k].lift_mm, 0);
  }
}

TEST(StopPlan, NeverLeavesTheTravelAndNoTwoPlacementsShareAStop) {
  const DeviceCapabilities machine = machine_with(-20, 160, -5, 400);
  std::set<double> elevations, heights;
  for (int placement = 0; placement < 3; ++placement) {
    for (const AxisStop& stop : stops_to_visit(machine, 7, placement, 3, 40)) {
      EXPECT_GT(stop.elevation_rad, -20.001 * kDegreeOfHead);
      EXPECT_LT(stop.elevation_rad, 75.001 * kDegreeOfHead) << "a board on the platter is seen from there";
      EXPECT_GE(stop.lift_mm, -5);
      EXPECT_LE(stop.lift_mm, 40);
      if (stop.lift_mm == 0) elevations.insert(stop.elevation_rad);
      if (stop.elevation_rad == 0) heights.insert(stop.lift_mm);
    }
  }
  EXPECT_EQ(elevations.size(), 21u);
  EXPECT_EQ(heights.size(), 21u);
}

TEST(StopPlan, ThereAreNoneWithoutAxesOrWhenNoneIsAskedFor) {
  EXPECT_TRUE(stops_to_visit(DeviceCapabilities(), 8, 0, 3, 30).empty());
  EXPECT_TRUE(stops_to_visit(machine_with(-10, 70, -150, 150), 0, 0, 3, 30).empty());
  DeviceCapabilities lift_only;
  lift_only.lift = AxisLimits{0, 100, 1, 1, 1e-3};
  const auto stops = stops_to_visit(lift_only, 5, 0, 1, 30);
  ASSERT_EQ(stops.size(), 5u);
  for (const AxisStop& stop : stops) EXPECT_EQ(stop.elevation_rad, 0);
}

}  // namespace
}  // namespace celadon
