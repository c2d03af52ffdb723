#include "daemon/calibration/stop_plan.h"

#include <algorithm>
#include <numbers>

namespace celadon {
namespace {

/// Beyond, a board that stands on the platter shows its face to nobody.
constexpr double kSteepest_rad = 75 * std::numbers::pi / 180;

}  // namespace

std::vector<AxisStop> stops_to_visit(const DeviceCapabilities& machine, int stops, int placement, int placements,
                                     double reach_mm) {
  // A quarter: a travel that is the same to both sides has no stop at 0, where nothing is learned.
  const double moved = (placement + 0.25) / placements;
  const auto spread = [&](const AxisLimits& axis, double reach, int k) {
    const double lowest = std::max(axis.lowest, -reach), highest = std::min(axis.highest, reach);
    return lowest + (k + moved) * (highest - lowest) / stops;
  };
  std::vector<AxisStop> out;
  for (int k = 0; machine.lift && k < stops; ++k) out.push_back({0, spread(*machine.lift, reach_mm, k)});
  for (int k = 0; machine.elevation && k < stops; ++k) out.push_back({spread(*machine.elevation, kSteepest_rad, k), 0});
  return out;
}

}  // namespace celadon
