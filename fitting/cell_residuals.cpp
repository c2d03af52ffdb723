#include "fitting/cell_residuals.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace celadon {
namespace {

std::vector<int> edges_of(const std::vector<double>& breaks, double start, double cells_per_unit) {
  std::vector<int> edges;
  edges.reserve(breaks.size());
  for (const double b : breaks) edges.push_back(static_cast<int>(std::lround((b - start) * cells_per_unit)));
  return edges;
}

// Coefficients c of F = sum of c(b, a) s^b t^a on one interval.
Eigen::MatrixXd polynomial(const FitSpace& space, const Eigen::MatrixXd& free, int I, int J) {
  Eigen::MatrixXd c = Eigen::MatrixXd::Zero(space.u.degree() + 1, space.v.degree() + 1);
  const auto active_u = space.u.active(I), active_v = space.v.active(J);
  for (std::size_t x = 0; x < active_v.size(); ++x) {
    const auto around = space.v.polynomial(J, static_cast<int>(x));
    for (std::size_t y = 0; y < active_u.size(); ++y) {
      const auto along = space.u.polynomial(I, static_cast<int>(y));
      for (Eigen::Index a = 0; a < c.cols(); ++a)
        for (Eigen::Index b = 0; b < c.rows(); ++b)
          c(b, a) +=
              free(active_u[y], active_v[x]) * along[static_cast<std::size_t>(b)] * around[static_cast<std::size_t>(a)];
    }
  }
  return c;
}

// Powers of an interval's coordinate in those of one of its cells: s = alpha s' + beta, column b the coefficients of
// s^b.
Eigen::MatrixXd inside(int first, int last, int cell, Eigen::Index powers) {
  const double alpha = 1.0 / (last - first), beta = (2.0 * (cell - first) + 1) * alpha - 1;
  Eigen::MatrixXd t = Eigen::MatrixXd::Zero(powers, powers);
  t(0, 0) = 1;
  for (Eigen::Index b = 1; b < powers; ++b)
    for (Eigen::Index k = 0; k <= b; ++k) t(k, b) = beta * t(k, b - 1) + (k > 0 ? alpha * t(k - 1, b - 1) : 0);
  return t;
}

}  // namespace

CellResiduals cell_residuals(const MomentGrid& sums, const NormalEquations& equations, const Eigen::MatrixXd& free) {
  const auto& spec = sums.specification();
  const FitSpace& space = equations.space();
  CellResiduals result{
      MergedMoments(cells_of(sums),
                    edges_of(space.u.breaks(), spec.z_start_mm, spec.z_intervals / (spec.z_end_mm - spec.z_start_mm)),
                    edges_of(space.v.breaks(), 0, spec.intervals_per_arc)),
      {},
      {}};
  const MomentCells cells = result.moments.cells();
  const MomentLayout& at = cells.layout;
  result.square = Eigen::MatrixXd::Zero(cells.count_z(), cells.count_v());
  result.weight = result.square;
  for (int J = 0; J < cells.count_v(); ++J)
    for (int I = 0; I < cells.count_z(); ++I) {
      const double* m = cells.cell(I, J);
      result.weight(I, J) = m[0];
      if (!(m[0] > 0)) continue;
      // About the interval's mean range, so that less cancels.
      const double mean = m[at.range(0, 0)] / m[0];
      Eigen::MatrixXd c = polynomial(space, free, I, J);
      c(0, 0) -= mean;
      double square = m[at.square()] - 2 * mean * m[at.range(0, 0)] + mean * mean * m[0];
      const int p = space.u.degree(), q = space.v.degree();
      for (int a = 0; a <= q; ++a)
        for (int b = 0; b <= p; ++b) {
          double fitted = 0;
          for (int e = 0; e <= q; ++e)
            for (int d = 0; d <= p; ++d) fitted += c(d, e) * m[at.weight(b + d, a + e)];
          square += c(b, a) * (fitted - 2 * (m[at.range(b, a)] - mean * m[at.weight(b, a)]));
        }
      result.square(I, J) = std::max(square, 0.0);
    }
  return result;
}

double scattered_kappa(const MomentGrid& sums, const LadderFit& member) {
  const NormalEquations& equations = *member.equations;
  const FitSpace& space = equations.space();
  const int nz = sums.z_cells(), nv = sums.v_cells();
  // Sums of residuals over the grid's cells: F's polynomial on an interval, in the coordinates of each cell of it.
  const auto& spec = sums.specification();
  const std::vector<int> edges_u = edges_of(space.u.breaks(), spec.z_start_mm,
                                            spec.z_intervals / (spec.z_end_mm - spec.z_start_mm)),
                         edges_v = edges_of(space.v.breaks(), 0, spec.intervals_per_arc);
  const MomentLayout& at = sums.layout();
  Eigen::MatrixXd residual = Eigen::MatrixXd::Zero(nz, nv), weight = residual;
  for (std::size_t J = 0; J + 1 < edges_v.size(); ++J)
    for (std::size_t I = 0; I + 1 < edges_u.size(); ++I) {
      const Eigen::MatrixXd c = polynomial(space, member.free, static_cast<int>(I), static_cast<int>(J));
      for (int j = edges_v[J]; j < edges_v[J + 1]; ++j)
        for (int i = edges_u[I]; i < edges_u[I + 1]; ++i) {
          const double* m = sums.cell(i, j);
          weight(i, j) = m[0];
          const Eigen::MatrixXd f = inside(edges_u[I], edges_u[I + 1], i, c.rows()) * c *
                                    inside(edges_v[J], edges_v[J + 1], j, c.cols()).transpose();
          residual(i, j) = m[at.range(0, 0)];
          for (Eigen::Index a = 0; a < f.cols(); ++a)
            for (Eigen::Index b = 0; b < f.rows(); ++b)
              residual(i, j) -= f(b, a) * m[at.weight(static_cast<int>(b), static_cast<int>(a))];
        }
    }
  int du = 1, dv = 1;
  const int around = 2 * equations.matrix().count_v(), along = 2 * equations.matrix().count_u();
  while (nv / (2 * dv) >= std::max(around, 4)) dv *= 2;
  while (nz / (2 * du) >= std::max(along, 4)) du *= 2;
  double means = 0, cells = 0;
  for (int j = 0; j < nv; j += dv)
    for (int i = 0; i < nz; i += du) {
      const int h = std::min(du, nz - i), w = std::min(dv, nv - j);
      const double n = weight.block(i, j, h, w).sum();
      if (!(n > 0)) continue;
      means += std::pow(residual.block(i, j, h, w).sum(), 2) / n;
      ++cells;
    }
  const double free = cells - member.parameters, n = equations.weight();
  if (free < 8 || !(member.residual_square > 0)) return 1;
  const double kappa = means / free / (member.residual_square / std::max(1.0, n - member.parameters));
  return kappa > 1 + 3 * std::sqrt(2 / free) ? kappa : 1;
}

}  // namespace celadon
