#pragma once
// Cholesky factor of a Gram matrix of splines along one direction: banded, with corners where the direction is closed.
// Time and memory grow with its size alone. Internal to fitting/.

#include <Eigen/Core>
#include <vector>

namespace celadon {

class BandedCholesky {
 public:
  /// @param gram symmetric; entries further than `band` from the diagonal are zero but for the corners of a closed
  /// direction, which couple its last `band` rows to the first ones
  BandedCholesky(const Eigen::MatrixXd& gram, int band);
  /// False: not positive definite to working precision.
  bool ok() const { return ok_; }
  /// x := x G^-1. @pre x.cols() is the size of G; ok()
  void divide(Eigen::MatrixXd& x) const;

 private:
  struct Row {
    int first = 0;              ///< column of its first entry
    std::vector<double> entry;  ///< up to the diagonal, whose reciprocal is the last one
  };
  std::vector<Row> rows_;
  bool ok_ = true;
};

}  // namespace celadon
