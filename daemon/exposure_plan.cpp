#include "daemon/exposure_plan.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <set>

#include "daemon/sectors_in_words.h"

namespace celadon {
namespace {

constexpr std::size_t kSectors = PeakSurvey::kSectors;
constexpr double kFewRows = 0.05;            // share of a sector's that may be too bright or too dark
constexpr double kFaint = 12;                // grey levels, hardly found
constexpr double kDark = 25;                 // what a second exposure is chosen by
constexpr std::size_t kShortestStretch = 3;  // sectors: cameras take a moment for each change
constexpr std::size_t kWorthATurn = 3;       // sectors; a border of two colours lies within one or two

using Steps = std::array<int, kSectors>;  // of the ladder, 0 the longest exposure; -1: nothing seen

/// The longest exposure of the ladder at which a peak is no brighter than it should be.
int step_for(double levels_per_ms, const ExposureLimits& limits) {
  const double wanted_ms =
      std::min(PeakSurvey::kBrightest / levels_per_ms, PeakSurvey::kTop / (levels_per_ms + limits.room_levels_per_ms));
  const int shortest = std::max(0, static_cast<int>(std::floor(std::log2(limits.longest_ms / limits.shortest_ms))));
  return std::clamp(static_cast<int>(std::ceil(std::log2(limits.longest_ms / wanted_ms))), 0, shortest);
}

double exposure_of(int step, const ExposureLimits& limits) {
  return std::ldexp(limits.longest_ms, -step);
}

/// What shows nothing is exposed as what is nearest to it.
void fill(Steps& steps) {
  const Steps seen = steps;
  for (std::size_t k = 0; k < kSectors; ++k) {
    for (std::size_t off = 1; steps[k] < 0 && off < kSectors; ++off)
      steps[k] = std::max(seen[(k + off) % kSectors], seen[(k + kSectors - off) % kSectors]);
  }
}

/// Sectors in a row with one exposure, around the turn.
struct Run {
  std::size_t first = 0, sectors = 0;
};
std::vector<Run> runs_of(const Steps& steps) {
  std::vector<Run> runs;
  for (std::size_t k = 0; k < kSectors; ++k) {
    if (steps[k] == steps[(k + kSectors - 1) % kSectors]) continue;
    Run run{k, 1};
    while (steps[(k + run.sectors) % kSectors] == steps[k]) ++run.sectors;
    runs.push_back(run);
  }
  return runs;
}

/// Joins runs that are too short to the neighbour whose exposure is nearest, the shortest one first.
void smooth(Steps& steps) {
  for (auto runs = runs_of(steps); !runs.empty(); runs = runs_of(steps)) {
    const auto run =
        std::min_element(runs.begin(), runs.end(), [](const Run& a, const Run& b) { return a.sectors < b.sectors; });
    if (run->sectors >= kShortestStretch) return;
    const int own = steps[run->first], before = steps[(run->first + kSectors - 1) % kSectors],
              after = steps[(run->first + run->sectors) % kSectors];
    const int joined = std::abs(before - own) <= std::abs(after - own) ? before : after;
    for (std::size_t k = 0; k < run->sectors; ++k) steps[(run->first + k) % kSectors] = joined;
  }
}

ExposurePlan plan_of(const Steps& steps, const ExposureLimits& limits) {
  std::array<std::int64_t, kSectors> exposures_ns{};
  for (std::size_t k = 0; k < kSectors; ++k) exposures_ns[k] = std::llround(exposure_of(steps[k], limits) * 1e6);
  return ExposurePlan(exposures_ns);
}

using Sectors = std::array<bool, kSectors>;

bool any(const Sectors& sectors) {
  return std::any_of(sectors.begin(), sectors.end(), [](bool b) { return b; });
}

std::string where(const Sectors& sectors) {
  return sectors_in_words(kSectors, [&](std::size_t k) { return sectors[k]; });
}

std::string milliseconds_text(double ms) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g ms", ms);
  return text;
}

}  // namespace

std::int64_t ExposurePlan::longest_ns() const {
  return *std::max_element(exposures_ns_.begin(), exposures_ns_.end());
}

std::vector<std::int64_t> ExposurePlan::values_ns() const {
  const std::set<std::int64_t> values(exposures_ns_.begin(), exposures_ns_.end());
  return {values.begin(), values.end()};
}

