#include "fitting/robust_reference.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <numeric>

#include "fitting/fit_ladder.h"
#include "fitting/knot_selection.h"

namespace celadon {
namespace {

constexpr double kCells = 2048, kSamplesPerCell = 12;
// Ranges of one cell that leave a gap of more than this many cell diagonals are two sheets.
constexpr double kGap = 1.5;
// Slopes beyond which neighbouring cells do not continue one another, around and along the axis.
constexpr double kSlopeAround = 2.5, kSlopeAlong = 4;
// A cluster with less than this share of its cell's samples holds strays.
constexpr double kStrayShare = 0.2;
// Sheets of fewer cells than this are chance.
constexpr int kSheetCells = 3;
// Residuals below this share of the size are no scanner's noise.
constexpr double kSmallestScale = 1e-6;
constexpr double kMad = 1.4826;

double median_of(std::vector<double>& values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

int power_of_two_below(int n) {
  return static_cast<int>(std::bit_floor(static_cast<unsigned>(std::max(1, n))));
}

double tukey(double x) {
  const double f = 1 - x * x / (kTukey * kTukey);
  return f > 0 ? f * f : 0;
}

class UnionFind {
 public:
  explicit UnionFind(std::size_t n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), std::size_t{0}); }
  std::size_t find(std::size_t k) {
    while (parent_[k] != k) k = parent_[k] = parent_[parent_[k]];
    return k;
  }
  void join(std::size_t a, std::size_t b) { parent_[std::max(find(a), find(b))] = std::min(find(a), find(b)); }

 private:
  std::vector<std::size_t> parent_;
};

}  // namespace

const RobustReference::Cluster* RobustReference::Cell::accepted() const {
  for (const Cluster& c : clusters)
    if (c.accepted) return &c;
  return nullptr;
}

RobustReference::RobustReference(const MomentGrid& sums, int degree_u, int degree_v, JointContinuity continuity)
    : specification_(sums.specification()), continuity_(continuity), arcs_(sums.arcs()) {
  const double weight = static_cast<double>(std::max<std::size_t>(sums.samples(), 1));
  const double r = sums.sum_weight() > 0 ? sums.sum_weighted_range() / sums.sum_weight() : 1;
  int lowest = sums.z_cells(), highest = 0;
  for (int j = 0; j < sums.v_cells(); ++j)
    for (int i = 0; i < sums.z_cells(); ++i)
      if (sums.cell_weight(i, j) > 0) lowest = std::min(lowest, i), highest = std::max(highest, i + 1);
  const double used = std::max(highest - lowest, 1) / static_cast<double>(sums.z_cells());
  const double height = (specification_.z_end_mm - specification_.z_start_mm) * used;
  const double cells = std::clamp(weight / kSamplesPerCell, 1.0, kCells);
  cells_v_ = std::clamp(static_cast<int>(std::sqrt(cells * 2 * std::numbers::pi * r / height)), 4, 256);
  cells_z_ = std::clamp(static_cast<int>(cells / cells_v_ / used), 1, 1024);
  cell_height_ = (specification_.z_end_mm - specification_.z_start_mm) / cells_z_;
  specification_.degree_u = degree_u;
  specification_.degree_v = degree_v;
  specification_.z_intervals = power_of_two_below(cells_z_);
  specification_.intervals_per_arc = power_of_two_below(cells_v_ / arcs_.count());
  cells_.resize(static_cast<std::size_t>(cells_z_) * static_cast<std::size_t>(cells_v_));
}

int RobustReference::index_of(double v, double z) const {
  const int i = std::clamp(static_cast<int>((z - specification_.z_start_mm) / cell_height_), 0, cells_z_ - 1);
  const int j = std::clamp(static_cast<int>(v * cells_v_ / arcs_.count()), 0, cells_v_ - 1);
  return j * cells_z_ + i;
}

double RobustReference::diagonal(double r) const {
  return std::hypot(cell_height_, 2 * std::numbers::pi * r / cells_v_);
}

