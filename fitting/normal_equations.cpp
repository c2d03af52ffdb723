// Assembly: cells -> moments of the spaces' intervals -> entries of the stencil.
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "fitting/normal_solver.h"

namespace celadon {
namespace {

constexpr int kMaxPowers = 11;  // 2 * 5 + 1

// How one direction's cells lie in the intervals of a space.
struct CellMap {
  std::vector<int> first, last;  // cells [first, last) of each interval
  // s_interval = shift + scale * s_cell
  struct Placement {
    double shift, scale;
  };
  std::vector<Placement> placement;  // per cell
};

CellMap map_cells(std::span<const double> breaks_in_cells, int cells, const char* what) {
  CellMap map;
  map.placement.assign(static_cast<std::size_t>(cells), {0, 1});
  std::vector<int> edges;
  for (const double b : breaks_in_cells) {
    const int edge = static_cast<int>(std::lround(b));
    if (std::abs(b - edge) > 1e-6 || edge < 0 || edge > cells || (!edges.empty() && edge <= edges.back()))
      throw std::invalid_argument(std::string("NormalEquations: a break along ") + what + " at cell " +
                                  std::to_string(b) + " is not on the grid's edges 0.." + std::to_string(cells));
    edges.push_back(edge);
  }
  for (std::size_t k = 0; k + 1 < edges.size(); ++k) {
    const int lo = edges[k], hi = edges[k + 1];
    map.first.push_back(lo);
    map.last.push_back(hi);
    for (int c = lo; c < hi; ++c)
      map.placement[static_cast<std::size_t>(c)] = {static_cast<double>(2 * c + 1 - lo - hi) / (hi - lo),
                                                    1.0 / (hi - lo)};
  }
  return map;
}

// rows[k][m]: coefficient of s_cell^m in (shift + scale s_cell)^k.
struct Translation {
  double rows[kMaxPowers][kMaxPowers];
  Translation(const CellMap::Placement& at, int powers) {
    rows[0][0] = 1;
    for (int k = 1; k < powers; ++k)
      for (int m = 0; m <= k; ++m)
        rows[k][m] = (m < k ? at.shift * rows[k - 1][m] : 0) + (m > 0 ? at.scale * rows[k - 1][m - 1] : 0);
  }
};

// Products of an interval's active functions: for the pairs x <= y, lane-padded, the coefficients by power.
struct PairProducts {
  static constexpr int kMaxPairs = 24;  // 21 for degree 5, padded
  int functions = 0, pairs = 0, padded = 0;
  double by_power[kMaxPowers][kMaxPairs] = {};
  int x[kMaxPairs] = {}, y[kMaxPairs] = {};
  PairProducts(const RangeSpace& space, int interval) {
    functions = static_cast<int>(space.active(interval).size());
    for (int a = 0; a < functions; ++a)
      for (int b = a; b < functions; ++b, ++pairs) {
        x[pairs] = a;
        y[pairs] = b;
        const auto pa = space.polynomial(interval, a), pb = space.polynomial(interval, b);
        for (std::size_t i = 0; i < pa.size(); ++i)
          for (std::size_t k = 0; k < pb.size(); ++k) by_power[i + k][pairs] += pa[i] * pb[k];
      }
    padded = (pairs + 3) / 4 * 4;
  }
};

// Moments of a cell in the coordinates of the interval that holds it.
void add_translated_along_u(const double* cell, const MomentLayout& layout, int p, const Translation& t, double* to) {
  for (int b = 0; b <= 2 * p; ++b)
    for (int c = 0; c <= b; ++c) {
      const double f = t.rows[b][c];
      for (int a = 0; a < layout.weight_lanes; ++a) to[layout.weight(b, a)] += f * cell[layout.weight(c, a)];
      if (b > p) continue;
      for (int a = 0; a < layout.range_lanes; ++a) to[layout.range(b, a)] += f * cell[layout.range(c, a)];
    }
}

void add_translated_along_v(const double* moments, const MomentLayout& layout, int p, int q, const Translation& t,
                            double* to) {
  const auto translate = [&](const double* row, double* result, int lanes) {
    for (int a = 0; a < lanes; ++a) {
      double value = 0;
      for (int c = 0; c <= a; ++c) value += t.rows[a][c] * row[c];
      result[a] += value;
    }
  };
  for (int b = 0; b <= 2 * p; ++b) translate(moments + layout.weight(b, 0), to + layout.weight(b, 0), 2 * q + 1);
  for (int b = 0; b <= p; ++b) translate(moments + layout.range(b, 0), to + layout.range(b, 0), q + 1);
}

// Products of the functions x and y along v with the pairs (i, i + d) along u, g[d][i]: both ways round.
void add_to_planes(StencilMatrix& matrix, int x, int y, const double* g) {
  const int plane = matrix.plane_of(x, y), n = matrix.count_u();
  for (int d = 0; d <= matrix.band_u(); ++d) {
    const double* from = g + static_cast<std::ptrdiff_t>(d) * n;
    double* upper = matrix.plane(plane, d) + matrix.at(0, x);
    for (int i = 0; i + d < n; ++i) upper[i] += from[i];
    if (d == 0) continue;
    double* lower = matrix.plane(plane, -d) + matrix.at(d, x);
    for (int i = 0; i + d < n; ++i) lower[i] += from[i];
  }
}

int bandwidth(const RangeSpace& space) {
  return std::min(space.degree(), space.free_count() - 1);
}

}  // namespace

NormalEquations::NormalEquations(const MomentGrid& sums, FitSpace space)
    : space_(std::move(space)),
      arcs_(sums.arcs()),
      matrix_(space_.u.free_count(), bandwidth(space_.u), space_.v.free_count(), bandwidth(space_.v)),
      rhs_(matrix_.field_size(), 0.0) {
  if (space_.u.degree() > sums.specification().degree_u || space_.v.degree() > sums.specification().degree_v)
    throw std::invalid_argument("NormalEquations: degrees (" + std::to_string(space_.u.degree()) + ", " +
                                std::to_string(space_.v.degree()) + ") exceed those of the sums");
  assemble(sums);
}

void NormalEquations::assemble(const MomentGrid& sums) {
  const auto& spec = sums.specification();
  const MomentLayout& from = sums.layout();
  const int p = space_.u.degree(), q = space_.v.degree();
  const int weight_rows = 2 * p + 1, weight_lanes = 2 * q + 1;

  std::vector<double> z_breaks, v_breaks;
  for (const double z : space_.u.breaks())
    z_breaks.push_back((z - spec.z_start_mm) / (spec.z_end_mm - spec.z_start_mm) * spec.z_intervals);
  for (const double v : space_.v.breaks()) v_breaks.push_back(v * spec.intervals_per_arc);
  const CellMap map_u = map_cells(z_breaks, sums.z_cells(), "z");
  const CellMap map_v = map_cells(v_breaks, sums.v_cells(), "v");
  std::vector<Translation> along_u;
  for (int i = 0; i < sums.z_cells(); ++i)
    along_u.emplace_back(map_u.placement[static_cast<std::size_t>(i)], weight_rows);
  std::vector<PairProducts> products_u;
  for (int k = 0; k < space_.u.intervals(); ++k) products_u.emplace_back(space_.u, k);

  // One column of intervals at a time: its moments, the entries of its functions' pairs, then those into the planes.
  const auto stride = static_cast<std::size_t>(from.stride());
  const auto count_u = static_cast<std::size_t>(space_.u.free_count()),
             offsets = static_cast<std::size_t>(matrix_.band_u() + 1);
  AlignedVector<double> line(stride), merged(stride * static_cast<std::size_t>(space_.u.intervals()));
  std::vector<double> entries, ranges;
  for (int J = 0; J < space_.v.intervals(); ++J) {
    const int first_v = map_v.first[static_cast<std::size_t>(J)], last_v = map_v.last[static_cast<std::size_t>(J)];
    std::fill(merged.begin(), merged.end(), 0.0);
    for (int j = first_v; j < last_v; ++j) {
      const Translation along_v(map_v.placement[static_cast<std::size_t>(j)], weight_lanes);
      for (int I = 0; I < space_.u.intervals(); ++I) {
        const int first_u = map_u.first[static_cast<std::size_t>(I)], last_u = map_u.last[static_cast<std::size_t>(I)];
        double count = 0;
        for (int i = first_u; i < last_u; ++i) {
          const double* cell = sums.cell(i, j);
          count += cell[0];
          weight_ += cell[0];
          square_ += cell[from.square()];
          range_ += cell[from.range(0, 0)];
        }
        if (count == 0) continue;
        double* sum = merged.data() + static_cast<std::size_t>(I) * stride;
        const double* moments = sums.cell(first_u, j);
        if (last_u - first_u > 1) {
          std::fill(line.begin(), line.end(), 0.0);
          for (int i = first_u; i < last_u; ++i)
            add_translated_along_u(sums.cell(i, j), from, p, along_u[static_cast<std::size_t>(i)], line.data());
          moments = line.data();
        }
        if (last_v - first_v > 1) {
          add_translated_along_v(moments, from, p, q, along_v, sum);
        } else {
          std::copy(moments, moments + stride, sum);
        }
      }
    }

    const PairProducts pv(space_.v, J);
    const auto active_v = space_.v.active(J);
    entries.assign(static_cast<std::size_t>(pv.pairs) * offsets * count_u, 0.0);
    ranges.assign(active_v.size() * count_u, 0.0);
    for (int I = 0; I < space_.u.intervals(); ++I) {
      const double* m = merged.data() + static_cast<std::size_t>(I) * stride;
      if (m[0] == 0) {
        ++empty_cells_;
        continue;
      }
      const PairProducts& pu = products_u[static_cast<std::size_t>(I)];
      const auto first_u = static_cast<std::size_t>(space_.u.active(I).front());
      double by_row[kMaxPowers][PairProducts::kMaxPairs];
      for (int b = 0; b < weight_rows; ++b) {
        double* to = by_row[b];
        std::fill(to, to + pv.padded, 0.0);
        for (int a = 0; a < weight_lanes; ++a) {
          const double moment = m[from.weight(b, a)];
          for (int k = 0; k < pv.padded; ++k) to[k] += moment * pv.by_power[a][k];
        }
      }
      for (int pair = 0; pair < pv.pairs; ++pair) {
        double g[PairProducts::kMaxPairs] = {};
        for (int b = 0; b < weight_rows; ++b)
          for (int k = 0; k < pu.padded; ++k) g[k] += by_row[b][pair] * pu.by_power[b][k];
        double* to = entries.data() + static_cast<std::size_t>(pair) * offsets * count_u + first_u;
        for (int k = 0; k < pu.pairs; ++k)
          to[static_cast<std::size_t>(pu.y[k] - pu.x[k]) * count_u + static_cast<std::size_t>(pu.x[k])] += g[k];
      }
      for (std::size_t x = 0; x < active_v.size(); ++x) {
        const auto poly_v = space_.v.polynomial(J, static_cast<int>(x));
        double range_by_row[6];
        for (int b = 0; b <= p; ++b) {
          double value = 0;
          for (int a = 0; a <= q; ++a) value += poly_v[static_cast<std::size_t>(a)] * m[from.range(b, a)];
          range_by_row[b] = value;
        }
        for (int y = 0; y < pu.functions; ++y) {
          const auto poly_u = space_.u.polynomial(I, y);
          double value = 0;
          for (int b = 0; b <= p; ++b) value += poly_u[static_cast<std::size_t>(b)] * range_by_row[b];
          ranges[x * count_u + first_u + static_cast<std::size_t>(y)] += value;
        }
      }
    }
    for (std::size_t x = 0; x < active_v.size(); ++x)
      for (std::size_t i = 0; i < count_u; ++i) rhs_[matrix_.at(0, active_v[x]) + i] += ranges[x * count_u + i];
    for (int pair = 0; pair < pv.pairs; ++pair) {
      const int x = active_v[static_cast<std::size_t>(pv.x[pair])], y = active_v[static_cast<std::size_t>(pv.y[pair])];
      const double* g = entries.data() + static_cast<std::size_t>(pair) * offsets * count_u;
      add_to_planes(matrix_, x, y, g);
      if (x != y) add_to_planes(matrix_, y, x, g);
    }
  }
}

int NormalEquations::supported_unknowns() const {
  int count = 0;
  for (int j = 0; j < matrix_.count_v(); ++j)
    for (int i = 0; i < matrix_.count_u(); ++i) count += matrix_.diagonal(i, j) > 0;
  return count;
}

AlignedVector<double> NormalEquations::to_field(const Eigen::MatrixXd& free) const {
  AlignedVector<double> field(matrix_.field_size(), 0.0);
  for (int j = 0; j < matrix_.count_v(); ++j)
    for (int i = 0; i < matrix_.count_u(); ++i) field[matrix_.at(i, j)] = free(i, j);
  return field;
}

Eigen::MatrixXd NormalEquations::to_matrix(const AlignedVector<double>& field) const {
  Eigen::MatrixXd free(matrix_.count_u(), matrix_.count_v());
  for (int j = 0; j < matrix_.count_v(); ++j)
    for (int i = 0; i < matrix_.count_u(); ++i) free(i, j) = field[matrix_.at(i, j)];
  return free;
}

Eigen::MatrixXd NormalEquations::gradient(const Eigen::MatrixXd& free) const {
  const auto x = to_field(free);
  AlignedVector<double> y(x.size());
  matrix_.multiply(x.data(), y.data());
  for (std::size_t k = 0; k < y.size(); ++k) y[k] = rhs_[k] - y[k];
  return to_matrix(y);
}

double NormalEquations::quadratic(const Eigen::MatrixXd& free) const {
  const auto x = to_field(free);
  AlignedVector<double> y(x.size());
  matrix_.multiply(x.data(), y.data());
  double sum = 0;
  for (std::size_t k = 0; k < y.size(); ++k) sum += x[k] * y[k];
  return sum;
}

// |r - F|^2 = sum w r^2 - 2 b x + x A x, taken about the mean range so that less cancels: with x = mean + d (the
// constant function has all coefficients equal), = sum w (r - mean)^2 - 2 d (b - mean A 1) + d A d.
double NormalEquations::residual_square(const Eigen::MatrixXd& free) const {
  const double mean = mean_range();
  const Eigen::MatrixXd d = free.array() - mean;
  const Eigen::MatrixXd b = gradient(Eigen::MatrixXd::Constant(free.rows(), free.cols(), mean));
  const double about_mean = square_ - 2 * mean * range_ + mean * mean * weight_;
  const double value = about_mean - 2 * d.cwiseProduct(b).sum() + quadratic(d);
  return std::max(value, 0.0);
}

}  // namespace celadon
