#include "fitting/block_cholesky.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace celadon {
namespace {

// Block (row, column) of the matrix, whichever direction the blocks run along.
Eigen::MatrixXd block(const StencilMatrix& a, bool outer_is_v, int row, int column) {
  const int nu = a.count_u(), nv = a.count_v(), band = a.band_u();
  if (outer_is_v) {
    Eigen::MatrixXd m = Eigen::MatrixXd::Zero(nu, nu);
    for (int o = 0; o < a.planes_v(); ++o) {
      if (a.neighbour(row, o) != column) continue;
      for (int du = -band; du <= band; ++du)
        for (int i = std::max(0, -du); i < std::min(nu, nu - du); ++i) m(i, i + du) += a.plane(o, du)[a.at(i, row)];
    }
    return m;
  }
  Eigen::MatrixXd m = Eigen::MatrixXd::Zero(nv, nv);
  const int du = column - row;
  if (du < -band || du > band) return m;
  for (int o = 0; o < a.planes_v(); ++o)
    for (int j = 0; j < nv; ++j) m(j, a.neighbour(j, o)) += a.plane(o, du)[a.at(row, j)];
  return m;
}

}  // namespace

BlockCholesky::BlockCholesky(const StencilMatrix& matrix) : matrix_(matrix) {
  // Work grows with the cube of the block; the border of a closed direction about doubles it.
  const double nu = matrix.count_u(), nv = matrix.count_v();
  outer_is_v_ = 2 * nu * nu <= nv * nv;
  outer_ = outer_is_v_ ? matrix.count_v() : matrix.count_u();
  inner_ = outer_is_v_ ? matrix.count_u() : matrix.count_v();
  const int band = outer_is_v_ ? matrix.band_v() : matrix.band_u();
  const int border = outer_is_v_ ? std::max(0, outer_ - band) : outer_;

  rows_.resize(static_cast<std::size_t>(outer_));
  blocks_.resize(static_cast<std::size_t>(outer_));
  for (int k = 0; k < outer_; ++k) {
    auto& rows = rows_[static_cast<std::size_t>(k)];
    for (int i = k; i < std::min(outer_, k + band + 1); ++i) rows.push_back(i);
    for (int i = std::max(k + band + 1, border); i < outer_; ++i) rows.push_back(i);
    for (const int i : rows) blocks_[static_cast<std::size_t>(k)].push_back(block(matrix, outer_is_v_, i, k));
  }
  for (int k = 0; k < outer_; ++k) {
    auto& column = blocks_[static_cast<std::size_t>(k)];
    const auto& rows = rows_[static_cast<std::size_t>(k)];
    const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> factor(column[0]);
    if (factor.info() != Eigen::Success) return;
    const Eigen::MatrixXd& diagonal = column[0];
    for (std::size_t a = 1; a < column.size(); ++a)
      diagonal.triangularView<Eigen::Lower>().transpose().solveInPlace<Eigen::OnTheRight>(column[a]);
    for (std::size_t a = 1; a < column.size(); ++a)
      for (std::size_t b = a; b < column.size(); ++b)
        find(rows[b], rows[a])->noalias() -= column[b] * column[a].transpose();
  }
  ok_ = true;
}

Eigen::MatrixXd* BlockCholesky::find(int row, int column) {
  const auto& rows = rows_[static_cast<std::size_t>(column)];
  const auto at = std::lower_bound(rows.begin(), rows.end(), row);
  return &blocks_[static_cast<std::size_t>(column)][static_cast<std::size_t>(at - rows.begin())];
}

std::size_t BlockCholesky::position(int outer, int inner) const {
  return outer_is_v_ ? matrix_.at(inner, outer) : matrix_.at(outer, inner);
}

void BlockCholesky::solve(const double* b, double* x) const {
  Eigen::MatrixXd y(inner_, outer_);
  for (int k = 0; k < outer_; ++k)
    for (int i = 0; i < inner_; ++i) y(i, k) = b[position(k, i)];
  for (int k = 0; k < outer_; ++k) {
    const auto& column = blocks_[static_cast<std::size_t>(k)];
    const auto& rows = rows_[static_cast<std::size_t>(k)];
    auto c = y.col(k);
    column[0].triangularView<Eigen::Lower>().solveInPlace(c);
    for (std::size_t a = 1; a < column.size(); ++a) y.col(rows[a]).noalias() -= column[a] * c;
  }
  for (int k = outer_ - 1; k >= 0; --k) {
    const auto& column = blocks_[static_cast<std::size_t>(k)];
    const auto& rows = rows_[static_cast<std::size_t>(k)];
    auto c = y.col(k);
    for (std::size_t a = 1; a < column.size(); ++a) c.noalias() -= column[a].transpose() * y.col(rows[a]);
    column[0].triangularView<Eigen::Lower>().transpose().solveInPlace(c);
  }
  std::fill(x, x + matrix_.field_size(), 0.0);
  for (int k = 0; k < outer_; ++k)
    for (int i = 0; i < inner_; ++i) x[position(k, i)] = y(i, k);
}

}  // namespace celadon
