#include "fitting/sheets.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <utility>
#include <vector>

namespace celadon {
namespace {

// A sample with less than this share of the points of a cell within half a diagonal is looked at in its neighbourhood:
// an ellipsoid one cell in each direction and half a diagonal along the ray. On a surface it holds about three times
// the points of a cell, among evenly spread strays a small part of one.
constexpr double kOwnSupport = 0.35, kSpaceSupport = 0.2;
// A cluster with less than this share of its cell's samples holds strays.
constexpr double kStrayShare = 0.2;
// Cells with more samples than this show smaller gaps.
constexpr double kGapSamples = 8;
// Slope beyond which neighbouring clusters do not continue one another, and what noise and curvature may add, in cell
// diagonals.
constexpr double kSlope = 4, kMargin = 0.15;
// Sheets of fewer cells than this are chance.
constexpr int kSheetCells = 3;
// Cells without samples that a sheet may span.
constexpr int kReach = 4;
// Sheets that share at least this part of their cells with larger ones contradict them; that part if they are large.
constexpr double kContradicted = 1. / 3, kLargeContradicted = 2. / 3, kLargeShare = 0.2;
// What protrudes: falls on both sides by this share of its width, which is less than this part of the turn.
constexpr double kDropPerWidth = 0.5, kWidestShare = 0.25;

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

bool by_key(const CellPoint& a, const CellPoint& b) {
  return a.key < b.key;
}

double wrapped(double dv, double turn) {
  return dv > turn / 2 ? dv - turn : (dv < -turn / 2 ? dv + turn : dv);
}

// Points of the neighbourhood inside the ellipsoid about p, against how many a flat surface would have there.
bool has_company(const SampleCells& cells, std::size_t cell, const CellPoint& p) {
  const double per_z = 1 / cells.height(), per_v = cells.around() / cells.turn_v(),
               per_r = 2 / cells.diagonal_mm(p.r_mm);
  double inside = 0, points = 0, filled = 0;
  cells.visit_neighbourhood(cell, [&](std::size_t other) {
    points += static_cast<double>(cells[other].points.size());
    filled += !cells[other].points.empty();
    for (const CellPoint& q : cells[other].points) {
      const double r = (q.r_mm - p.r_mm) * per_r;
      if (std::abs(r) > 1) continue;
      const double z = (q.z_mm - p.z_mm) * per_z, v = wrapped(q.v - p.v, cells.turn_v()) * per_v;
      inside += r * r + z * z + v * v <= 1;
    }
  });
  return inside - 1 >= kSpaceSupport * points / filled;
}

// A line across the cell parts the samples of two clusters: they lie beside each other, not over each other.
bool lie_apart(const SampleCell& cell, const Cluster& a, const Cluster& b, double per_z, double per_v) {
  const double bearable = 0.15 * std::min(a.count, b.count);
  std::array<std::pair<double, int>, SampleCells::kPerCell> at;
  for (const auto& [along_v, along_z] : {std::pair(1., 0.), {0., 1.}, {.7, .7}, {.7, -.7}}) {
    std::size_t n = 0;
    for (const Cluster* c : {&a, &b})
      for (int k = c->first; k < c->first + c->count; ++k) {
        const CellPoint& p = cell.points[static_cast<std::size_t>(k)];
        at[n++] = {along_v * p.v * per_v + along_z * p.z_mm * per_z, c == &a};
      }
    std::sort(at.begin(), at.begin() + static_cast<std::ptrdiff_t>(n));
    int wrong = b.count;  // a below the line, b above it: at first all below
    int least = std::min(wrong, a.count);
    for (std::size_t k = n; k-- > 0;) {
      wrong += at[k].second ? 1 : -1;
      least = std::min({least, wrong, a.count + b.count - wrong});
    }
    if (least <= bearable) return true;
  }
  return false;
}

struct Node {
  std::size_t cell = 0;
  std::size_t cluster = 0;
  int i = 0, j = 0;
};

// The significant clusters as a graph over the grid of cells.
class Clusters {
 public:
  explicit Clusters(SampleCells& cells) : cells_(cells), first_(cells.size() + 1) {
    for (std::size_t c = 0; c < cells.size(); ++c) {
      first_[c] = nodes_.size();
      for (std::size_t k = 0; k < cells[c].clusters.size(); ++k)
        if (cells[c].clusters[k].significant)
          nodes_.push_back({c, k, static_cast<int>(c) % cells.along(), static_cast<int>(c) / cells.along()});
    }
    first_[cells.size()] = nodes_.size();
  }
  std::size_t size() const { return nodes_.size(); }
  const Node& node(std::size_t n) const { return nodes_[n]; }
  Cluster& operator[](std::size_t n) const { return cells_[nodes_[n].cell].clusters[nodes_[n].cluster]; }
  SampleCell& cell(std::size_t n) const { return cells_[nodes_[n].cell]; }
  const SampleCells& cells() const { return cells_; }
  /// Nodes [first, last) of the cell (i, j).
  std::pair<std::size_t, std::size_t> of(int i, int j) const {
    const std::size_t c = cells_.index(i, cells_.column(j));
    return {first_[c], first_[c + 1]};
  }
  double samples(std::size_t n) const {
    return static_cast<double>(cell(n).seen * static_cast<std::size_t>((*this)[n].count)) /
           static_cast<double>(cell(n).points.size());
  }
  /// How far apart two clusters lie, along the ray and across it, the second further around (or along).
  struct Step {
    double rise, distance;
  };
  Step step(std::size_t a, std::size_t b, bool around) const {
    const Cluster &ca = (*this)[a], &cb = (*this)[b];
    double across = cb.z_low - ca.z_high;
    if (around) {
      across = cb.v_low - ca.v_high;
      if (node(b).j < node(a).j) across += cells_.turn_v();
      across *= cells_.arc_rad() * (ca.median + cb.median) / 2;
    }
    return {std::max(0.0, std::max(ca.low, cb.low) - std::min(ca.high, cb.high)), std::max(0.0, across)};
  }
  bool continues(const Step& s, double r) const {
    return s.rise <= kSlope * s.distance + kMargin * cells_.diagonal_mm(r);
  }
  bool contradict(std::size_t a, std::size_t b) const {
    return !lie_apart(cell(a), (*this)[a], (*this)[b], 1 / cells_.height(), cells_.around() / cells_.turn_v());
  }

