#include "fitting/shoulders.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "fitting/even_points.h"
#include "fitting/steps.h"

namespace celadon {
namespace {

constexpr std::size_t kShoulderPoints = FirstLook::kSamples;
constexpr int kRingSectors = 16;
// A row of an even scan has so many samples. Heights are looked at within so many rows of a step, the outer half of
// which shows the walls, and within twice as many again while its edges reach as far.
constexpr double kPerRow = 160, kReachRows = 24;
constexpr int kWider = 3;
constexpr double kFewestLevels = 24, kMostLevels = 1000;
// Shares of the jump between which a sample lies on the ring, not on a wall's edge.
constexpr double kRingFrom = 0.2, kRingTo = 0.8;
constexpr std::size_t kFewestOnRing = 12;
// Off its wall by so many times the wall's scatter. An edge goes on from the ring outward while more than that share
// of the samples of half a row is off.
constexpr double kOffScales = 4, kOffShare = 0.1;
constexpr int kQuietBins = 2;
constexpr double kEdgeMargin = 1.5;  // of the edge, whose last samples are nearly as good as on the wall
constexpr double kLeastJump = 0.1;   // of a sector, as a share of the median jump: less shows no ring
constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

double middle_value(std::vector<double>& of) {
  if (of.empty()) return kUnknown;
  const auto at = of.begin() + static_cast<std::ptrdiff_t>(of.size() / 2);
  std::nth_element(of.begin(), at, of.end());
  return *at;
}

double scatter_of(std::vector<double> of, double middle) {
  for (double& value : of) value = std::abs(value - middle);
  return of.empty() ? 0 : 1.4826 * middle_value(of);
}

struct Sample {
  double r, theta, z;
  std::size_t sector() const {
    const double turn = theta / (2 * std::numbers::pi) - std::floor(theta / (2 * std::numbers::pi));
    return std::min(static_cast<std::size_t>(turn * kRingSectors), std::size_t{kRingSectors - 1});
  }
};

/// An even choice of the samples, by height.
struct SortedSamples {
  std::vector<Sample> sorted;
  double row_mm = 0;

  explicit SortedSamples(ProfileStream& stream) {
    const Eigen::Matrix3Xd points = even_points(stream, kShoulderPoints);
    for (Eigen::Index k = 0; k < points.cols(); ++k)
      sorted.push_back({std::hypot(points(0, k), points(1, k)), std::atan2(points(1, k), points(0, k)), points(2, k)});
    std::sort(sorted.begin(), sorted.end(), [](const Sample& a, const Sample& b) { return a.z < b.z; });
    if (!sorted.empty())
      row_mm = (sorted.back().z - sorted.front().z) /
               std::clamp(static_cast<double>(sorted.size()) / kPerRow, kFewestLevels, kMostLevels);
  }

  std::span<const Sample> between(double low, double high) const {
    const auto first =
        std::lower_bound(sorted.begin(), sorted.end(), low, [](const Sample& s, double z) { return s.z < z; });
    const auto last = std::upper_bound(first, sorted.end(), high, [](double z, const Sample& s) { return z < s.z; });
    return {first, last};
  }
};

/// A wall beside a shoulder: its median range by sector at the shoulder's height, NaN where it has none, its slope
/// along the axis, and its scatter about that.
struct WallSide {
  std::vector<double> range;
  double slope = 0, scatter = 0;

