#include "firmware_bridge/status_check.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <utility>

#include "firmware_bridge/device_poll.h"

namespace celadon {
namespace {

constexpr double kClockSlack_ns = 20e6, kClockDrift = 1e-3;
constexpr double kPositionSlack_rad = 0.2 * std::numbers::pi / 180, kPositionSlack_mm = 0.2;

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

bool is_homed_and_measured(const AxisStatus& s) {
  return s.homed && s.motion != MotionState::homing && s.motion != MotionState::unhomed;
}

}  // namespace

std::optional<std::string> position_jump(AxisKind kind, const AxisStatus& before, const AxisStatus& now,
                                         bool commanded_between, double max_acceleration, double unknown_s) {
  if (!is_homed_and_measured(before) || !is_homed_and_measured(now)) return std::nullopt;
  if (max_acceleration <= 0 || now.position_time_us <= before.position_time_us) return std::nullopt;
  const bool stood = !commanded_between && before.motion == MotionState::standstill && before.motion == now.motion;
  const double seconds = static_cast<double>(now.position_time_us - before.position_time_us) * 1e-6;
  const double expected = stood ? 0 : (before.speed + now.speed) / 2 * seconds;
  const double possible = stood ? 0 : max_acceleration * seconds * seconds / 4;
  const double unknown = std::max(std::abs(before.speed), std::abs(now.speed)) * unknown_s;
  const double jump = now.position - before.position - expected;
  const double slack = kind == AxisKind::lift ? kPositionSlack_mm : kPositionSlack_rad;
  if (std::abs(jump) <= possible + unknown + slack) return std::nullopt;
  char within[32];
  std::snprintf(within, sizeof within, "%.0f ms", seconds * 1e3);
  const bool table = kind == AxisKind::turntable;
  return "the position " + (table ? std::string() : std::string("of the ") + axis_name(kind) + " ") + "jumped by " +
         position_text(kind, jump) + " within " + within + ": the encoder lost its count, or " +
         (table ? "somebody turned the table" : "it was moved by hand or by its load");
}

std::optional<Contradiction> contradiction(const DeviceStatus& before, const DeviceStatus& now, bool commanded_between,
                                           const DeviceCapabilities& capabilities) {
  // Of a clock that was set nothing that follows can be told.
  if (auto found = clocks(before, now)) return found;
  // Read rather than stamped: each sample may be as much older or newer as its exchange took.
  const double unknown_s =
      static_cast<double>(before.host_after_ns - before.host_before_ns + now.host_after_ns - now.host_before_ns) * 1e-9;
  auto jump = position_jump(AxisKind::turntable, axis_status(before, AxisKind::turntable),
                            axis_status(now, AxisKind::turntable), commanded_between,
                            capabilities.max_acceleration_rad_per_s2, capabilities.stamped_by_host ? unknown_s : 0);
  if (!jump) return std::nullopt;
  return Contradiction{*std::move(jump), true};
}

}  // namespace celadon