 private:
  SampleCells& cells_;
  std::vector<Node> nodes_;
  std::vector<std::size_t> first_;
};

// Clusters that continue one another from cell to cell form sheets. From the largest down a sheet belongs to the body
// unless it lies over what does.
void accept_sheets(Clusters& clusters) {
  UnionFind sheets(clusters.size());
  const SampleCells& cells = clusters.cells();
  for (std::size_t a = 0; a < clusters.size(); ++a)
    for (const bool around : {true, false})
      for (int k = 1; k <= kReach; ++k) {
        const int i = clusters.node(a).i + (around ? 0 : k), j = clusters.node(a).j + (around ? k : 0);
        if (i >= cells.along() || k >= cells.around()) break;
        const auto [first, last] = clusters.of(i, j);
        for (std::size_t b = first; b < last; ++b)
          if (clusters.continues(clusters.step(a, b, around), clusters[a].median)) sheets.join(a, b);
        if (first < last) break;
      }
  struct Sheet {
    std::size_t root = 0;
    double samples = 0;
    int cells = 0, contradicted = 0, columns = 0, last_column = -1;
  };
  std::vector<Sheet> of(clusters.size());
  for (std::size_t n = 0; n < clusters.size(); ++n) {  // cells run column by column
    Sheet& sheet = of[sheets.find(n)];
    sheet.root = sheets.find(n);
    sheet.samples += clusters.samples(n);
    ++sheet.cells;
    if (clusters.node(n).j != sheet.last_column) ++sheet.columns, sheet.last_column = clusters.node(n).j;
  }
  std::vector<std::size_t> order(clusters.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::erase_if(order, [&](std::size_t n) { return of[n].cells == 0; });
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return of[a].samples > of[b].samples; });
  std::vector<std::vector<std::size_t>> members(clusters.size());
  for (std::size_t n = 0; n < clusters.size(); ++n) members[sheets.find(n)].push_back(n);
  for (const std::size_t root : order) {
    Sheet& sheet = of[root];
    for (const std::size_t n : members[root]) {
      const auto [first, last] = clusters.of(clusters.node(n).i, clusters.node(n).j);
      bool contradicted = false;
      for (std::size_t b = first; b < last; ++b)
        contradicted =
            contradicted || (b != n && clusters[b].accepted && sheets.find(b) != root && clusters.contradict(n, b));
      sheet.contradicted += contradicted;
    }
    const bool large = sheet.samples >= kLargeShare * of[order.front()].samples ||
                       4 * sheet.columns >= 3 * cells.columns_with_samples();
    const bool body =
        root == order.front() ||
        (sheet.cells >= kSheetCells && sheet.contradicted < (large ? kLargeContradicted : kContradicted) * sheet.cells);
    for (const std::size_t n : members[root]) {
      clusters[n].accepted = body;
      clusters[n].handle_mm = !body && sheet.cells >= kSheetCells ? cells.diagonal_mm(clusters[n].median) : 0;
      // Too small for a part of the object: strays that happen to lie together.
      if (!body && sheet.cells < kSheetCells) clusters[n].significant = false;
    }
  }
}

// Stretches of a row of cells that protrude between jumps, as handles do where the body is not seen behind them. They
// count if they lie over one another in several rows.
void refuse_handles(Clusters& clusters) {
  const SampleCells& cells = clusters.cells();
  // A jump, or a gap that a slope beyond 45 degrees would have to cross.
  enum class Side { firm, gap, jump };
  const auto side = [&](std::size_t a, std::size_t b) {
    const auto step = clusters.step(a, b, true);
    if (!clusters.continues(step, clusters[a].median)) return Side::jump;
    const double width = cells.width_mm(clusters[a].median);
    return step.distance > width / 2 && step.rise > step.distance ? Side::gap : Side::firm;
  };
  // The next column with accepted clusters in the row, and its nodes.
  const auto neighbours = [&](std::size_t n, int direction) {
    std::vector<std::size_t> found;
    for (int k = 1; k <= std::min(2 * kReach, cells.around() - 1) && found.empty(); ++k) {
      const auto [first, last] = clusters.of(clusters.node(n).i, clusters.node(n).j + direction * k);
      for (std::size_t b = first; b < last; ++b)
        if (clusters[b].accepted) found.push_back(b);
    }
    return found;
  };
  UnionFind runs(clusters.size());
  for (std::size_t a = 0; a < clusters.size(); ++a) {
    if (!clusters[a].accepted) continue;
    for (const std::size_t b : neighbours(a, 1))
      if (side(a, b) == Side::firm) runs.join(a, b);
  }
  struct Run {
    std::vector<std::size_t> nodes;
    bool protrudes = false;
  };
  std::vector<Run> of(clusters.size());
  for (std::size_t n = 0; n < clusters.size(); ++n)
    if (clusters[n].accepted) of[runs.find(n)].nodes.push_back(n);
  for (Run& run : of) {
    const auto columns = static_cast<double>(run.nodes.size());
    if (run.nodes.empty() || columns > kWidestShare * cells.columns_with_samples()) continue;
    double width = 0;
    std::array<double, 2> drop{1e300, 1e300};
    std::array<bool, 2> jump{false, false}, ends{false, false};
    for (const std::size_t n : run.nodes) {
      const Cluster& c = clusters[n];
      width += (c.v_high - c.v_low) * cells.arc_rad() * c.median;
      for (const int direction : {-1, 1}) {
        const auto d = static_cast<std::size_t>(direction > 0);
        const auto next = neighbours(n, direction);
        if (next.empty()) continue;
        bool inside = false;
        for (const std::size_t b : next) inside = inside || runs.find(b) == runs.find(n);
        if (inside) continue;
        for (const std::size_t b : next) {
          ends[d] = true;
          drop[d] = std::min(drop[d], c.median - clusters[b].median);
          jump[d] = jump[d] || side(direction > 0 ? n : b, direction > 0 ? b : n) == Side::jump;
        }
      }
      // The body seen beside it in the same cell.
      const auto [first, last] = clusters.of(clusters.node(n).i, clusters.node(n).j);
      for (std::size_t b = first; b < last; ++b)
        if (b != n && clusters[b].accepted && runs.find(b) != runs.find(n)) {
          const std::size_t d = (clusters[b].v_low + clusters[b].v_high) > (c.v_low + c.v_high);
          ends[d] = jump[d] = true;
          drop[d] = std::min(drop[d], c.median - clusters[b].median);
        }
    }
    run.protrudes = ends[0] && ends[1] && (jump[0] || jump[1]) && std::min(drop[0], drop[1]) > kDropPerWidth * width;
  }
  // Runs over one another.
  UnionFind groups(clusters.size());
  for (std::size_t a = 0; a < clusters.size(); ++a) {
    if (!clusters[a].accepted || !of[runs.find(a)].protrudes) continue;
    for (int di = 0; di <= 2; ++di)
      for (int dj = -1; dj <= 1; ++dj) {
        if (clusters.node(a).i + di >= cells.along()) continue;
        const auto [first, last] = clusters.of(clusters.node(a).i + di, clusters.node(a).j + dj);
        for (std::size_t b = first; b < last; ++b)
          if (clusters[b].accepted && of[runs.find(b)].protrudes) groups.join(a, b);
      }
  }
  std::vector<int> lowest(clusters.size(), cells.along()), highest(clusters.size(), -1), count(clusters.size(), 0);
  for (std::size_t n = 0; n < clusters.size(); ++n) {
    if (!clusters[n].accepted || !of[runs.find(n)].protrudes) continue;
    const std::size_t g = groups.find(n);
    lowest[g] = std::min(lowest[g], clusters.node(n).i);
    highest[g] = std::max(highest[g], clusters.node(n).i);
    ++count[g];
  }
  for (std::size_t n = 0; n < clusters.size(); ++n) {
    const std::size_t g = groups.find(n);
    if (!clusters[n].accepted || !of[runs.find(n)].protrudes || count[g] < kSheetCells || highest[g] == lowest[g])
      continue;
    clusters[n].accepted = false;
    clusters[n].handle_mm = cells.diagonal_mm(clusters[n].median);
  }
}

// Where clusters of the body lie over one another in a cell, the surface can follow one: the one that its neighbours
// continue.
void choose_single_values(Clusters& clusters) {
  const SampleCells& cells = clusters.cells();
  const auto accepted_count = [](const SampleCell& c) {
    return std::count_if(c.clusters.begin(), c.clusters.end(), [](const Cluster& k) { return k.accepted; });
  };
  for (std::size_t n = 0; n < clusters.size(); ++n) {
    if (!clusters[n].accepted) continue;
    const int i = clusters.node(n).i, j = clusters.node(n).j;
    const auto [first, last] = clusters.of(i, j);
    std::vector<std::size_t> over;
    for (std::size_t b = first; b < last; ++b)
      if (b != n && clusters[b].accepted && clusters.contradict(n, b)) over.push_back(b);
    if (over.empty()) continue;
    over.push_back(n);
    double sum = 0, count = 0;
    for (int reach = 1; reach <= 8 && count < 3; ++reach)
      for (int dj = -reach; dj <= reach; ++dj)
        for (int di = -reach; di <= reach; ++di) {
          if (std::max(std::abs(di), std::abs(dj)) != reach || i + di < 0 || i + di >= cells.along()) continue;
          const SampleCell& other = cells[cells.index(i + di, cells.column(j + dj))];
          if (accepted_count(other) != 1) continue;
          sum += other.accepted()->median;
          ++count;
        }
    const double expected = count > 0 ? sum / count : 0;
    const auto better = [&](std::size_t a, std::size_t b) {
      const Cluster &ca = clusters[a], &cb = clusters[b];
      return count > 0 ? std::abs(ca.median - expected) < std::abs(cb.median - expected) : ca.count > cb.count;
    };
    const std::size_t best = *std::min_element(over.begin(), over.end(), better);
    for (const std::size_t b : over) clusters[b].accepted = b == best;
  }
}

}  // namespace