  WallSide(std::span<const Sample> samples, double height_mm) {
    if (samples.empty()) {
      range.assign(kRingSectors, kUnknown);
      return;
    }
    const double middle = (samples.front().z + samples.back().z) / 2;
    std::vector<std::vector<double>> low(kRingSectors), high(kRingSectors), all(kRingSectors);
    for (const Sample& s : samples) (s.z < middle ? low : high)[s.sector()].push_back(s.r);
    std::vector<double> slopes;
    for (std::size_t k = 0; k < kRingSectors; ++k)
      if (!low[k].empty() && !high[k].empty()) slopes.push_back(middle_value(high[k]) - middle_value(low[k]));
    if (!slopes.empty()) slope = 2 * middle_value(slopes) / std::max(samples.back().z - samples.front().z, 1e-300);
    for (const Sample& s : samples) all[s.sector()].push_back(s.r - slope * (s.z - height_mm));
    std::vector<double> scatters;
    for (auto& sector : all) {
      range.push_back(middle_value(sector));
      if (!sector.empty()) scatters.push_back(scatter_of(sector, range.back()));
    }
    scatter = middle_value(scatters);
  }
};

/// What the samples about one step say. `low` and `high` keep away from the neighbouring steps.
class Ring {
 public:
  Ring(const SortedSamples& samples, double z, double low, double high)
      : near_(samples.between(low, high)),
        bin_mm_(samples.row_mm / 2),
        middle_mm_(z),
        below_(samples.between(low, (low + z) / 2), z),
        above_(samples.between((high + z) / 2, high), z) {
    std::vector<double> jumps;
    for (std::size_t k = 0; k < kRingSectors; ++k) {
      const double jump = above_.range[k] - below_.range[k];
      if (std::isfinite(jump)) jumps.push_back(jump);
    }
    jump_ = jumps.empty() ? 0 : middle_value(jumps);
  }

  double jump() const { return jump_; }
  /// Both walls rise by less than the step where they are looked at: no end of a dome, no steep cone.
  bool stands_out() const {
    const double rise = std::max(std::abs(below_.slope), std::abs(above_.slope));
    return rise * (near_.back().z - near_.front().z) / 2 < std::abs(jump_);
  }

  /// The height of the ring from the samples on it, else from where those of the outer wall end.
  void place(Shoulder& shoulder) const {
    std::vector<double> on_ring = heights_on_ring();
    if (on_ring.size() >= kFewestOnRing) {
      shoulder.height_mm = middle_value(on_ring);
      // The median of n: sqrt(pi/2) times the standard deviation of the mean.
      shoulder.sd_mm = std::sqrt(std::numbers::pi / 2 / static_cast<double>(on_ring.size())) *
                       scatter_of(on_ring, shoulder.height_mm);
      return;
    }
    // Where the fewest samples lie on the wrong side.
    std::ptrdiff_t wrong = 0;
    for (const Sample& s : near_) wrong += share(s) < 0.5 ? 1 : 0;  // all of the lower wall, were the ring below them
    std::ptrdiff_t fewest = wrong;
    std::size_t above = 0;  // the first sample above
    for (std::size_t k = 0; k + 1 < near_.size(); ++k) {
      const double s = share(near_[k]);
      wrong += s < 0.5 ? -1 : s >= 0.5 ? 1 : 0;
      if (wrong >= fewest) continue;
      fewest = wrong;
      above = k + 1;
    }
    // The wall further out is seen to its edge; the other one may lie in its shadow.
    const bool outer_above = jump_ > 0;
    const auto outer = outer_above ? near_.subspan(above) : near_.first(above);
    if (above == 0) return;
    double spacing = 0;
    for (std::size_t k = 1; k < outer.size(); ++k) spacing = std::max(spacing, outer[k].z - outer[k - 1].z);
    // The row that the edge cuts often shows no line: it may end up to two spacings further on.
    const double open_mm = std::min(2 * spacing, near_[above].z - near_[above - 1].z);
    shoulder.height_mm = outer_above ? outer.front().z - open_mm / 2 : outer.back().z + open_mm / 2;
    shoulder.sd_mm = open_mm / std::sqrt(12.0);
    // Rows beside the edge may show a little of both walls, or of the ring.
    shoulder.edge_mm = open_mm;
  }

  /// What the samples show about the ring at its height.
  void describe(Shoulder& shoulder) const {
    shoulder.jump_mm = jump_;
    std::vector<double> on_ring = heights_on_ring();
    shoulder.seen = on_ring.size();
    shoulder.scatter_mm = scatter_of(on_ring, shoulder.height_mm);
    shoulder.edge_mm = std::max(
        shoulder.edge_mm, kEdgeMargin * std::max(edge(shoulder.height_mm, false), edge(shoulder.height_mm, true)));
  }

 private:
  /// How far a sample is on its way from the lower wall, 0, to the upper one, 1; NaN where walls are unknown.
  double share(const Sample& s) const {
    const double from = below_.range[s.sector()] + below_.slope * (s.z - middle_mm_),
                 to = above_.range[s.sector()] + above_.slope * (s.z - middle_mm_);
    return std::abs(to - from) > kLeastJump * std::abs(jump_) ? (s.r - from) / (to - from) : kUnknown;
  }

