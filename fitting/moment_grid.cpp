#include "fitting/moment_grid.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <string>

#include "fitting/moment_kernels.h"
#include "fitting/row_sums.h"

namespace celadon {
namespace {

using moment_kernels::kBlock;

const GridSpecification& checked(const GridSpecification& s) {
  const auto power_of_two = [](int n) { return n > 0 && std::has_single_bit(static_cast<unsigned>(n)); };
  if (!std::isfinite(s.z_start_mm) || !std::isfinite(s.z_end_mm) || !(s.z_start_mm < s.z_end_mm))
    throw std::invalid_argument("MomentGrid: the band from z = " + std::to_string(s.z_start_mm) + " to " +
                                std::to_string(s.z_end_mm) + " mm is empty or not finite");
  if (!power_of_two(s.z_intervals) || !power_of_two(s.intervals_per_arc))
    throw std::invalid_argument("MomentGrid: " + std::to_string(s.z_intervals) + " z intervals and " +
                                std::to_string(s.intervals_per_arc) + " an arc must both be powers of two");
  if (s.degree_u < 1 || s.degree_u > 5 || s.degree_v < 1 || s.degree_v > 5)
    throw std::invalid_argument("MomentGrid: degrees (" + std::to_string(s.degree_u) + ", " +
                                std::to_string(s.degree_v) + ") must lie in 1..5");
  return s;
}

moment_kernels::Grid kernel_grid(const GridSpecification& s, const MomentLayout& layout, int v_cells, double* cells) {
  return {cells,
          layout,
          s.z_intervals,
          v_cells,
          s.z_start_mm,
          s.z_intervals / (s.z_end_mm - s.z_start_mm),
          static_cast<double>(s.intervals_per_arc)};
}

void require_lengths(std::size_t a, std::size_t b, std::size_t c, const char* what) {
  if (a != b || a != c) throw std::invalid_argument(std::string("MomentGrid::") + what + ": arrays differ in length");
}

}  // namespace

MomentGrid::MomentGrid(const GridSpecification& specification, WeightRule rule)
    : specification_(checked(specification)),
      rule_(rule),
      layout_(specification.degree_u, specification.degree_v),
      cells_(static_cast<std::size_t>(z_cells()) * static_cast<std::size_t>(v_cells()) *
             static_cast<std::size_t>(layout_.stride())) {}

double MomentGrid::z_edge_mm(int z_cell) const {
  const double f = static_cast<double>(z_cell) / z_cells();
  return (1 - f) * specification_.z_start_mm + f * specification_.z_end_mm;
}

void MomentGrid::count_rejected(std::span<const double> r, std::span<const double> v, std::span<const double> z,
                                std::span<const double> weight) {
  const auto& s = specification_;
  for (std::size_t k = 0; k < r.size(); ++k) {
    if (!std::isfinite(r[k]) || std::isnan(v[k]) || v[k] == BaseArcs::kNoAngle || !std::isfinite(z[k]) ||
        (!weight.empty() && !(weight[k] > 0 && std::isfinite(weight[k])))) {
      ++rejected_not_finite_;
    } else if (r[k] <= 0) {
      ++rejected_on_axis_;
    } else {
      const double x = (z[k] - s.z_start_mm) * (s.z_intervals / (s.z_end_mm - s.z_start_mm));
      if (v[k] < 0 || !(x >= 0 && x <= s.z_intervals)) ++rejected_outside_;
    }
  }
}

void MomentGrid::add(std::span<const double> r, std::span<const double> theta, std::span<const double> z,
                     std::span<const double> weight) {
  require_lengths(r.size(), theta.size(), z.size(), "add");
  if (!weight.empty()) require_lengths(r.size(), weight.size(), r.size(), "add");
  std::array<double, kBlock> v;
  for (std::size_t k = 0; k < r.size(); k += kBlock) {
    const std::size_t n = std::min(kBlock, r.size() - k);
    arcs().place(theta.data() + k, n, v.data());
    add_synchronised(r.subspan(k, n), std::span(v).first(n), z.subspan(k, n),
                     weight.empty() ? weight : weight.subspan(k, n));
  }
}

void MomentGrid::add_synchronised(std::span<const double> r, std::span<const double> v, std::span<const double> z,
                                  std::span<const double> weight) {
  require_lengths(r.size(), v.size(), z.size(), "add_synchronised");
  if (!weight.empty()) require_lengths(r.size(), weight.size(), r.size(), "add_synchronised");
  const auto grid = kernel_grid(specification_, layout_, v_cells(), cells_.data());
  for (std::size_t k = 0; k < r.size(); k += kBlock) {
    const std::size_t n = std::min(kBlock, r.size() - k);
    const double* w = weight.empty() ? nullptr : weight.data() + k;
    const std::size_t good = moment_kernels::add_block(grid, r.data() + k, z.data() + k, v.data() + k, w, n);
    samples_ += good;
    if (good < n)
      count_rejected(r.subspan(k, n), v.subspan(k, n), z.subspan(k, n), weight.empty() ? weight : weight.subspan(k, n));
  }
}

void MomentGrid::add_constant_theta(double theta, std::span<const double> r, std::span<const double> z) {
  require_lengths(r.size(), z.size(), z.size(), "add_constant_theta");
  double v = 0;
  arcs().place(&theta, 1, &v);
  const auto grid = kernel_grid(specification_, layout_, v_cells(), cells_.data());
  const bool positive = moment_kernels::all_positive(r.data(), r.size());
  const std::size_t good = moment_kernels::add_profile(grid, v, r.data(), z.data(), r.size(), positive);
  samples_ += good;
  if (good < r.size()) {
    const std::vector<double> same(r.size(), v);
    count_rejected(r, same, z, {});
  }
}

void MomentGrid::add_cartesian(std::span<const double> x, std::span<const double> y, std::span<const double> z) {
  require_lengths(x.size(), y.size(), z.size(), "add_cartesian");
  const auto grid = kernel_grid(specification_, layout_, v_cells(), cells_.data());
  std::array<double, kBlock> v, r;
  for (std::size_t k = 0; k < x.size(); k += kBlock) {
    const std::size_t n = std::min(kBlock, x.size() - k);
    arcs().place(x.data() + k, y.data() + k, n, v.data(), r.data());
    const std::size_t good = moment_kernels::add_block(grid, r.data(), z.data() + k, v.data(), nullptr, n);
    samples_ += good;
    if (good < n) count_rejected(std::span(r).first(n), std::span(v).first(n), z.subspan(k, n), {});
  }
}

// Rows that share a v cell are summed column by column, then against the powers of s; the weight moments are products.
void MomentGrid::add_regular(const Eigen::Ref<const Eigen::Matrix<double, -1, -1, Eigen::RowMajor>>& r,
                             double theta_offset, std::span<const double> z) {
  const auto columns = static_cast<std::size_t>(r.cols());
  require_lengths(columns, z.size(), columns, "add_regular");
  if (r.rows() == 0 || columns == 0) return;
  if (!arcs().closed()) throw std::invalid_argument("MomentGrid::add_regular: rows go all around, the arcs do not");
  const auto& spec = specification_;
  const int p = spec.degree_u, q = spec.degree_v;
  const double z_scale = spec.z_intervals / (spec.z_end_mm - spec.z_start_mm);

  // Runs of columns that share a z cell, their sums of powers of s, and the powers of every column.
  struct Run {
    std::size_t first, count;
    int z_cell;
    std::array<double, 11> moments{};
  };
  std::vector<Run> runs;
  std::vector<double> s_powers(columns * static_cast<std::size_t>(p + 1));
  std::size_t inside = 0;
  for (std::size_t j = 0; j < columns; ++j) {
    const double x = (z[j] - spec.z_start_mm) * z_scale;
    if (!(x >= 0 && x <= spec.z_intervals)) continue;
    const int cell = std::min(static_cast<int>(x), spec.z_intervals - 1);
    const double s = 2 * (x - cell) - 1;
    if (runs.empty() || runs.back().z_cell != cell || runs.back().first + runs.back().count != j)
      runs.push_back({j, 0, cell});
    Run& run = runs.back();
    ++run.count;
    ++inside;
    double power = 1;
    for (int b = 0; b <= 2 * p; ++b, power *= s) {
      if (b <= p) s_powers[static_cast<std::size_t>(b) * columns + j] = power;
      run.moments[static_cast<std::size_t>(b)] += power;
    }
  }

  const auto powers_v = static_cast<std::size_t>(q + 1);
  std::vector<const double*> rows;  // of the current v cell
  std::vector<double> t_powers, sums((powers_v + 1) * columns), ones(columns, 1.0);
  std::array<double, 11> t_sums{};
  int current = -1;
  const auto flush = [&] {
    if (rows.empty()) return;
    sum_rows({rows.data(), t_powers.data(), rows.size(), columns, q, true}, sums.data());
    for (const Run& run : runs) {
      double* to = cells_.data() + static_cast<std::ptrdiff_t>(current * z_cells() + run.z_cell) * layout_.stride();
      for (int b = 0; b <= 2 * p; ++b)
        for (int a = 0; a <= 2 * q; ++a)
          to[layout_.weight(b, a)] += run.moments[static_cast<std::size_t>(b)] * t_sums[static_cast<std::size_t>(a)];
      std::array<double, 6> moments{};
      for (int b = 0; b <= p; ++b) {
        moment_kernels::dot_products(sums.data() + run.first, columns, q + 1,
                                     s_powers.data() + static_cast<std::size_t>(b) * columns + run.first, run.count,
                                     moments.data());
        for (int a = 0; a <= q; ++a) to[layout_.range(b, a)] += moments[static_cast<std::size_t>(a)];
      }
      moment_kernels::dot_products(sums.data() + powers_v * columns + run.first, columns, 1, ones.data(), run.count,
                                   moments.data());
      to[layout_.square()] += moments[0];
    }
    rows.clear();
    t_powers.clear();
    t_sums.fill(0);
  };
  for (Eigen::Index i = 0; i < r.rows(); ++i) {
    const double theta = 2 * std::numbers::pi * (static_cast<double>(i) + theta_offset) / static_cast<double>(r.rows());
    const double* row = r.row(i).data();
    if (!moment_kernels::all_positive(row, columns)) {
      add_constant_theta(theta, {row, columns}, z);
      continue;
    }
    const double y = arcs().v_of_theta(theta) * spec.intervals_per_arc;
    const int v_cell = std::min(static_cast<int>(y), v_cells() - 1);
    if (v_cell != current) {
      flush();
      current = v_cell;
    }
    rows.push_back(row);
    double power = 1;
    for (int a = 0; a <= 2 * q; ++a, power *= 2 * (y - v_cell) - 1) {
      if (a <= q) t_powers.push_back(power);
      t_sums[static_cast<std::size_t>(a)] += power;
    }
    samples_ += inside;
    if (inside < columns) {
      const std::vector<double> v(columns, 0.0);
      count_rejected({row, columns}, v, z, {});
    }
  }
  flush();
}

void MomentGrid::merge(const MomentGrid& other) {
  const auto &a = specification_, &b = other.specification_;
  const auto differs = [](const std::string& what) {
    throw std::invalid_argument("MomentGrid::merge: the sums differ in their " + what);
  };
  if (a.base != b.base) differs("base");
  if (a.z_start_mm != b.z_start_mm || a.z_end_mm != b.z_end_mm) differs("band");
  if (a.z_intervals != b.z_intervals || a.intervals_per_arc != b.intervals_per_arc) differs("number of intervals");
  if (a.degree_u != b.degree_u || a.degree_v != b.degree_v) differs("degrees");
  if (a.arcs != b.arcs) differs("angular range");
  if (rule_ != other.rule_) differs("weight rule");
  for (std::size_t k = 0; k < cells_.size(); ++k) cells_[k] += other.cells_[k];
  samples_ += other.samples_;
  rejected_on_axis_ += other.rejected_on_axis_;
  rejected_not_finite_ += other.rejected_not_finite_;
  rejected_outside_ += other.rejected_outside_;
}

void MomentGrid::scale(double factor) {
  for (double& sum : cells_) sum *= factor;
}

namespace {
template <class Entry>
double sum_over_cells(const MomentGrid& grid, const Entry& entry) {
  double total = 0;
  for (int j = 0; j < grid.v_cells(); ++j) {
    double column = 0;  // in two steps: shorter sums, less rounding
    for (int i = 0; i < grid.z_cells(); ++i) column += grid.cell(i, j)[entry];
    total += column;
  }
  return total;
}
}  // namespace

double MomentGrid::sum_weight() const {
  return sum_over_cells(*this, layout_.weight(0, 0));
}
double MomentGrid::sum_weighted_range() const {
  return sum_over_cells(*this, layout_.range(0, 0));
}
double MomentGrid::sum_weighted_square() const {
  return sum_over_cells(*this, layout_.square());
}
std::size_t MomentGrid::memory_bytes() const {
  return sizeof(*this) + cells_.capacity() * sizeof(double);
}

std::size_t MomentGrid::packed_size() const {
  const auto p = static_cast<std::size_t>(layout_.degree_u), q = static_cast<std::size_t>(layout_.degree_v);
  return (2 * p + 1) * (2 * q + 1) + (p + 1) * (q + 1) + 1;
}

void MomentGrid::pack(int z_cell, int v_cell, double* packed) const {
  const double* const from = cell(z_cell, v_cell);
  for (int b = 0; b < layout_.weight_rows(); ++b)
    for (int a = 0; a <= 2 * layout_.degree_v; ++a) *packed++ = from[layout_.weight(b, a)];
  for (int b = 0; b < layout_.range_rows(); ++b)
    for (int a = 0; a <= layout_.degree_v; ++a) *packed++ = from[layout_.range(b, a)];
  *packed = from[layout_.square()];
}

void MomentGrid::add_packed(int z_cell, int v_cell, const double* packed) {
  double* const to = cells_.data() + (cell(z_cell, v_cell) - cells_.data());
  for (int b = 0; b < layout_.weight_rows(); ++b)
    for (int a = 0; a <= 2 * layout_.degree_v; ++a) to[layout_.weight(b, a)] += *packed++;
  for (int b = 0; b < layout_.range_rows(); ++b)
    for (int a = 0; a <= layout_.degree_v; ++a) to[layout_.range(b, a)] += *packed++;
  to[layout_.square()] += *packed;
}

void MomentGrid::add_counts(const Counts& counts) {
  samples_ += counts.samples;
  rejected_on_axis_ += counts.on_axis;
  rejected_not_finite_ += counts.not_finite;
  rejected_outside_ += counts.outside;
}

}  // namespace celadon
