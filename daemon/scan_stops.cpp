#include "daemon/scan_stops.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <optional>

#include "daemon/frame_feed.h"

namespace celadon {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.6g", value);
  return text;
}

/// How an axis is spoken of.
struct AxisWords {
  const char* name;
  const char* unit;
  const char* field;
};
constexpr AxisWords kElevation{"Elevation", "degrees", "elevations_deg"}, kLift{"Lift", "mm", "lifts_mm"};

/// Why a position cannot be taken; nullopt: it can.
std::optional<std::string> refusal(const AxisWords& words, double asked, bool calibrated,
                                   const std::optional<AxisTravel>& travel, const std::string& date) {
  const std::string begin = std::string(words.name) + " " + number(asked) + " " + words.unit + " was asked for, but ";
  if (!travel) return begin + "the machine has no such axis; leave " + words.field + " out.";
  if (!calibrated) {
    return begin + "the calibration of " + date +
           " does not hold this axis; calibrate it (celadon calibrate), or leave " + words.field + " out.";
  }
  if (!(asked >= travel->lowest && asked <= travel->highest)) {
    return begin + "the axis goes from " + number(travel->lowest) + " to " + number(travel->highest) + " " +
           words.unit + "; choose within.";
  }
  return std::nullopt;
}

bool needs_home(const AxisStatus& axis) {
  return !axis.homed || axis.motion == MotionState::unhomed || axis.motion == MotionState::fault ||
         axis.motion == MotionState::stopped;
}

/// One axis to its place; nothing where there is none.
tl::expected<void, ScanStop> bring(ScannerDevice& device, AxisKind kind, double target) {
  if (!device.has_axis(kind)) return {};
  auto status = device.poll();
  if (!status) return tl::make_unexpected(stop_of(status.error()));
  const auto& axis = kind == AxisKind::elevation ? status->elevation : status->lift;
  if (!axis || needs_home(*axis)) {
    if (auto homed = device.home_axis(kind); !homed) return tl::make_unexpected(stop_of(homed.error()));
  } else if (std::abs(axis->position - target) <= device.limits(kind).resolution) {
    return {};
  }
  if (auto moved = device.move_axis(kind, target); !moved) return tl::make_unexpected(stop_of(moved.error()));
  return {};
}

}  // namespace

AxisTravels travels_of(const ScannerDevice* device) {
  AxisTravels out;
  if (device == nullptr) return out;
  const DeviceCapabilities& capabilities = device->capabilities();
  if (const auto& axis = capabilities.elevation) out.elevation_deg = {axis->lowest / kDegree, axis->highest / kDegree};
  if (const auto& axis = capabilities.lift) out.lift_mm = {axis->lowest, axis->highest};
  return out;
}

tl::expected<std::vector<AxisStop>, std::string> stops_of(const ScanRequest& request, const Calibration& calibration,
                                                          const AxisTravels& travels) {
  for (const double asked : request.elevations_deg) {
    const auto why =
        refusal(kElevation, asked, calibration.elevation.has_value(), travels.elevation_deg, calibration.date);
    if (why) return tl::make_unexpected(*why);
  }
  for (const double asked : request.lifts_mm) {
    const auto why = refusal(kLift, asked, calibration.lift.has_value(), travels.lift_mm, calibration.date);
    if (why) return tl::make_unexpected(*why);
  }
  const auto or_zero = [](const std::vector<double>& asked) { return asked.empty() ? std::vector<double>{0} : asked; };
  std::vector<AxisStop> stops;
  for (const double lift_mm : or_zero(request.lifts_mm)) {
    for (const double elevation_deg : or_zero(request.elevations_deg))
      stops.push_back({elevation_deg * kDegree, lift_mm});
  }
  return stops;
}

tl::expected<std::vector<AxisStop>, std::string> stops_of(const RecordedScan& recorded,
                                                          const Calibration& calibration) {
  if (recorded.stops.empty()) return std::vector<AxisStop>{{}};
  for (const AxisStop& stop : recorded.stops) {
    if ((stop.elevation_rad == 0 || calibration.elevation) && (stop.lift_mm == 0 || calibration.lift)) continue;
    return tl::make_unexpected("The recording was made at " + text_of(stop) + ", but the calibration of " +
                               calibration.date + " does not hold that axis; give the calibration of that machine.");
  }
  return recorded.stops;
}

tl::expected<AxisStop, ScanStop> bring_axes_to(const AxisStop& stop, ScannerDevice& device,
                                               const Calibration& calibration) {
  if (!device.has_axis(AxisKind::elevation) && !device.has_axis(AxisKind::lift)) return AxisStop();
  if (auto brought = bring(device, AxisKind::lift, stop.lift_mm); !brought) return tl::make_unexpected(brought.error());
  if (auto brought = bring(device, AxisKind::elevation, stop.elevation_rad); !brought)
    return tl::make_unexpected(brought.error());
  auto status = device.poll();
  if (!status) return tl::make_unexpected(stop_of(status.error()));
  AxisStop at;
  if (calibration.elevation && status->elevation) at.elevation_rad = status->elevation->position;
  if (calibration.lift && status->lift) at.lift_mm = status->lift->position;
  return at;
}

std::string text_of(const AxisStop& stop) {
  char text[96] = "";
  const double elevation_deg = stop.elevation_rad / kDegree;
  if (stop.elevation_rad != 0 && stop.lift_mm != 0) {
    std::snprintf(text, sizeof text, "elevation %.2f degrees, lift %.2f mm", elevation_deg, stop.lift_mm);
  } else if (stop.elevation_rad != 0) {
    std::snprintf(text, sizeof text, "elevation %.2f degrees", elevation_deg);
  } else if (stop.lift_mm != 0) {
    std::snprintf(text, sizeof text, "lift %.2f mm", stop.lift_mm);
  }
  return text;
}

}  // namespace celadon