// Each cell keeps an even sample of what falls into it, chosen by a fixed hash of the order of arrival.
void RobustReference::add(const Profile& profile, const double* v) {
  for (std::size_t k = 0; k < profile.size(); ++k) {
    const Point p{profile.r_mm[k], v[k], profile.z_mm[k], profile.theta_rad[k]};
    if (!(p.r > 0 && std::isfinite(p.r) && p.v >= 0 && p.z >= specification_.z_start_mm &&
          p.z <= specification_.z_end_mm))
      continue;
    Cell& cell = cells_[static_cast<std::size_t>(index_of(p.v, p.z))];
    ++cell.seen;
    if (cell.points.size() < kPerCell) {
      cell.points.push_back(p);
      continue;
    }
    std::uint64_t hash = cell.seen * 0x9e3779b97f4a7c15u;
    hash ^= hash >> 29;
    hash *= 0xbf58476d1ce4e5b9u;
    hash ^= hash >> 32;
    const std::size_t slot = hash % cell.seen;
    if (slot < kPerCell) cell.points[slot] = p;
  }
}

void RobustReference::split(Cell& cell) const {
  auto& points = cell.points;
  cell.clusters.clear();
  if (points.empty()) return;
  std::sort(points.begin(), points.end(), [](const Point& a, const Point& b) { return a.r < b.r; });
  const double gap = kGap * diagonal(points[points.size() / 2].r);
  const auto n = static_cast<int>(points.size());
  const auto range = [&](int k) { return points[static_cast<std::size_t>(k)].r; };
  for (int first = 0; first < n;) {
    int last = first + 1;
    while (last < n && range(last) - range(last - 1) <= gap) ++last;
    Cluster c{range(first), range(last - 1), range((first + last) / 2), first, last - first};
    c.significant = n < 3 ? first == 0 && last == n : c.count >= std::max(2.0, kStrayShare * n);
    c.steep = range(last - 1 - c.count / 10) - range(first + c.count / 10) > 3 * diagonal(c.median);
    cell.clusters.push_back(c);
    first = last;
  }
}

// Clusters that continue one another from cell to cell form sheets. The body is the largest sheet, every sheet that
// goes most of the way around, and those that only lack neighbours; a sheet cut off by jumps (a handle) is not.
void RobustReference::choose_body() {
  struct Node {
    std::size_t cell;
    std::size_t cluster;
  };
  std::vector<Node> nodes;
  std::vector<std::vector<std::size_t>> in_cell(cells_.size());
  for (std::size_t c = 0; c < cells_.size(); ++c)
    for (std::size_t k = 0; k < cells_[c].clusters.size(); ++k)
      if (cells_[c].clusters[k].significant) {
        in_cell[c].push_back(nodes.size());
        nodes.push_back({c, k});
      }
  if (nodes.empty()) return;
  const auto cluster = [&](std::size_t n) -> Cluster& { return cells_[nodes[n].cell].clusters[nodes[n].cluster]; };
  UnionFind sheets(nodes.size());
  std::vector<int> refused(nodes.size(), 0);
  constexpr int kReach = 4;  // cells without samples that a sheet may span
  for (std::size_t a = 0; a < nodes.size(); ++a) {
    const int i = static_cast<int>(nodes[a].cell) % cells_z_, j = static_cast<int>(nodes[a].cell) / cells_z_;
    for (const bool around : {true, false}) {
      for (int step = 1; step <= kReach; ++step) {
        const int ni = around ? i : i + step, nj = around ? (j + step) % cells_v_ : j;
        if (ni >= cells_z_ || (around && step >= cells_v_)) break;
        const auto& others = in_cell[static_cast<std::size_t>(nj * cells_z_ + ni)];
        if (others.empty()) continue;
        bool linked = false;
        for (const std::size_t b : others) {
          const Cluster &ca = cluster(a), &cb = cluster(b);
          const double distance =
              step * (around ? 2 * std::numbers::pi * (ca.median + cb.median) / 2 / cells_v_ : cell_height_);
          // A steep cluster runs over many ranges: it continues along the axis whatever it touches, around only steep
          // ones.
          const bool continues =
              ca.steep || cb.steep
                  ? (!around || ca.steep == cb.steep) && ca.low <= cb.high + distance && cb.low <= ca.high + distance
                  : std::abs(ca.median - cb.median) <= (around ? kSlopeAround : kSlopeAlong) * distance;
          if (!continues) continue;
          sheets.join(a, b);
          linked = true;
        }
        if (!linked) {
          ++refused[a];
          for (const std::size_t b : others) ++refused[b];
        }
        break;
      }
    }
  }
  struct Sheet {
    std::size_t samples = 0;
    int cells = 0, refused = 0, columns = 0, last_column = -1;
  };
  std::vector<Sheet> of(nodes.size());
  for (std::size_t n = 0; n < nodes.size(); ++n) {  // cells run column by column
    Sheet& sheet = of[sheets.find(n)];
    const Cell& cell = cells_[nodes[n].cell];
    sheet.samples += cell.seen * static_cast<std::size_t>(cluster(n).count) / cell.points.size() + 1;
    ++sheet.cells;
    sheet.refused += refused[n];
    const int column = static_cast<int>(nodes[n].cell) / cells_z_;
    if (column != sheet.last_column) ++sheet.columns, sheet.last_column = column;
  }
  std::size_t largest = 0;
  for (const Sheet& sheet : of) largest = std::max(largest, sheet.samples);
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const Sheet& sheet = of[sheets.find(n)];
    cluster(n).accepted = sheet.samples == largest || 4 * sheet.columns >= 3 * cells_v_ || sheet.refused == 0 ||
                          5 * sheet.samples >= largest;
    // Too small for a part of the object: strays that happen to lie together.
    if (!cluster(n).accepted && sheet.cells < kSheetCells) cluster(n).significant = false;
  }
}

