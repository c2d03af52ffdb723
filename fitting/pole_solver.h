#pragma once
// Normal equations between closed poles: the rows without a pole by their own factor, the few parameters of the poles
// as its border. Source: README.md, "Poles".

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <memory>

#include "fitting/block_cholesky.h"
#include "fitting/pole_jets.h"
#include "fitting/stencil_matrix.h"

namespace celadon {

/// The factor of P' M P, M over all free coefficients, P those that the jets allow.
class PoleSolver {
 public:
  /// @pre both are over the same free coefficients
  PoleSolver(const StencilMatrix& matrix, const PoleJets& jets);
  PoleSolver(const PoleSolver&) = delete;
  PoleSolver& operator=(const PoleSolver&) = delete;
  /// False: not positive definite to working precision.
  bool ok() const { return ok_; }
  /// x = P (P' M P)^-1 P' b over fields of M. @pre ok()
  void solve(const double* b, double* x) const;
  /// The entries of P (P' M P)^-1 P' at the places of M's own. @pre ok()
  StencilMatrix inverse_entries() const;

 private:
  Eigen::VectorXd free_rows(const double* field) const;
  Eigen::VectorXd solve_rows(const Eigen::VectorXd& b) const;

  const StencilMatrix& matrix_;
  const PoleJets& jets_;
  StencilMatrix rows_;  // of the rows without a pole
  std::unique_ptr<BlockCholesky> factor_;
  Eigen::MatrixXd border_, solved_border_;  // M Q in those rows, and its solution
  Eigen::LLT<Eigen::MatrixXd> schur_;
  bool ok_ = false;
};

}  // namespace celadon
