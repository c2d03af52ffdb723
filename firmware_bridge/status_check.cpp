#include "firmware_bridge/status_check.h"

#include <cmath>
#include <cstdio>
#include <numbers>

namespace celadon {
namespace {

constexpr double kClockSlack_ns = 20e6, kClockDrift = 1e-3;
constexpr double kPositionSlack_rad = 0.2 * std::numbers::pi / 180;

std::optional<Contradiction> clocks(const DeviceStatus& before, const DeviceStatus& now) {
  const double device_ns = (static_cast<double>(now.uptime_us) - static_cast<double>(before.uptime_us)) * 1e3;
  const auto shortest_ns = static_cast<double>(now.host_before_ns - before.host_after_ns);
  const auto longest_ns = static_cast<double>(now.host_after_ns - before.host_before_ns);
  const double slack_ns = kClockSlack_ns + kClockDrift * longest_ns;
  const double ahead_ns = device_ns - longest_ns, behind_ns = shortest_ns - device_ns;
  if (ahead_ns <= slack_ns && behind_ns <= slack_ns) return std::nullopt;
  char text[160];
  std::snprintf(text, sizeof text, "between two polls the controller's clock went %.0f ms %s this computer's",
                std::max(ahead_ns, behind_ns) * 1e-6, ahead_ns > 0 ? "ahead of" : "behind");
  return Contradiction{text, false};
}

bool is_homed_and_measured(const DeviceStatus& s) {
  return s.homed && s.motion != MotionState::homing && s.motion != MotionState::unhomed;
}

std::optional<Contradiction> positions(const DeviceStatus& before, const DeviceStatus& now, bool commanded_between,
                                       const DeviceCapabilities& capabilities) {
  if (!is_homed_and_measured(before) || !is_homed_and_measured(now)) return std::nullopt;
  if (capabilities.max_acceleration_rad_per_s2 <= 0 || now.position_time_us <= before.position_time_us)
    return std::nullopt;
  const bool stood = !commanded_between && before.motion == MotionState::standstill && before.motion == now.motion;
  const double seconds = static_cast<double>(now.position_time_us - before.position_time_us) * 1e-6;
  const double expected_rad = stood ? 0 : (before.speed_rad_per_s + now.speed_rad_per_s) / 2 * seconds;
  const double possible_rad = stood ? 0 : capabilities.max_acceleration_rad_per_s2 * seconds * seconds / 4;
  // Read rather than stamped: each sample may be as much older or newer as its exchange took.
  const double unknown_s =
      static_cast<double>(before.host_after_ns - before.host_before_ns + now.host_after_ns - now.host_before_ns) * 1e-9;
  const double unknown_rad = capabilities.stamped_by_host
                                 ? std::max(std::abs(before.speed_rad_per_s), std::abs(now.speed_rad_per_s)) * unknown_s
                                 : 0;
  const double jump_rad = now.angle_rad - before.angle_rad - expected_rad;
  if (std::abs(jump_rad) <= possible_rad + unknown_rad + kPositionSlack_rad) return std::nullopt;
  char text[200];
  std::snprintf(
      text, sizeof text,
      "the position jumped by %.3f deg within %.0f ms: the encoder lost its count, or somebody turned the table",
      jump_rad * 180 / std::numbers::pi, seconds * 1e3);
  return Contradiction{text, true};
}

}  // namespace

std::optional<Contradiction> contradiction(const DeviceStatus& before, const DeviceStatus& now, bool commanded_between,
                                           const DeviceCapabilities& capabilities) {
  // Of a clock that was set nothing that follows can be told.
  if (auto found = clocks(before, now)) return found;
  return positions(before, now, commanded_between, capabilities);
}

}  // namespace celadon
