#include "fitting/cell_residuals.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace celadon {
namespace {

std::vector<int> edges_of(const std::vector<double>& breaks, double start, double cells_per_unit) {
  std::vector<int> edges;
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

}  // namespace celadon
