// choose_grid: the band and resolution of the sums, from one pass over the samples.
#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "fitting/even_sample.h"
#include "fitting/fit_report.h"
#include "fitting/range_fit.h"

namespace celadon {
namespace {

constexpr std::size_t kHeights = 8192;  // heights kept of the stream
constexpr double kStrayShare = 1e-3;    // share of samples at either end that may be strays
constexpr double kStrayReach = 0.05;    // and how far, as a share of the rest, before they are
constexpr double kSamplesPerCell = 5;
constexpr int kLargestAround = 32, kLargestAlong = 256, kLargestCells = 16384;

double quantile(const std::vector<double>& sorted, double share) {
  return sorted[static_cast<std::size_t>(share * static_cast<double>(sorted.size() - 1))];
}

}  // namespace

tl::expected<GridSpecification, FitError> choose_grid(ProfileStream& profiles, const RangeFitOptions& options) {
  if (options.degree_u < 1 || options.degree_u > 5 || options.degree_v < 1 || options.degree_v > 5)
    return tl::unexpected(
        FitError{text("the degrees (%d, %d) must both lie in 1..5", options.degree_u, options.degree_v)});
  if (options.z_intervals.has_value() != options.intervals_per_arc.has_value())
    return tl::unexpected(FitError{text("fixed numbers of intervals must be given for both directions or for none")});
  const auto power_of_two = [](int n) { return n > 0 && std::has_single_bit(static_cast<unsigned>(n)); };
  if (options.z_intervals && (!power_of_two(*options.z_intervals) || !power_of_two(*options.intervals_per_arc)))
    return tl::unexpected(FitError{text("%d z intervals and %d intervals an arc must both be powers of two",
                                        *options.z_intervals, *options.intervals_per_arc)});

  EvenSample<double> sample(kHeights);
  double lowest = std::numeric_limits<double>::infinity(), highest = -lowest, sum_r = 0;
  std::size_t good = 0, on_axis = 0, outside = 0, total = 0;
  profiles.rewind();
  while (const Profile* profile = profiles.next())
    for (std::size_t k = 0; k < profile->size(); ++k) {
      const double r = profile->r_mm[k], z = profile->z_mm[k], theta = profile->theta_rad[k];
      ++total;
      if (!std::isfinite(r) || !std::isfinite(z) || !std::isfinite(theta)) continue;
      if (r <= 0) {
        ++on_axis;
        continue;
      }
      if (!options.arcs.contains(theta)) {
        ++outside;
        continue;
      }
      ++good;
      sum_r += r;
      lowest = std::min(lowest, z);
      highest = std::max(highest, z);
      sample.add([&] { return z; });
    }
  if (total == 0) return tl::unexpected(FitError{text("there are no samples; scan the object or name another input")});
  if (good == 0 && outside > 0)
    return tl::unexpected(
        FitError{text("none of the %zu samples lies in the angular range from %.6g over %.6g degrees; widen the range",
                      total, options.arcs.start_rad() * 180 / std::numbers::pi,
                      options.arcs.count() * options.arcs.arc_rad() * 180 / std::numbers::pi)});
  if (good == 0 && on_axis > 0)
    return tl::unexpected(
        FitError{text("all %zu samples lie on the axis (r = 0); check the axis and the units", on_axis)});
  if (good == 0)
    return tl::unexpected(
        FitError{text("none of the %zu samples is a finite number; check the input's format", total)});

  std::vector<double> heights(sample.values());
  std::sort(heights.begin(), heights.end());
  const double low = quantile(heights, kStrayShare), high = quantile(heights, 1 - kStrayShare);
  const double reach = kStrayReach * (high - low);
  GridSpecification grid;
  grid.base = options.base;
  grid.arcs = options.arcs;
  grid.z_start_mm = lowest < low - reach ? low - reach : lowest;
  grid.z_end_mm = highest > high + reach ? high + reach : highest;
  const bool spherical = options.base == BaseKind::sphere;
  if (options.reach_start) grid.z_start_mm = std::min(grid.z_start_mm, *options.reach_start);
  if (options.reach_end) grid.z_end_mm = std::max(grid.z_end_mm, *options.reach_end);
  if (spherical) grid.z_start_mm = 0, grid.z_end_mm = BaseSurface::kMeridianEnd;
  if (!(grid.z_end_mm > grid.z_start_mm))
    return tl::unexpected(FitError{text(
        "all %zu samples have the same height z = %.9g mm: a surface needs a band of heights", good, grid.z_start_mm)});
  grid.degree_u = options.degree_u;
  grid.degree_v = options.degree_v;
  if (options.z_intervals) {
    grid.z_intervals = *options.z_intervals;
    grid.intervals_per_arc = *options.intervals_per_arc;
    return grid;
  }
  // Cells about as high as wide, as many as the samples fill.
  const double mean_r = sum_r / static_cast<double>(good);
  const double height = spherical ? std::numbers::pi * mean_r : grid.z_end_mm - grid.z_start_mm,
               around = grid.arcs.count() * grid.arcs.arc_rad() * mean_r;
  const double ratio = height / around;
  const int arcs = grid.arcs.count();
  grid.intervals_per_arc = kLargestAround;
  grid.z_intervals =
      std::clamp(static_cast<int>(std::exp2(std::round(std::log2(arcs * kLargestAround * ratio)))), 16, kLargestAlong);
  const auto cells = [&] { return static_cast<double>(arcs) * grid.intervals_per_arc * grid.z_intervals; };
  const double largest = std::min(static_cast<double>(good) / kSamplesPerCell, static_cast<double>(kLargestCells));
  while (cells() > largest && (grid.z_intervals > (spherical ? 4 : 1) || grid.intervals_per_arc > 1)) {
    const bool flat = height / grid.z_intervals < around / (arcs * grid.intervals_per_arc);
    // A closed pole wants two intervals before the joint of the meridian.
    if (((flat && grid.z_intervals > 1) || grid.intervals_per_arc == 1) && (!spherical || grid.z_intervals > 4)) {
      grid.z_intervals /= 2;
    } else {
      grid.intervals_per_arc /= 2;
    }
  }
  return grid;
}

}  // namespace celadon
