#include "daemon/view_watch.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <numbers>
#include <utility>

#include "daemon/sectors_in_words.h"

namespace celadon {
namespace {

constexpr std::size_t kEdgeRows = 2;           // that may show the end of a line
constexpr double kBrightShare = 0.05;          // of the rows
constexpr double kBest = 200, kDim = 80;       // grey levels of bright places: from 250 on they are saturated
constexpr double kMostSaturated = 0.2;         // of the rows of a sector
constexpr double kFaint = 12;                  // grey levels, hardly found
constexpr double kShorter = 0.6, kLonger = 4;  // by which an exposure is changed at once, at most

template <class... Values>
std::string sentence(const char* format, Values... values) {
  char out[240];
  std::snprintf(out, sizeof out, format, values...);
  return out;
}

template <class Holds>
std::string where(const ViewReading& reading, const Holds& holds) {
  return sectors_in_words(ViewReading::kSectors, [&](std::size_t k) { return holds(reading.sectors[k]); });
}

double share(std::uint64_t part, std::uint64_t whole) {
  return whole == 0 ? 0 : static_cast<double>(part) / static_cast<double>(whole);
}

SelfCheck check_of(const char* name, double percent, double limit_percent, const char* note) {
  return {name, "%", percent, {}, limit_percent, CheckVerdict::passed, note, {}, {}};
}

void fail(SelfCheck& check, std::string cause, std::string remedy) {
  check.verdict = CheckVerdict::failed;
  check.cause = std::move(cause);
  check.remedy = std::move(remedy);
}

}  // namespace

void ViewWatch::see(std::span<const LineRow> rows, const Profile& profile) {
  if (profile.size() == 0) return;
  double turned = profile.theta_rad[profile.size() / 2] / (2 * std::numbers::pi);
  turned -= std::floor(turned);
  const std::size_t at = std::min(static_cast<std::size_t>(turned * ViewReading::kSectors), ViewReading::kSectors - 1);
  ViewSector& sector = sectors_[at];
  ++sector.profiles;
  std::size_t highest = 0, lowest = 0;
  for (std::size_t k = 0; k < profile.size(); ++k) {
    const LineRow& row = rows[profile.row[k]];
    ++sector.rows;
    sector.saturated += row.status == RowStatus::saturated;
    amplitudes_[at] += row.amplitude;
    ++levels_[static_cast<std::size_t>(std::clamp(row.amplitude, 0.f, 255.f))];
    if (profile.z_mm[k] > profile.z_mm[highest]) highest = k;
    if (profile.z_mm[k] < profile.z_mm[lowest]) lowest = k;
  }
  const auto at_edge = [&](std::size_t k) {
    return profile.row[k] < kEdgeRows || profile.row[k] + kEdgeRows >= rows.size();
  };
  sector.cut_above += at_edge(highest);
  sector.cut_below += at_edge(lowest);
}

ViewReading ViewWatch::reading() const {
  ViewReading out{sectors_, 0};
  std::uint64_t rows = 0, brighter = 0;
  for (std::size_t k = 0; k < out.sectors.size(); ++k) {
    rows += sectors_[k].rows;
    if (sectors_[k].rows > 0) out.sectors[k].amplitude = amplitudes_[k] / static_cast<double>(sectors_[k].rows);
  }
  for (std::size_t level = levels_.size(); level-- > 0;) {
    brighter += levels_[level];
    out.bright_level = static_cast<double>(level);
    if (share(brighter, rows) > kBrightShare) break;
  }
  return out;
}

ExposureAdvice exposure_advice(const ViewReading& reading, double exposure_ms, double longest_ms) {
  std::uint64_t rows = 0, saturated = 0;
  for (const ViewSector& s : reading.sectors) rows += s.rows, saturated += s.saturated;
  // How bright saturated places are nobody knows.
  const bool too_bright = share(saturated, rows) > kBrightShare;
  const bool good = !too_bright && reading.bright_level >= kDim;
  const double factor = good         ? 1
                        : too_bright ? kShorter
                                     : std::min(kBest / std::max(reading.bright_level, 1.), kLonger);
  const double better_ms = std::min(exposure_ms * factor, std::max(longest_ms, exposure_ms));
  return {exposure_ms, better_ms, good || better_ms == exposure_ms};
}

std::vector<SelfCheck> view_checks(const ViewReading& reading, const ExposureAdvice& exposure) {
  std::uint64_t profiles = 0, above = 0, below = 0;
  for (const ViewSector& s : reading.sectors) profiles += s.profiles, above += s.cut_above, below += s.cut_below;
  SelfCheck view = check_of("view", 100 * share(std::max(above, below), profiles), 0,
                            "share of the profiles that run out of the picture at its upper or lower edge");
  if (above > 0) {
    fail(view,
         "the object is higher than the picture " + where(reading, [](const ViewSector& s) { return s.cut_above > 0; }),
         "lower the table, tilt or move the camera and calibrate again, or scan at several heights (--lifts)");
  } else if (below > 0) {
    fail(view,
         "the picture ends above the object's foot " +
             where(reading, [](const ViewSector& s) { return s.cut_below > 0; }),
         "raise the table or the object, or scan at several heights (--lifts)");
  }

  const auto saturated = [](const ViewSector& s) { return share(s.saturated, s.rows) > kMostSaturated; };
  const auto faint = [](const ViewSector& s) { return s.rows > 0 && s.amplitude < kFaint; };
  const auto& sectors = reading.sectors;
  double most = 0;
  for (const ViewSector& s : sectors) most = std::max(most, share(s.saturated, s.rows));
  SelfCheck light = check_of("exposure", 100 * most, 100 * kMostSaturated,
                             "share of the line's rows that are saturated, in the 15 degrees with most");
  const bool any_faint = std::any_of(sectors.begin(), sectors.end(), faint);
  if (std::any_of(sectors.begin(), sectors.end(), saturated)) {
    fail(light, sentence("the line is saturated at %.3g ms ", exposure.exposure_ms) + where(reading, saturated),
         any_faint ? "the object is bright and dark: scan it with the exposure auto (--exposure auto), or dull it with "
                     "matting spray"
                   : sentence("expose for %.3g ms (--exposure)", exposure.better_ms));
  } else if (any_faint) {
    fail(light, sentence("the line is hardly seen at %.3g ms ", exposure.exposure_ms) + where(reading, faint),
         exposure.is_good ? "dull the object with matting spray"
                          : sentence("expose for %.3g ms (--exposure)", exposure.better_ms));
  }
  return {view, light};
}

}  // namespace celadon