void set_strays_apart(SampleCells& cells) {
  std::vector<std::vector<bool>> stray(cells.size());
  for (std::size_t c = 0; c < cells.size(); ++c) {
    auto& points = cells[c].points;
    std::sort(points.begin(), points.end(), by_key);
    const std::size_t n = points.size();
    stray[c].assign(n, false);
    const double needed = kOwnSupport * static_cast<double>(n);
    for (std::size_t k = 0, low = 0, high = 0; k < n; ++k) {
      const double reach = cells.diagonal_mm(points[k].r_mm) / 2;
      while (points[k].r_mm - points[low].r_mm > reach) ++low;
      while (high < n && points[high].r_mm - points[k].r_mm <= reach) ++high;
      stray[c][k] = static_cast<double>(high - low) < needed;
    }
  }
  for (std::size_t c = 0; c < cells.size(); ++c)
    for (std::size_t k = 0; k < stray[c].size(); ++k)
      if (stray[c][k]) stray[c][k] = !has_company(cells, c, cells[c].points[k]);
  for (std::size_t c = 0; c < cells.size(); ++c) {
    SampleCell& cell = cells[c];
    std::vector<CellPoint> kept, strays;
    for (std::size_t k = 0; k < cell.points.size(); ++k) (stray[c][k] ? strays : kept).push_back(cell.points[k]);
    cell.kept = kept.size();
    kept.insert(kept.end(), strays.begin(), strays.end());
    cell.points = std::move(kept);
  }
}