// Where the body has several clusters in a cell, the surface can follow one: the one that its neighbours continue.
void RobustReference::choose_single_values() {
  const auto accepted_count = [](const Cell& c) {
    return std::count_if(c.clusters.begin(), c.clusters.end(), [](const Cluster& k) { return k.accepted; });
  };
  for (std::size_t c = 0; c < cells_.size(); ++c) {
    Cell& cell = cells_[c];
    if (accepted_count(cell) < 2) continue;
    const int i = static_cast<int>(c) % cells_z_, j = static_cast<int>(c) / cells_z_;
    double sum = 0, count = 0;
    for (int reach = 1; reach <= 8 && count < 3; ++reach)
      for (int dj = -reach; dj <= reach; ++dj)
        for (int di = -reach; di <= reach; ++di) {
          if (std::max(std::abs(di), std::abs(dj)) != reach || i + di < 0 || i + di >= cells_z_) continue;
          const Cell& other =
              cells_[static_cast<std::size_t>(((j + dj) % cells_v_ + cells_v_) % cells_v_ * cells_z_ + i + di)];
          if (accepted_count(other) != 1) continue;
          sum += other.accepted()->median;
          ++count;
        }
    const double expected = count > 0 ? sum / count : 0;
    const Cluster* best = nullptr;
    for (const Cluster& k : cell.clusters) {
      if (!k.accepted) continue;
      const bool better = !best || (count > 0 ? std::abs(k.median - expected) < std::abs(best->median - expected)
                                              : k.count > best->count);
      if (better) best = &k;
    }
    for (Cluster& k : cell.clusters) k.accepted = &k == best;
  }
}

bool RobustReference::solve(bool weighted) {
  MomentGrid grid(specification_);
  std::vector<double> r, theta, z, w, fitted;
  for (const Cell& cell : cells_) {
    const Cluster* c = cell.accepted();
    if (!c) continue;
    const auto begin = cell.points.begin() + c->first, end = begin + c->count;
    r.clear(), theta.clear(), z.clear(), w.clear();
    for (auto p = begin; p != end; ++p) {
      r.push_back(p->r);
      theta.push_back(p->theta);
      z.push_back(p->z);
    }
    fitted.resize(r.size());
    double trim = 0;  // to begin with: what lies about the middle of its cell
    if (weighted) {
      function_.evaluate(theta.data(), z.data(), r.size(), fitted.data());
    } else {
      for (std::size_t k = 0; k < r.size(); ++k) fitted[k] = std::abs(r[k] - c->median);
      trim = kTukey * kMad * median_of(fitted);
    }
    std::size_t kept = 0;
    for (std::size_t k = 0; k < r.size(); ++k) {
      const double weight = weighted ? tukey((r[k] - fitted[k]) / cell.limit) : std::abs(r[k] - c->median) <= trim;
      if (weight <= 0) continue;
      r[kept] = r[k], theta[kept] = theta[k], z[kept] = z[k];
      w.push_back(weight);
      ++kept;
    }
    grid.add(std::span(r).first(kept), std::span(theta).first(kept), std::span(z).first(kept), w);
  }
  if (grid.samples() == 0) return false;
  CellBand band{grid.z_cells(), 0};
  for (int j = 0; j < grid.v_cells(); ++j)
    for (int i = 0; i < grid.z_cells(); ++i)
      if (grid.cell_weight(i, j) > 0) band.first = std::min(band.first, i), band.last = std::max(band.last, i + 1);
  const FitLadder ladder(grid, band, specification_.degree_u, specification_.degree_v, continuity_);
  const auto fit = solve_member(grid, ladder, {}, {});
  if (!fit) return false;
  function_ = range_function(*fit->equations, fit->free);
  return true;
}

