#include "fitting/steps.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace celadon {
namespace {

constexpr int kSectors = 16;
constexpr double kPerBin = 10;  // samples of an even scan
constexpr int kFewestRows = 24, kMostRows = 1000;
constexpr int kBeside = 2;           // rows from a step to those that are free of its shoulder
constexpr double kSteep = 2.5;       // rise over height between these rows: 68 degrees
constexpr double kScales = 6;        // of the scatter within a row
constexpr double kAllAround = 0.75;  // of the sectors that have samples on both sides
constexpr int kLongest = 6;          // rows: what is steep for longer is a slope, not a step
constexpr int kHidden = 12;          // rows without samples that a step may hide in its shadow

double middle_of(std::vector<double>& of) {
  const auto at = of.begin() + static_cast<std::ptrdiff_t>(of.size() / 2);
  std::nth_element(of.begin(), at, of.end());
  return *at;
}

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// Median ranges by sector and row, NaN where next to nothing lies.
struct Rows {
  int count = 0;
  double z_start = 0, height = 0, scatter = 0;
  std::vector<double> medians;
  double at(int sector, int row) const {
    return row < 0 || row >= count ? kNone : medians[static_cast<std::size_t>(sector * count + row)];
  }
  /// Half of the sectors have samples there.
  bool shows(int row) const {
    int sectors = 0;
    for (int s = 0; s < kSectors; ++s) sectors += std::isnan(at(s, row)) ? 0 : 1;
    return 2 * sectors >= kSectors;
  }
  /// The first row from one on, upwards or downwards, that shows something; beyond what a step hides the one asked for.
  int seen_from(int sector, int row, int direction) const {
    for (int k = 0; k <= kHidden; ++k)
      if (!std::isnan(at(sector, row + k * direction))) return row + k * direction;
    return row;
  }
};

Rows rows_of(std::span<const SamplePoint> samples, int arcs, double z_start, double z_end) {
  Rows rows;
  rows.count =
      std::clamp(static_cast<int>(static_cast<double>(samples.size()) / (kSectors * kPerBin)), kFewestRows, kMostRows);
  rows.z_start = z_start;
  rows.height = (z_end - z_start) / rows.count;
  std::vector<std::vector<double>> bins(static_cast<std::size_t>(kSectors * rows.count));
  for (const SamplePoint& p : samples) {
    const double row = (p.z_mm - z_start) / rows.height;
    if (!(row >= 0 && row < rows.count)) continue;
    const int sector = std::clamp(static_cast<int>(p.v / arcs * kSectors), 0, kSectors - 1);
    bins[static_cast<std::size_t>(sector * rows.count + static_cast<int>(row))].push_back(p.r_mm);
  }
  std::vector<double> scatters;
  for (auto& bin : bins) {
    rows.medians.push_back(bin.size() < 3 ? kNone : middle_of(bin));
    if (bin.size() < 3) continue;
    for (double& r : bin) r = std::abs(r - rows.medians.back());
    scatters.push_back(1.4826 * middle_of(bin));
  }
  rows.scatter = scatters.empty() ? 0 : middle_of(scatters);
  return rows;
}

// The jump between the rows beside one, beyond what the slopes there rise; 0: none.
double jump_at(const Rows& rows, int sector, int row) {
  const int above = rows.seen_from(sector, row + kBeside, 1), below = rows.seen_from(sector, row - kBeside, -1);
  const auto at = [&](int k) { return rows.at(sector, k); };
  const double jump = at(above) - at(below),
               slope = std::max(std::abs(at(above + kBeside) - at(above)), std::abs(at(below) - at(below - kBeside)));
  if (!std::isfinite(jump) || !std::isfinite(slope)) return kNone;
  return std::abs(jump) > kScales * rows.scatter + slope && std::abs(jump) > kSteep * (above - below) * rows.height
             ? jump
             : 0;
}

}  // namespace

std::vector<WallStep> find_steps(std::span<const SamplePoint> samples, int arcs, double z_start_mm, double z_end_mm) {
  std::vector<WallStep> steps;
  if (!(z_start_mm < z_end_mm) || samples.size() < static_cast<std::size_t>(kSectors * kFewestRows)) return steps;
  const Rows rows = rows_of(samples, arcs, z_start_mm, z_end_mm);
  // Of each row the median jump of its sectors, if nearly all have one.
  std::vector<double> jumps(static_cast<std::size_t>(rows.count), 0.0);
  for (int row = 0; row < rows.count; ++row) {
    std::vector<double> up, down;
    int sectors = 0;
    for (int s = 0; s < kSectors; ++s) {
      const double jump = jump_at(rows, s, row);
      if (std::isnan(jump)) continue;
      ++sectors;
      if (jump != 0) (jump > 0 ? up : down).push_back(jump);
    }
    auto& most = up.size() >= down.size() ? up : down;
    if (2 * sectors >= kSectors && static_cast<double>(most.size()) >= kAllAround * sectors)
      jumps[static_cast<std::size_t>(row)] = middle_of(most);
  }
  for (int row = 0; row < rows.count; ++row) {
    const auto at = [&](int k) { return jumps[static_cast<std::size_t>(k)]; };
    if (at(row) == 0) continue;
    // Over rows in which a shoulder lies nothing may show.
    int end = row + 1;
    for (int k = end; k < std::min(end + kBeside, rows.count); ++k)
      if (at(k) * at(row) > 0) end = k + 1;
    int shown = 0;
    for (int k = row; k < end; ++k) shown += rows.shows(k) ? 1 : 0;
    if (shown <= kLongest) {
      double weight = 0, z = 0;
      for (int k = row; k < end; ++k) {
        weight += std::abs(at(k));
        z += std::abs(at(k)) * (rows.z_start + (k + 0.5) * rows.height);
      }
      // Between rows beyond the shoulder.
      std::vector<double> between;
      for (int s = 0; s < kSectors; ++s) {
        const double jump = rows.at(s, rows.seen_from(s, end - 1 + 2 * kBeside, 1)) -
                            rows.at(s, rows.seen_from(s, row - 2 * kBeside, -1));
        if (std::isfinite(jump)) between.push_back(jump);
      }
      if (!between.empty()) steps.push_back({z / weight, middle_of(between)});
    }
    row = end;
  }
  return steps;
}

}  // namespace celadon