void find_clusters(SampleCells& cells, double gap_share, double smallest_gap_mm) {
  for (SampleCell& cell : cells) {
    auto& points = cell.points;
    cell.clusters.clear();
    const auto n = static_cast<int>(cell.kept);
    if (n == 0) continue;
    std::sort(points.begin(), points.begin() + n, by_key);
    const double gap = std::max(smallest_gap_mm, gap_share * std::min(1.0, std::sqrt(kGapSamples / n)) *
                                                     cells.diagonal_mm(points[cell.kept / 2].r_mm));
    std::vector<double> ranges;
    for (int first = 0, last = 0; first < n; first = last) {
      last = first + 1;
      while (last < n &&
             points[static_cast<std::size_t>(last)].key - points[static_cast<std::size_t>(last - 1)].key <= gap)
        ++last;
      Cluster c;
      c.first = first;
      c.count = last - first;
      c.low = c.v_low = c.z_low = 1e300;
      c.high = c.v_high = c.z_high = -1e300;
      ranges.clear();
      for (int k = first; k < last; ++k) {
        const CellPoint& p = points[static_cast<std::size_t>(k)];
        ranges.push_back(p.r_mm);
        c.v_low = std::min(c.v_low, p.v), c.v_high = std::max(c.v_high, p.v);
        c.z_low = std::min(c.z_low, p.z_mm), c.z_high = std::max(c.z_high, p.z_mm);
      }
      std::sort(ranges.begin(), ranges.end());
      c.low = ranges.front();
      c.high = ranges.back();
      c.median = ranges[ranges.size() / 2];
      c.significant = n < 3 ? c.count == n : c.count >= std::max(2.0, kStrayShare * n);
      cell.clusters.push_back(c);
    }
  }
}

void choose_body(SampleCells& cells) {
  Clusters clusters(cells);
  if (clusters.size() == 0) return;
  accept_sheets(clusters);
  refuse_handles(clusters);
  choose_single_values(clusters);
}

}  // namespace celadon
