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

// The other way: what the stencil holds of block (row, column), row >= column, of a symmetric matrix.
void put_block(StencilMatrix& a, bool outer_is_v, int row, int column, const Eigen::MatrixXd& m) {
  const int nu = a.count_u(), nv = a.count_v(), band = a.band_u();
  if (outer_is_v) {
    for (int o = 0; o < a.planes_v(); ++o)
      for (int du = -band; du <= band; ++du)
        for (int i = std::max(0, -du); i < std::min(nu, nu - du); ++i) {
          if (a.neighbour(row, o) == column) a.plane(o, du)[a.at(i, row)] = m(i, i + du);
          if (a.neighbour(column, o) == row) a.plane(o, du)[a.at(i, column)] = m(i + du, i);
        }
    return;
  }
  const int du = column - row;
  if (du < -band) return;
  for (int o = 0; o < a.planes_v(); ++o)
    for (int j = 0; j < nv; ++j) {
      const int k = a.neighbour(j, o);
      a.plane(o, du)[a.at(row, j)] = m(j, k);
      a.plane(o, -du)[a.at(column, j)] = m(k, j);
    }
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

// With A = L L' and G_jk = L_jk L_kk^-1 for the rows j below k in column k:
//   Z_jk = -sum over i of Z_ji G_ik,   Z_kk = L_kk^-T L_kk^-1 - sum over j of G_jk' Z_jk
// from the last column back; every Z_ji that is asked for is in the pattern of L.
StencilMatrix BlockCholesky::inverse_entries() const {
  StencilMatrix entries(matrix_.count_u(), matrix_.band_u(), matrix_.count_v(), matrix_.band_v());
  std::vector<std::vector<Eigen::MatrixXd>> inverse(blocks_.size());  // columns like blocks_; gone when not needed
  const int band = outer_is_v_ ? matrix_.band_v() : matrix_.band_u();
  const int border = outer_is_v_ ? std::max(0, outer_ - band) : outer_;
  const auto transposed = [&](const Eigen::MatrixXd& m) { return with_padded_rows(m.topRows(inner_).transpose()); };
  const auto found = [&](int row, int column) -> const Eigen::MatrixXd& {
    const auto& rows = rows_[static_cast<std::size_t>(column)];
    const auto at = std::lower_bound(rows.begin(), rows.end(), row) - rows.begin();
    return inverse[static_cast<std::size_t>(column)][static_cast<std::size_t>(at)];
  };
  const Eigen::MatrixXd zero = Eigen::MatrixXd::Zero(padded_rows(inner_), inner_);
  for (int k = outer_ - 1; k >= 0; --k) {
    const auto& column = blocks_[static_cast<std::size_t>(k)];
    const auto& rows = rows_[static_cast<std::size_t>(k)];
    auto& z = inverse[static_cast<std::size_t>(k)];
    z.assign(column.size(), zero);
    std::vector<Eigen::MatrixXd> g(column.size());
    for (std::size_t a = 1; a < column.size(); ++a) {
      g[a] = zero;
      add_product(1, column[a], column[0], g[a]);
    }
    for (std::size_t a = 1; a < column.size(); ++a)
      for (std::size_t b = 1; b < column.size(); ++b) {
        const bool below = rows[a] >= rows[b];
        const Eigen::MatrixXd& known = below ? found(rows[a], rows[b]) : found(rows[b], rows[a]);
        add_product(-1, below ? known : transposed(known), g[b], z[a]);
      }
    const Eigen::MatrixXd diagonal = transposed(column[0]);
    add_product(1, diagonal, column[0], z[0]);
    for (std::size_t a = 1; a < column.size(); ++a) add_product(-1, transposed(g[a]), z[a], z[0]);
    for (std::size_t a = 0; a < column.size(); ++a) put_block(entries, outer_is_v_, rows[a], k, z[a]);
    const int done = k + band;
    if (done < border) inverse[static_cast<std::size_t>(done)].clear();
  }
  return entries;
}

}  // namespace celadon
