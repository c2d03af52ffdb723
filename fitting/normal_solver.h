#pragma once
// From streamed sums to the normal equations of any pair of nested spaces, and their solution.
// Source: README.md, "Restriction" and "Solver".

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "fitting/bending_energy.h"
#include "fitting/block_cholesky.h"
#include "fitting/moment_cells.h"
#include "fitting/moment_grid.h"
#include "fitting/pole_jets.h"
#include "fitting/pole_solver.h"
#include "fitting/range_function.h"
#include "fitting/range_space.h"
#include "fitting/stencil_matrix.h"

namespace celadon {

/// The pair of spaces a range function is sought in: u over z in millimetres, on a sphere over its meridian's
/// parameter, where its ends may be closed poles; v over the arcs' parameter.
struct FitSpace {
  RangeSpace u, v;
  Poles poles{};
};

/// A x = b of weighted least squares over the free coefficients of a pair of spaces, from the sums of a finer grid.
class NormalEquations {
 public:
  /// @pre the breaks of both spaces lie on edges of the grid's cells, their degrees do not exceed the grid's
  /// @throws std::invalid_argument if not
  NormalEquations(const MomentGrid& sums, FitSpace space);
  /// The same from larger cells of those sums. @pre the breaks lie on edges of these cells
  NormalEquations(const MomentGrid& sums, const MomentCells& cells, FitSpace space);

  const FitSpace& space() const { return space_; }
  const BaseArcs& arcs() const { return arcs_; }
  BaseKind base() const { return base_; }
  /// Of closed poles; nullptr: there are none, and every free coefficient is an unknown.
  const PoleJets* jets() const { return jets_.get(); }
  const StencilMatrix& matrix() const { return matrix_; }
  const AlignedVector<double>& right_hand_side() const { return rhs_; }
  /// Sum of the weights and of w r^2 over the samples inside the u space.
  double weight() const { return weight_; }
  double weighted_square() const { return square_; }
  double mean_range() const { return weight_ > 0 ? range_ / weight_ : 0; }
  /// Intervals of the spaces' own grid without any sample, and how many unknowns have samples under them.
  int empty_cells() const { return static_cast<int>(empty_.size()); }
  bool empty(int interval_u, int interval_v) const { return empty_.contains({interval_u, interval_v}); }
  int supported_unknowns() const;

  /// Residual sum of squares of a coefficient matrix (free, n_u x n_v). Resolves an RMS of about 1e-8 of the range.
  double residual_square(const Eigen::MatrixXd& free) const;
  /// x^T A x and b^T x, from fields or matrices of free coefficients.
  double quadratic(const Eigen::MatrixXd& free) const;
  /// b - A x, as a matrix.
  Eigen::MatrixXd gradient(const Eigen::MatrixXd& free) const;

  AlignedVector<double> to_field(const Eigen::MatrixXd& free) const;
  Eigen::MatrixXd to_matrix(const AlignedVector<double>& field) const;

 private:
  void assemble(const MomentGrid& sums, const MomentCells& cells);
  FitSpace space_;
  BaseArcs arcs_;
  BaseKind base_;
  std::shared_ptr<const PoleJets> jets_;
  StencilMatrix matrix_;
  AlignedVector<double> rhs_;
  double weight_ = 0, range_ = 0, square_ = 0;
  std::set<std::pair<int, int>> empty_;  // intervals along u and around
};

/// The pairs (Gram matrix, energy of second derivatives) of both directions, diagonalised: the same for every weight of
/// the energy. Computed when first asked for.
class SmoothingBasis {
 public:
  explicit SmoothingBasis(const NormalEquations& equations) : equations_(equations) {}
  struct Direction {
    Eigen::MatrixXd vectors;
    Eigen::VectorXd roots;  ///< square roots of the eigenvalues
  };
  const BendingEnergy& energy();
  const Direction& along_u();
  const Direction& around_v();

 private:
  const NormalEquations& equations_;
  std::optional<BendingEnergy> energy_;
  std::optional<Direction> u_, v_;
};

/// Solves (A + mu E) x = y for one mu >= 0: conjugate gradients with a Kronecker preconditioner, the direct factor when
/// they do not converge, the system is small or has closed poles. x and y are over all free coefficients; with closed
/// poles, x is the minimiser among those that their jets allow.
class NormalSolver {
 public:
  struct Options {
    double tolerance = 1e-11;  ///< of the preconditioned residual, relative to the start
    int max_iterations = 60;
    bool direct = false;              ///< do not try the iteration
    SmoothingBasis* basis = nullptr;  ///< shared between solvers of the same equations; must outlive them
  };
  /// `smoothing` is mu relative to trace A / trace E; 0 leaves the matrix alone. The equations must outlive the solver.
  NormalSolver(const NormalEquations& equations, double smoothing, const Options& options);
  explicit NormalSolver(const NormalEquations& equations, double smoothing = 0);
  NormalSolver(const NormalSolver&) = delete;
  NormalSolver& operator=(const NormalSolver&) = delete;

  /// The minimiser of |F - r|^2 + mu E(F). std::nullopt: the samples do not determine it.
  std::optional<Eigen::MatrixXd> solve();
  /// (A + mu E)^-1 y. @pre solve() has succeeded
  std::optional<Eigen::MatrixXd> apply_inverse(const Eigen::MatrixXd& y);
  /// tr (A + mu E)^-1 A, the effective number of parameters: exact for small systems, else estimated from fixed probes.
  double effective_parameters();

  int iterations() const { return iterations_; }
  bool direct() const { return factor_ || pole_factor_; }

 private:
  struct Preconditioner;
  const StencilMatrix& system() const { return regularised_ ? *regularised_ : equations_.matrix(); }
  bool conjugate_gradients(const AlignedVector<double>& b, double tolerance, AlignedVector<double>& x);
  bool solve_field(const AlignedVector<double>& b, double tolerance, AlignedVector<double>& x);
  bool factorise();
  const NormalEquations& equations_;
  Options options_;
  double mu_ = 0;
  std::optional<SmoothingBasis> own_basis_;
  std::optional<StencilMatrix> regularised_;
  std::shared_ptr<const Preconditioner> preconditioner_;
  std::unique_ptr<BlockCholesky> factor_;
  std::unique_ptr<PoleSolver> pole_factor_;
  int iterations_ = 0;
};

/// The bending energy of a pair of spaces at the sums' mean range.
BendingEnergy bending_energy(const NormalEquations& equations);
/// mu of a weight that is relative to the traces of the normal matrix and of the energy.
double energy_factor(const NormalEquations& equations, const BendingEnergy& energy, double relative_weight);

/// The range function of free coefficients, over the whole band of its u space.
RangeFunction range_function(const FitSpace& space, BaseKind base, const BaseArcs& arcs, const Eigen::MatrixXd& free);
RangeFunction range_function(const NormalEquations& equations, const Eigen::MatrixXd& free);

}  // namespace celadon
