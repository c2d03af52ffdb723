// Assembly: cells -> moments of the spaces' intervals -> entries of the stencil.
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "fitting/assembly_kernels.h"
#include "fitting/normal_solver.h"

namespace celadon {
namespace {

using assembly_kernels::FunctionTables;
using assembly_kernels::Translation;

// Breaks as edges of a grid's cells.
std::vector<int> grid_edges(std::span<const double> breaks_in_cells, int cells, const char* what) {
  std::vector<int> edges;
  for (const double b : breaks_in_cells) {
    const int edge = static_cast<int>(std::lround(b));
    if (std::abs(b - edge) > 1e-6 || edge < 0 || edge > cells || (!edges.empty() && edge <= edges.back()))
      throw std::invalid_argument(std::string("NormalEquations: a break along ") + what + " at cell " +
                                  std::to_string(b) + " is not on the grid's edges 0.." + std::to_string(cells));
    edges.push_back(edge);
  }
  return edges;
}

// Products of the functions x and y along v with the pairs (i, i + d) along u, g[d * pitch + i]: both ways round.
void add_to_planes(StencilMatrix& matrix, int x, int y, const double* g, int pitch) {
  const int plane = matrix.plane_of(x, y), n = matrix.count_u();
  for (int d = 0; d <= matrix.band_u(); ++d) {
    const double* from = g + static_cast<std::ptrdiff_t>(d) * pitch;
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
    : NormalEquations(sums, cells_of(sums), std::move(space)) {}

NormalEquations::NormalEquations(const MomentGrid& sums, const MomentCells& cells, FitSpace space)
    : space_(std::move(space)),
      arcs_(sums.arcs()),
      base_(sums.specification().base),
      jets_(space_.poles.any() ? std::make_shared<const PoleJets>(space_.u, space_.v, arcs_, space_.poles) : nullptr),
      matrix_(space_.u.free_count(), bandwidth(space_.u), space_.v.free_count(), bandwidth(space_.v)),
      rhs_(matrix_.field_size(), 0.0) {
  if (space_.u.degree() > sums.specification().degree_u || space_.v.degree() > sums.specification().degree_v)
    throw std::invalid_argument("NormalEquations: degrees (" + std::to_string(space_.u.degree()) + ", " +
                                std::to_string(space_.v.degree()) + ") exceed those of the sums");
  assemble(sums, cells);
}

void NormalEquations::assemble(const MomentGrid& sums, const MomentCells& cells) {
  const auto& spec = sums.specification();
  const MomentLayout& from = cells.layout;
  const int p = space_.u.degree(), q = space_.v.degree();

  std::vector<double> z_breaks, v_breaks;
  for (const double z : space_.u.breaks())
    z_breaks.push_back((z - spec.z_start_mm) / (spec.z_end_mm - spec.z_start_mm) * spec.z_intervals);
  for (const double v : space_.v.breaks()) v_breaks.push_back(v * spec.intervals_per_arc);
  const CellMap map_u = map_cells(cells.edges_z, grid_edges(z_breaks, sums.z_cells(), "z"), "z");
  const CellMap map_v = map_cells(cells.edges_v, grid_edges(v_breaks, sums.v_cells(), "v"), "v");
  std::vector<Translation> along_u;
  for (const auto& at : map_u.placement) along_u.emplace_back(at, 2 * p + 1);
  std::vector<FunctionTables> products_u;
  products_u.reserve(static_cast<std::size_t>(space_.u.intervals()));
  for (int k = 0; k < space_.u.intervals(); ++k) products_u.push_back(FunctionTables::along_u(space_.u, k));

  // One column of intervals at a time: its moments, the entries of its functions' pairs, then those into the planes.
  const auto stride = static_cast<std::size_t>(from.stride());
  const int count_u = space_.u.free_count(), offsets = matrix_.band_u() + 1, pitch = count_u + 8;
  const auto line = static_cast<std::size_t>(pitch);
  AlignedVector<double> merged(stride * static_cast<std::size_t>(space_.u.intervals()));
  std::vector<double> entries, ranges;
  for (int J = 0; J < space_.v.intervals(); ++J) {
    const int first_v = map_v.first[static_cast<std::size_t>(J)], last_v = map_v.last[static_cast<std::size_t>(J)];
    std::fill(merged.begin(), merged.end(), 0.0);
    for (int j = first_v; j < last_v; ++j) {
      for (int i = map_u.first.front(); i < map_u.last.back(); ++i) {
        const double* cell = cells.cell(i, j);
        weight_ += cell[0];
        square_ += cell[from.square()];
        range_ += cell[from.range(0, 0)];
      }
      const Translation along_v(map_v.placement[static_cast<std::size_t>(j)], 2 * q + 1);
      assembly_kernels::merge({cells.cell(0, j), from, p, q, &map_u.first, &map_u.last, &along_u,
                               last_v - first_v > 1 ? &along_v : nullptr},
                              merged.data());
    }

    const auto products_v = FunctionTables::along_v(space_.v, J);
    const auto active_v = space_.v.active(J);
    entries.assign(static_cast<std::size_t>(products_v.pairs * offsets) * line, 0.0);
    ranges.assign(active_v.size() * line, 0.0);
    for (int I = 0; I < space_.u.intervals(); ++I) {
      const double* moments = merged.data() + static_cast<std::size_t>(I) * stride;
      if (moments[0] == 0) {
        empty_.insert({I, J});
        continue;
      }
      assembly_kernels::add_entries(moments, from, p, q, products_u[static_cast<std::size_t>(I)], products_v,
                                    space_.u.active(I).front(), {entries.data(), ranges.data(), offsets, pitch});
    }
    for (std::size_t x = 0; x < active_v.size(); ++x)
      for (int i = 0; i < count_u; ++i)
        rhs_[matrix_.at(i, active_v[x])] += ranges[x * line + static_cast<std::size_t>(i)];
    for (int pair = 0; pair < products_v.pairs; ++pair) {
      const int x = active_v[static_cast<std::size_t>(products_v.x[pair])],
                y = active_v[static_cast<std::size_t>(products_v.y[pair])];
      const double* g = entries.data() + static_cast<std::size_t>(pair * offsets) * line;
      add_to_planes(matrix_, x, y, g, pitch);
      if (x != y) add_to_planes(matrix_, y, x, g, pitch);
    }
  }
}

int NormalEquations::supported_unknowns() const {
  int count = jets_ ? jets_->parameters() : 0;
  const int first = jets_ ? jets_->first_row() : 0, last = jets_ ? jets_->last_row() : matrix_.count_u();
  for (int j = 0; j < matrix_.count_v(); ++j)
    for (int i = first; i < last; ++i) count += matrix_.diagonal(i, j) > 0;
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
