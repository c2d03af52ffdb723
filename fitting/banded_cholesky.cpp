#include "fitting/banded_cholesky.h"

#include <algorithm>
#include <cmath>

namespace celadon {

BandedCholesky::BandedCholesky(const Eigen::MatrixXd& gram, int band) {
  const int n = static_cast<int>(gram.rows());
  rows_.resize(static_cast<std::size_t>(n));
  for (int i = 0; i < n && ok_; ++i) {
    Row& row = rows_[static_cast<std::size_t>(i)];
    row.first = i >= n - band ? 0 : std::max(0, i - band);
    row.entry.resize(static_cast<std::size_t>(i - row.first) + 1);
    for (int j = row.first; j <= i; ++j) {
      const Row& other = rows_[static_cast<std::size_t>(j)];
      double rest = gram(i, j);
      for (int k = std::max(row.first, other.first); k < j; ++k)
        rest -=
            row.entry[static_cast<std::size_t>(k - row.first)] * other.entry[static_cast<std::size_t>(k - other.first)];
      if (j < i) {
        row.entry[static_cast<std::size_t>(j - row.first)] = rest * other.entry.back();
      } else {
        ok_ = rest > 1e-14 * gram(i, i);
        row.entry.back() = 1 / std::sqrt(rest);
      }
    }
  }
}

void BandedCholesky::divide(Eigen::MatrixXd& x) const {
  const int n = static_cast<int>(rows_.size());
  for (int i = 0; i < n; ++i) {
    const Row& row = rows_[static_cast<std::size_t>(i)];
    for (int j = row.first; j < i; ++j) {
      const double entry = row.entry[static_cast<std::size_t>(j - row.first)];
      if (entry != 0) x.col(i) -= entry * x.col(j);
    }
    x.col(i) *= row.entry.back();
  }
  for (int i = n - 1; i >= 0; --i) {
    const Row& row = rows_[static_cast<std::size_t>(i)];
    x.col(i) *= row.entry.back();
    for (int j = row.first; j < i; ++j) {
      const double entry = row.entry[static_cast<std::size_t>(j - row.first)];
      if (entry != 0) x.col(j) -= entry * x.col(i);
    }
  }
}

}  // namespace celadon
