#pragma once
// Cholesky factor of a StencilMatrix in blocks: the direct way, when samples are too uneven for the iteration.
// Source: README.md, "Solver".

#include <Eigen/Core>
#include <vector>

#include "fitting/stencil_matrix.h"

namespace celadon {

/// Blocks run along the longer direction; the last band_v block columns of a closed direction border the others.
class BlockCholesky {
 public:
  explicit BlockCholesky(const StencilMatrix& matrix);
  /// False: the matrix is not positive definite to working precision.
  bool ok() const { return ok_; }
  /// x = A^-1 b over fields. @pre ok()
  void solve(const double* b, double* x) const;
  /// The entries of A^-1 at the places of A's own: what Takahashi's recursion gives without the whole inverse, at about
  /// the cost of the factor. @pre ok()
  StencilMatrix inverse_entries() const;

 private:
  std::size_t position(int outer, int inner) const;
  Eigen::MatrixXd* find(int row, int column);
  const StencilMatrix& matrix_;
  bool outer_is_v_ = true, ok_ = false;
  int outer_ = 0, inner_ = 0;
  std::vector<std::vector<int>> rows_;                ///< block rows present in each block column, ascending
  std::vector<std::vector<Eigen::MatrixXd>> blocks_;  ///< the factor's in the same order, padded; diagonal: inverses
};

}  // namespace celadon
