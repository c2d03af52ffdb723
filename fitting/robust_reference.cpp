#include "fitting/robust_reference.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <span>
#include <utility>

#include "fitting/fit_ladder.h"
#include "fitting/knot_selection.h"
#include "fitting/sheets.h"

namespace celadon {
namespace {

// Gaps that part the samples of a cell, in cell diagonals: of their ranges, and of what a first surface leaves of them.
constexpr double kRangeGap = 1.5, kResidualGap = 0.5;
// and never less than this many times the spread of the samples.
constexpr double kGapScales = 12;
// What rises from the bridged body beside a handle by this share of the handle, this many cell diagonals and this many
// times the scale is of the handle; cells so far along the axis and one around are looked at, and so many times.
constexpr double kHandleShare = 0.1, kHandleRise = 0.15, kHandleScales = 6;
constexpr int kHandleReach = 2, kHandleRounds = 6;
// Residuals below this share of the size are no scanner's noise.
constexpr double kSmallestScale = 1e-6;
constexpr double kMad = 1.4826;

double median_of(std::vector<double>& values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Middle and half width of the shortest interval with two fifths of the values, the latter as a standard deviation:
// holds out against three fifths that lie anywhere else.
std::pair<double, double> densest(std::vector<double>& values) {
  constexpr double kShare = 0.4, kNormalHalf = 0.5244;
  std::sort(values.begin(), values.end());
  const std::size_t n = values.size();
  const std::size_t span = n < 3 ? n - 1 : static_cast<std::size_t>(std::ceil(kShare * static_cast<double>(n)));
  double middle = values.front(), half = 1e300;
  for (std::size_t k = 0; k + span < n; ++k) {
    const double h = (values[k + span] - values[k]) / 2;
    if (h < half) half = h, middle = (values[k + span] + values[k]) / 2;
  }
  return {middle, half / kNormalHalf};
}

// Median absolute deviation of what lies within three of it: strays far away do not count.
double scale_of(std::vector<double>& sizes) {
  double scale = kMad * median_of(sizes);
  for (int k = 0; k < 3; ++k) {
    std::vector<double> near;
    for (const double e : sizes)
      if (e <= 3 * scale) near.push_back(e);
    scale = kMad * median_of(near);
  }
  return scale;
}

int power_of_two_below(int n) {
  return static_cast<int>(std::bit_floor(static_cast<unsigned>(std::max(1, n))));
}

double tukey(double x) {
  const double f = 1 - x * x / (kTukey * kTukey);
  return f > 0 ? f * f : 0;
}

}  // namespace

RobustReference::RobustReference(const MomentGrid& sums, const FirstLook& look, int degree_u, int degree_v,
                                 JointContinuity continuity, Executor executor)
    : specification_(sums.specification()),
      continuity_(continuity),
      executor_(std::move(executor)),
      cells_(sums, look.samples()),
      spreads_(cells_.size()) {
  specification_.degree_u = degree_u;
  specification_.degree_v = degree_v;
  specification_.z_intervals = power_of_two_below(cells_.along());
  if (specification_.base == BaseKind::sphere) specification_.z_intervals = std::max(specification_.z_intervals, 8);
  specification_.intervals_per_arc = power_of_two_below(cells_.columns_with_samples() / sums.arcs().count());
}

void RobustReference::over_parts(const std::function<void(int part, std::size_t first, std::size_t last)>& work) const {
  executor_(kParts, [&](int part) {
    const auto edge = [&](int k) { return cells_.size() * static_cast<std::size_t>(k) / kParts; };
    work(part, edge(part), edge(part + 1));
  });
}

// To begin with, what lies about the middle of its cluster; then what lies where most residuals of its cell lie, which
// leads to the body from afar; at last what lies near the function.
void RobustReference::accumulate(Weights weights, std::size_t first, std::size_t last, MomentGrid& grid) const {
  std::vector<double> r, v, z, w, fitted;
  for (std::size_t c = first; c < last; ++c)
    for (const Cluster& cluster : cells_[c].clusters) {
      if (!cluster.accepted) continue;
      r.clear(), v.clear(), z.clear(), w.clear();
      for (int k = cluster.first; k < cluster.first + cluster.count; ++k) {
        const CellPoint& p = cells_[c].points[static_cast<std::size_t>(k)];
        r.push_back(p.r_mm);
        v.push_back(p.v);
        z.push_back(p.z_mm);
      }
      fitted.resize(r.size());
      double trim = 0;
      if (weights != Weights::about_cluster) {
        polynomials_->evaluate(v.data(), z.data(), r.size(), fitted.data());
      } else {
        for (std::size_t k = 0; k < r.size(); ++k) fitted[k] = std::abs(r[k] - cluster.median);
        trim = kTukey * kMad * median_of(fitted);
      }
      std::size_t kept = 0;
      for (std::size_t k = 0; k < r.size(); ++k) {
        double weight = std::abs(r[k] - cluster.median) <= trim;
        if (weights == Weights::about_cell) weight = tukey((r[k] - fitted[k] - spreads_[c].middle) / spreads_[c].width);
        if (weights == Weights::about_function) weight = tukey((r[k] - fitted[k]) / spreads_[c].limit);
        if (weight <= 0) continue;
        r[kept] = r[k], v[kept] = v[k], z[kept] = z[k];
        w.push_back(weight);
        ++kept;
      }
      grid.add_synchronised(std::span(r).first(kept), std::span(v).first(kept), std::span(z).first(kept), w);
    }
}

bool RobustReference::solve(Weights weights) {
  std::vector<MomentGrid> grids(kParts, MomentGrid(specification_));
  over_parts([&](int part, std::size_t first, std::size_t last) {
    accumulate(weights, first, last, grids[static_cast<std::size_t>(part)]);
  });
  MomentGrid& grid = grids.front();
  for (std::size_t part = 1; part < grids.size(); ++part) grid.merge(grids[part]);
  if (grid.samples() == 0) return false;
  CellBand band{grid.z_cells(), 0};
  for (int j = 0; j < grid.v_cells(); ++j)
    for (int i = 0; i < grid.z_cells(); ++i)
      if (grid.cell_weight(i, j) > 0) band.first = std::min(band.first, i), band.last = std::max(band.last, i + 1);
  if (specification_.base == BaseKind::sphere) band.poles = {band.first == 0, band.last == grid.z_cells()};
  const FitLadder ladder(grid, band, specification_.degree_u, specification_.degree_v, continuity_);
  const auto fit = solve_member(ladder, {}, {}, kStiffWeight);
  if (!fit) return false;
  function_ = range_function(*fit->equations, fit->free);
  polynomials_.emplace(function_);
  unknowns_ = fit->parameters;
  unknowns_around_ = fit->equations->matrix().count_v();
  return true;
}

// Keys of all points become residuals; each cell's limit is the size of the middle of its accepted ones (what the
// reference cannot follow is no outlier) and the spread about it, at least the spread everywhere and half of the
// neighbours'.
// Each cell's limit is the size of the middle of its accepted residuals (what the reference cannot follow is no
// outlier) and the spread about it, at least the spread everywhere and half of the neighbours'.
void RobustReference::update_limits() {
  std::array<std::vector<double>, kParts> sizes_of_part;
  over_parts([&](int part, std::size_t first, std::size_t last) {
    find_spreads(first, last, sizes_of_part[static_cast<std::size_t>(part)]);
  });
  std::vector<double> sizes;
  for (const auto& part : sizes_of_part) sizes.insert(sizes.end(), part.begin(), part.end());
  scale_ = std::max(scale_of(sizes), kSmallestScale * std::max(specification_.z_end_mm - specification_.z_start_mm,
                                                               function_.coefficients().cwiseAbs().maxCoeff()));
  for (Spread& s : spreads_) s.width = std::max(s.width, scale_);
  // What the reference cannot follow is not in one cell alone: the second largest of the neighbourhood bounds it.
  std::vector<double> local(cells_.size());
  for (std::size_t k = 0; k < cells_.size(); ++k) {
    double largest = 0, second = 0;
    cells_.visit_neighbourhood(k, [&](std::size_t other) {
      const double size = spreads_[other].width + std::abs(spreads_[other].middle);
      second = std::max(second, std::min(size, largest));
      largest = std::max(largest, size);
    });
    local[k] = std::min(spreads_[k].width + std::abs(spreads_[k].middle), second);
  }
  for (std::size_t k = 0; k < cells_.size(); ++k) {
    if (rise_beside(k, 1) > 0) {  // there the reference is a bridge, and what it does not follow may be the handle
      spreads_[k].limit = std::min(spreads_[k].width, 2 * scale_);
      continue;
    }
    spreads_[k].limit = local[k];
    cells_.visit_neighbourhood(
        k, [&](std::size_t other) { spreads_[k].limit = std::max(spreads_[k].limit, local[other] / 2); });
  }
}
// Keys of the points become residuals.
void RobustReference::find_spreads(std::size_t first, std::size_t last, std::vector<double>& sizes) {
  std::vector<double> residuals, v, z, fitted;
  for (std::size_t c = first; c < last; ++c) {
    SampleCell& cell = cells_[c];
    const std::size_t n = cell.points.size();
    spreads_[c] = {};
    v.clear(), z.clear(), residuals.clear();
    for (const CellPoint& p : cell.points) v.push_back(p.v), z.push_back(p.z_mm);
    fitted.resize(n);
    polynomials_->evaluate(v.data(), z.data(), n, fitted.data());
    for (std::size_t k = 0; k < n; ++k) cell.points[k].key = cell.points[k].r_mm - fitted[k];
    for (const Cluster& cluster : cell.clusters)
      for (int k = cluster.first; cluster.accepted && k < cluster.first + cluster.count; ++k)
        residuals.push_back(cell.points[static_cast<std::size_t>(k)].key);
    if (residuals.empty()) continue;
    const auto [middle, spread] = densest(residuals);
    // Sorted now: about their median, which few samples bias less than where they lie densest.
    for (const double e : residuals) sizes.push_back(std::abs(e - residuals[residuals.size() / 2]));
    spreads_[c] = {middle, spread, 0};
  }
}

bool RobustReference::iterate(std::initializer_list<Weights> steps) {
  for (const Weights weights : steps) {
    if (!solve(weights)) return false;
    update_limits();
  }
  return true;
}

// How far the handles stand out that lie in the same or a next column, at most so many rows away; 0: none do.
double RobustReference::rise_beside(std::size_t cell, int rows) const {
  const int i = static_cast<int>(cell) % cells_.along(), j = static_cast<int>(cell) / cells_.along();
  double rise = 0;
  for (int dj = -1; dj <= 1; ++dj)
    for (int di = -rows; di <= rows; ++di)
      if (i + di >= 0 && i + di < cells_.along())
        for (const Cluster& cluster : cells_[cells_.index(i + di, cells_.column(j + dj))].clusters)
          rise = std::max(rise, cluster.handle_mm);
  return rise;
}

// Where a handle runs into the body nothing jumps. What lies around it is left out, the body is bridged there, and what
// rises from the bridge by a share of the handle's own rise is of the handle; so again around that.
bool RobustReference::follow_handles() {
  for (int round = 0; round < kHandleRounds; ++round) {
    struct Neighbour {
      std::size_t cell;
      Cluster* cluster;
      double rise = 0;
    };
    std::vector<Neighbour> handles, ring;
    for (std::size_t c = 0; c < cells_.size(); ++c)
      for (Cluster& cluster : cells_[c].clusters) {
        if (cluster.handle_mm > 0) handles.push_back({c, &cluster});
        if (cluster.accepted && rise_beside(c, kHandleReach) > 0) ring.push_back({c, &cluster});
      }
    if (handles.empty()) return true;
    for (const Neighbour& n : ring) n.cluster->accepted = false;
    if (!iterate({Weights::about_function})) return false;
    const auto upper_quartile = [&](const Neighbour& n) {
      std::vector<double> residuals;
      for (int p = n.cluster->first; p < n.cluster->first + n.cluster->count; ++p)
        residuals.push_back(cells_[n.cell].points[static_cast<std::size_t>(p)].key);
      std::sort(residuals.begin(), residuals.end());
      return residuals[residuals.size() * 3 / 4];
    };
    for (Neighbour& n : ring) n.cluster->accepted = true, n.rise = upper_quartile(n);
    for (const Neighbour& n : handles) n.cluster->handle_mm = std::max(n.cluster->handle_mm, upper_quartile(n));
    bool grown = false;
    for (bool more = true; more;) {  // every part of a handle knows how far the whole stands out
      more = false;
      for (const Neighbour& n : handles) {
        const double rise = rise_beside(n.cell, kHandleReach);
        more = more || rise > n.cluster->handle_mm;
        n.cluster->handle_mm = rise;
      }
      for (const Neighbour& n : ring) {
        const double rise = rise_beside(n.cell, 1);
        if (!n.cluster->accepted || !(rise > 0) ||
            n.rise < std::max({kHandleShare * rise, kHandleScales * scale_,
                               kHandleRise * cells_.diagonal_mm(n.cluster->median)}))
          continue;
        n.cluster->accepted = false;
        n.cluster->handle_mm = rise;
        more = grown = true;
      }
    }
    if (!iterate({Weights::about_function, Weights::about_function})) return false;
    if (!grown) return true;
  }
  return true;
}

// First the clusters of the ranges, then, with what a surface through the body leaves of the samples, those of the
// residuals: they part what lies close over a slanting body.
bool RobustReference::fit() {
  set_strays_apart(cells_);
  find_clusters(cells_, kRangeGap, 0);
  choose_body(cells_);
  using enum Weights;
  if (!iterate({about_cluster, about_cell, about_cell, about_function})) return false;
  find_clusters(cells_, kResidualGap, kGapScales * scale_);
  choose_body(cells_);
  update_limits();
  if (!iterate({about_cell, about_cell, about_function, about_function, about_function}) || !follow_handles())
    return false;
  for (std::size_t c = 0; c < cells_.size(); ++c)
    for (const CellPoint& p : cells_[c].points) strangers_ = strangers_ || std::abs(p.key) > 6 * spreads_[c].limit;
  return true;
}

RobustReference::Verdict RobustReference::verdict(double v, double z, double r, double residual) const {
  const std::size_t at = cells_.index_of(v, z);
  const double weight = tukey(residual / (spreads_[at].limit > 0 ? spreads_[at].limit : scale_));
  if (weight > 0) return {weight, Kind::good};
  const double margin = cells_.diagonal_mm(r) / 2;
  for (const Cluster& c : cells_[at].clusters)
    if (c.significant && !c.accepted && r >= c.low - margin && r <= c.high + margin) return {0, Kind::unfollowable};
  return {0, Kind::outlier};
}

double RobustReference::percentile95(const RangeFunction& function) const {
  std::vector<double> r, v, z, sizes;
  for (std::size_t c = 0; c < cells_.size(); ++c)
    for (const Cluster& cluster : cells_[c].clusters)
      for (int k = cluster.first; cluster.accepted && k < cluster.first + cluster.count; ++k) {
        const CellPoint& p = cells_[c].points[static_cast<std::size_t>(k)];
        if (p.z_mm < function.base().band_start || p.z_mm > function.base().band_end) continue;
        if (tukey(p.key / spreads_[c].limit) <= 0) continue;
        r.push_back(p.r_mm), v.push_back(p.v), z.push_back(p.z_mm);
      }
  if (r.empty()) return 0;
  sizes.resize(r.size());
  CellPolynomials(function).evaluate(v.data(), z.data(), r.size(), sizes.data());
  for (std::size_t k = 0; k < r.size(); ++k) sizes[k] = std::abs(r[k] - sizes[k]);
  const auto at = sizes.begin() + static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(sizes.size() - 1));
  std::nth_element(sizes.begin(), at, sizes.end());
  return *at;
}

}  // namespace celadon
