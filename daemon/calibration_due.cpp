#include "daemon/calibration_due.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <optional>
#include <string_view>

namespace celadon {
namespace {

/// Beginnings of the names of checks whose failure a calibration mends. Those of an object that may have moved are not
/// among them.
constexpr std::array<std::string_view, 7> kTelling = {"laser_agreement", "stop_agreement", "turn",       "datum_turn",
                                                      "datum_time",      "datum_camera",   "datum_laser"};
constexpr std::int64_t kDay_s = 24 * 60 * 60;

/// Of an ISO 8601 date with or without a time, UTC; nullopt: another text.
std::optional<std::int64_t> unix_seconds(const std::string& text) {
  int year = 0, hour = 0, minute = 0;
  unsigned month = 0, day = 0;
  double second = 0;
  if (std::sscanf(text.c_str(), "%d-%u-%uT%d:%d:%lfZ", &year, &month, &day, &hour, &minute, &second) < 3) return {};
  const std::chrono::year_month_day date{std::chrono::year(year), std::chrono::month(month), std::chrono::day(day)};
  if (!date.ok()) return {};
  const auto days = std::chrono::sys_days(date).time_since_epoch().count();
  return days * kDay_s + hour * 3600 + minute * 60 + static_cast<std::int64_t>(second);
}

bool tells(const SelfCheck& check) {
  return check.verdict != CheckVerdict::not_verifiable &&
         std::any_of(kTelling.begin(), kTelling.end(),
                     [&](std::string_view name) { return check.name.starts_with(name); });
}

}  // namespace

std::vector<std::string> calibration_due(const Calibration& calibration, const CalibrationLimits& limits,
                                         const std::map<std::uint64_t, ScanRecord>& scans, std::int64_t now_unix_s) {
  const auto calibrated_at = unix_seconds(calibration.date);
  if (!calibrated_at) return {};
  const std::string its = "The calibration of " + calibration.date + " ", remedy = "; run celadon calibrate.";
  std::vector<std::string> reasons;
  const std::int64_t days = (now_unix_s - *calibrated_at) / kDay_s;
  if (limits.days > 0 && days > limits.days) {
    reasons.push_back(its + "is " + std::to_string(days) + " days old, and good for " + std::to_string(limits.days) +
                      remedy);
  }
  std::int64_t done = 0;
  struct Verdict {
    std::uint64_t scan = 0;
    const SelfCheck* check = nullptr;
  };
  std::map<std::string, Verdict> newest;
  for (const auto& [id, scan] : scans) {
    const auto at = unix_seconds(scan.created);
    if (scan.state != ScanState::done || !at || *at < *calibrated_at) continue;
    ++done;
    for (const SelfCheck& check : scan.checks)
      if (tells(check)) newest[check.name] = {id, &check};
  }
  if (limits.scans > 0 && done > limits.scans) {
    reasons.push_back(its + "has served " + std::to_string(done) + " scans, and is good for " +
                      std::to_string(limits.scans) + remedy);
  }
  for (const auto& [name, verdict] : newest) {
    if (verdict.check->verdict != CheckVerdict::failed) continue;
    reasons.push_back(its + "is doubted by the check '" + name + "' of scan " + std::to_string(verdict.scan) + ": " +
                      verdict.check->cause + remedy);
  }
  return reasons;
}

}  // namespace celadon