// Local scale: the size of the median residual (what the reference cannot follow) and the spread about it, at least the
// spread everywhere and half of the neighbours' scale.
void RobustReference::update_limits() {
  std::vector<double> spreads, residuals, theta, z, fitted;
  for (Cell& cell : cells_) {
    const Cluster* c = cell.accepted();
    cell.limit = 0;
    if (!c) continue;
    theta.clear(), z.clear(), residuals.clear();
    for (int k = c->first; k < c->first + c->count; ++k) {
      const Point& p = cell.points[static_cast<std::size_t>(k)];
      theta.push_back(p.theta);
      z.push_back(p.z);
      residuals.push_back(p.r);
    }
    fitted.resize(z.size());
    function_.evaluate(theta.data(), z.data(), z.size(), fitted.data());
    for (std::size_t k = 0; k < residuals.size(); ++k) residuals[k] -= fitted[k];
    cell.middle = median_of(residuals);
    for (double& e : residuals) e = std::abs(e - cell.middle);
    spreads.insert(spreads.end(), residuals.begin(), residuals.end());
    cell.limit = kMad * median_of(residuals);
  }
  scale_ =
      std::max(kMad * median_of(spreads), kSmallestScale * std::max(specification_.z_end_mm - specification_.z_start_mm,
                                                                    function_.coefficients().cwiseAbs().maxCoeff()));
  std::vector<double> local(cells_.size());
  for (std::size_t k = 0; k < cells_.size(); ++k)
    local[k] = std::max(cells_[k].limit, scale_) + (cells_[k].limit > 0 ? std::abs(cells_[k].middle) : 0);
  for (std::size_t k = 0; k < cells_.size(); ++k) {
    const int i = static_cast<int>(k) % cells_z_, j = static_cast<int>(k) / cells_z_;
    double limit = local[k];
    for (int dj = -1; dj <= 1; ++dj)
      for (int di = -1; di <= 1; ++di) {
        if (i + di < 0 || i + di >= cells_z_) continue;
        limit =
            std::max(limit, local[static_cast<std::size_t>((j + dj + cells_v_) % cells_v_ * cells_z_ + i + di)] / 2);
      }
    cells_[k].limit = limit;
  }
}

bool RobustReference::fit() {
  for (Cell& cell : cells_) split(cell);
  choose_body();
  choose_single_values();
  if (!solve(false)) return false;
  update_limits();
  for (int k = 0; k < 8; ++k) {
    if (!solve(true)) return false;
    update_limits();
  }
  for (const Cell& cell : cells_) {
    if (cell.points.empty()) continue;
    for (const Point& p : cell.points) {
      const double e = p.r - function_(p.theta, p.z);
      strangers_ = strangers_ || std::abs(e) > 6 * cell.limit;
    }
  }
  return true;
}

RobustReference::Verdict RobustReference::verdict(double v, double z, double r, double residual) const {
  const Cell& cell = cells_[static_cast<std::size_t>(index_of(v, z))];
  const double weight = tukey(residual / (cell.limit > 0 ? cell.limit : scale_));
  if (weight > 0) return {weight, Kind::good};
  const double margin = diagonal(r) / 2;
  for (const Cluster& c : cell.clusters)
    if (c.significant && !c.accepted && r >= c.low - margin && r <= c.high + margin) return {0, Kind::unfollowable};
  return {0, Kind::outlier};
}

double RobustReference::percentile95(const RangeFunction& function) const {
  std::vector<double> sizes;
  for (const Cell& cell : cells_) {
    const Cluster* c = cell.accepted();
    if (!c) continue;
    for (int k = c->first; k < c->first + c->count; ++k) {
      const Point& p = cell.points[static_cast<std::size_t>(k)];
      if (p.z < function.base().z_start_mm || p.z > function.base().z_end_mm) continue;
      if (tukey((p.r - function_(p.theta, p.z)) / cell.limit) <= 0) continue;
      sizes.push_back(std::abs(p.r - function(p.theta, p.z)));
    }
  }
  if (sizes.empty()) return 0;
  const auto at = sizes.begin() + static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(sizes.size() - 1));
  std::nth_element(sizes.begin(), at, sizes.end());
  return *at;
}

}  // namespace celadon
