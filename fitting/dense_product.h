#pragma once
// Products of small dense matrices, compiled once per SIMD target and chosen at run time: Eigen knows the baseline's
// instructions only. Internal to fitting/.

#include <Eigen/Core>

namespace celadon {

/// Rows of a matrix that takes part: a multiple of four, those behind the last one zero.
inline Eigen::Index padded_rows(Eigen::Index rows) {
  return (rows + 3) / 4 * 4;
}
Eigen::MatrixXd with_padded_rows(const Eigen::MatrixXd& matrix);

/// c += factor a b, or factor a b'. The inner dimension is a.cols(), the number of columns c.cols().
/// @pre a and c have the same padded rows; b has the inner dimension (of b', c.cols()) at least
void add_product(double factor, const Eigen::MatrixXd& a, const Eigen::MatrixXd& b, Eigen::MatrixXd& c);
void add_transposed_product(double factor, const Eigen::MatrixXd& a, const Eigen::MatrixXd& b, Eigen::MatrixXd& c);

}  // namespace celadon
