#include "fitting/block_cholesky.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <utility>

#include "fitting/dense_product.h"

namespace celadon {
namespace {

// Block (row, column) of the matrix, whichever direction the blocks run along.
Eigen::MatrixXd block(const StencilMatrix& a, bool outer_is_v, int row, int column) {
  const int nu = a.count_u(), nv = a.count_v(), band = a.band_u();
  if (outer_is_v) {
    Eigen::MatrixXd m = Eigen::MatrixXd::Zero(padded_rows(nu), nu);
    for (int o = 0; o < a.planes_v(); ++o) {
      if (a.neighbour(row, o) != column) continue;
      for (int du = -band; du <= band; ++du)
        for (int i = std::max(0, -du); i < std::min(nu, nu - du); ++i) m(i, i + du) += a.plane(o, du)[a.at(i, row)];
    }
    return m;
  }
  Eigen::MatrixXd m = Eigen::MatrixXd::Zero(padded_rows(nv), nv);
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
    const Eigen::LLT<Eigen::MatrixXd> factor(column[0].topRows(inner_));
    if (factor.info() != Eigen::Success) return;
    column[0].setZero();
    column[0].topRows(inner_) = factor.matrixL().solve(Eigen::MatrixXd::Identity(inner_, inner_));
    for (std::size_t a = 1; a < column.size(); ++a) {
      Eigen::MatrixXd below = Eigen::MatrixXd::Zero(column[a].rows(), inner_);
      add_transposed_product(1, column[a], column[0], below);
      column[a] = std::move(below);
    }
    for (std::size_t a = 1; a < column.size(); ++a)
      for (std::size_t b = a; b < column.size(); ++b)
        add_transposed_product(-1, column[b], column[a], *find(rows[b], rows[a]));
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
    y.col(k) = (column[0].topRows(inner_).triangularView<Eigen::Lower>() * y.col(k)).eval();
    for (std::size_t a = 1; a < column.size(); ++a) y.col(rows[a]).noalias() -= column[a].topRows(inner_) * y.col(k);
  }
  for (int k = outer_ - 1; k >= 0; --k) {
    const auto& column = blocks_[static_cast<std::size_t>(k)];
    const auto& rows = rows_[static_cast<std::size_t>(k)];
    for (std::size_t a = 1; a < column.size(); ++a)
      y.col(k).noalias() -= column[a].topRows(inner_).transpose() * y.col(rows[a]);
    y.col(k) = (column[0].topRows(inner_).triangularView<Eigen::Lower>().transpose() * y.col(k)).eval();
  }
  std::fill(x, x + matrix_.field_size(), 0.0);
  for (int k = 0; k < outer_; ++k)
    for (int i = 0; i < inner_; ++i) x[position(k, i)] = y(i, k);
}

}  // namespace celadon