std::vector<ExposurePlan::Stretch> ExposurePlan::stretches() const {
  if (empty()) return {};
  constexpr double kSector_deg = 360. / kSectors;
  std::vector<Stretch> out;
  for (std::size_t k = 0; k < kSectors; ++k) {
    if (out.empty() || exposures_ns_[k] != out.back().exposure_ns)
      out.push_back({static_cast<double>(k) * kSector_deg, 0, exposures_ns_[k]});
    out.back().to_deg = static_cast<double>(k + 1) * kSector_deg;
  }
  if (out.size() > 1 && out.front().exposure_ns == out.back().exposure_ns) {
    out.front().from_deg = out.back().from_deg - 360;
    out.pop_back();
  }
  return out;
}

ExposureChoice choose_exposures(const std::array<PeakHistogram, kSectors>& peaks, const ExposureLimits& limits) {
  Steps bright, dark;
  Sectors glaring{}, faint{}, between{}, unseen{};
  std::size_t two_needed = 0;
  for (std::size_t k = 0; k < kSectors; ++k) {
    const double rows = peaks[k].weight();
    bright[k] = dark[k] = -1;
    unseen[k] = rows == 0;
    if (unseen[k]) continue;
    const double brightest = peaks[k].quantile(1 - kFewRows);
    bright[k] = dark[k] = step_for(brightest, limits);
    const double exposure_ms = exposure_of(bright[k], limits);
    glaring[k] = brightest * limits.shortest_ms > PeakSurvey::kTop;
    const double unreachable = peaks[k].darker_than(kFaint / limits.longest_ms);
    faint[k] = unreachable > kFewRows * rows;
    if (peaks[k].darker_than(kFaint / exposure_ms) - unreachable <= kFewRows * rows) continue;
    ++two_needed;
    dark[k] = step_for(peaks[k].darker_part(kDark / exposure_ms).quantile(1 - kFewRows), limits);
    const double left = peaks[k].darker_than(kFaint / exposure_of(dark[k], limits)) - unreachable;
    between[k] = left > kFewRows * rows;
  }
  ExposureChoice choice;
  for (Steps* steps : {&bright, &dark}) {
    fill(*steps);
    smooth(*steps);
  }
  choice.plans.push_back(plan_of(bright, limits));
  if (two_needed >= kWorthATurn) choice.plans.push_back(plan_of(dark, limits));

  const std::string longest = milliseconds_text(limits.longest_ms) +
                              (limits.room_limits ? ", the longest exposure that the room's light allows"
                                                  : ", the longest exposure that the frame period allows");
  const std::string longer = limits.room_limits ? "darken the room" : "choose a slower frame rate";
  if (any(glaring)) {
    choice.unreached.push_back("The line is saturated " + where(glaring) + " of the table's turn even at " +
                               milliseconds_text(limits.shortest_ms) +
                               ", the shortest exposure that the camera takes; dim the laser, or dull the object with "
                               "matting spray.");
  }
  if (any(faint)) {
    choice.unreached.push_back("Of the line more than one row in twenty is hardly seen " + where(faint) +
                               " of the table's turn at " + longest + "; " + longer +
                               ", or whiten the object with matting spray.");
  }
  if (any(between)) {
    choice.unreached.push_back("The object is so bright and so dark " + where(between) +
                               " of the table's turn that two exposures are not enough; dull it with matting spray.");
  }
  if (any(unseen)) {
    choice.unreached.push_back("No line is seen " + where(unseen) + " of the table's turn at " + longest +
                               ": nothing stands there, or it is too dark; then " + longer +
                               ", or whiten the object with matting spray.");
  }
  return choice;
}

std::vector<ExposurePlan> one_exposure_a_turn(const std::vector<ExposurePlan>& plans) {
  constexpr std::int64_t kTimesAsLong = 4;  // worth a turn: a line of 100 levels is one of 25
  std::array<std::int64_t, kSectors> wanted{}, second{};
  for (const ExposurePlan& plan : plans) {
    for (std::size_t k = 0; k < kSectors; ++k) wanted[k] = std::max(wanted[k], plan.in_sector_ns(k));
  }
  std::int64_t shortest = plans.front().longest_ns();
  for (const ExposurePlan& plan : plans) shortest = std::min(shortest, plan.values_ns().front());
  const std::int64_t longest = *std::max_element(wanted.begin(), wanted.end());
  const auto is_dark = [&](std::size_t k) { return wanted[k % kSectors] >= kTimesAsLong * shortest; };
  for (std::size_t k = 0; k < kSectors; ++k)
    second[k] = is_dark(k + kSectors - 1) || is_dark(k) || is_dark(k + 1) ? longest : shortest;
  std::array<std::int64_t, kSectors> first{};
  first.fill(shortest);
  std::vector<ExposurePlan> out{ExposurePlan(first)};
  if (longest >= kTimesAsLong * shortest) out.emplace_back(second);
  return out;
}

}  // namespace celadon