  /// How far from the ring samples lie off the wall on that side.
  double edge(double height_mm, bool upper) const {
    const WallSide& wall = upper ? above_ : below_;
    std::vector<int> off, all;
    for (const Sample& s : near_) {
      const double distance = upper ? s.z - height_mm : height_mm - s.z;
      if (distance < 0) continue;
      const auto bin = static_cast<std::size_t>(distance / bin_mm_);
      if (bin >= all.size()) all.resize(bin + 1), off.resize(bin + 1);
      const double range = wall.range[s.sector()] + wall.slope * (s.z - middle_mm_);
      ++all[bin];
      // Nearly exact samples are off by less than rounding.
      if (std::abs(s.r - range) > kOffScales * wall.scatter + 1e-9 * std::abs(range)) ++off[bin];
    }
    std::size_t last = 0;
    for (std::size_t bin = 0, quiet = 0; bin < all.size() && quiet < kQuietBins; ++bin) {
      const bool is_off = off[bin] > kOffShare * all[bin];
      quiet = is_off ? 0 : quiet + 1;
      if (is_off) last = bin + 1;
    }
    return static_cast<double>(last) * bin_mm_;
  }

  std::vector<double> heights_on_ring() const {
    std::vector<double> heights;
    for (const Sample& s : near_)
      if (const double at = share(s); at > kRingFrom && at < kRingTo) heights.push_back(s.z);
    return heights;
  }

  std::span<const Sample> near_;
  double bin_mm_, middle_mm_;
  WallSide below_, above_;
  double jump_ = 0;
};

/// `place` says whether there is a shoulder, and may put it elsewhere.
template <class Place>
std::vector<Shoulder> look_at(const SortedSamples& samples, std::span<const double> heights, const Place& place) {
  std::vector<Shoulder> shoulders;
  for (std::size_t k = 0; k < heights.size(); ++k) {
    const double z = heights[k];
    const double lowest = k > 0 ? (heights[k - 1] + z) / 2 : -std::numeric_limits<double>::infinity();
    const double highest = k + 1 < heights.size() ? (heights[k + 1] + z) / 2 : std::numeric_limits<double>::infinity();
    Shoulder shoulder{.height_mm = z};
    double reach = kReachRows * samples.row_mm;
    for (int round = 0; round < kWider; ++round, reach *= 2) {
      const double low = std::max(z - reach, lowest), high = std::min(z + reach, highest);
      const Ring ring(samples, z, low, high);
      if (ring.jump() == 0) break;
      shoulder = {.height_mm = z};
      if (!place(ring, shoulder)) break;
      ring.describe(shoulder);
      if (shoulder.edge_mm < std::min(z - low, high - z) / 2) break;
    }
    shoulders.push_back(shoulder);
  }
  return shoulders;
}

}  // namespace

std::vector<Shoulder> find_shoulders(ProfileStream& stream) {
  const SortedSamples samples(stream);
  if (samples.sorted.empty()) return {};
  const BaseArcs arcs = BaseArcs::full_circle();
  std::vector<SamplePoint> points;
  points.reserve(samples.sorted.size());
  for (const Sample& s : samples.sorted) points.push_back({s.r, arcs.v_of_theta(s.theta), s.z});
  std::vector<double> heights;
  for (const WallStep& step : find_steps(points, arcs.count(), samples.sorted.front().z, samples.sorted.back().z))
    heights.push_back(step.z_mm);
  auto shoulders = look_at(samples, heights, [](const Ring& ring, Shoulder& shoulder) {
    if (ring.stands_out()) ring.place(shoulder);
    return ring.stands_out();
  });
  std::erase_if(shoulders, [](const Shoulder& shoulder) { return shoulder.jump_mm == 0; });
  return shoulders;
}

std::vector<Shoulder> shoulders_at(ProfileStream& stream, std::span<const double> heights_mm) {
  return look_at(SortedSamples(stream), heights_mm, [](const Ring&, Shoulder&) { return true; });
}

}  // namespace celadon
