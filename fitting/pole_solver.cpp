#include "fitting/pole_solver.h"

#include <algorithm>
#include <vector>

namespace celadon {
namespace {

StencilMatrix some_rows(const StencilMatrix& from, int first, int last) {
  StencilMatrix to(last - first, std::min(from.band_u(), last - first - 1), from.count_v(), from.band_v());
  const int band = to.band_u(), n = to.count_u();
  for (int o = 0; o < from.planes_v(); ++o)
    for (int du = -band; du <= band; ++du)
      for (int j = 0; j < from.count_v(); ++j) {
        const double* source = from.plane(o, du) + from.at(first, j);
        double* row = to.plane(o, du) + to.at(0, j);
        for (int i = std::max(0, -du); i < std::min(n, n - du); ++i) row[i] = source[i];
      }
  return to;
}

AlignedVector<double> to_field(const StencilMatrix& matrix, const Eigen::MatrixXd& free) {
  AlignedVector<double> field(matrix.field_size(), 0.0);
  for (int j = 0; j < matrix.count_v(); ++j)
    for (int i = 0; i < matrix.count_u(); ++i) field[matrix.at(i, j)] = free(i, j);
  return field;
}

}  // namespace

PoleSolver::PoleSolver(const StencilMatrix& matrix, const PoleJets& jets)
    : matrix_(matrix), jets_(jets), rows_(some_rows(matrix, jets.first_row(), jets.last_row())) {
  factor_ = std::make_unique<BlockCholesky>(rows_);
  if (!factor_->ok()) return;
  const int count = jets.parameters();
  border_.resize(rows_.size(), count);
  solved_border_.resize(rows_.size(), count);
  Eigen::MatrixXd corner(count, count);
  AlignedVector<double> product(matrix.field_size());
  for (int k = 0; k < count; ++k) {
    matrix.multiply(to_field(matrix, jets.column(k)).data(), product.data());
    border_.col(k) = free_rows(product.data());
    solved_border_.col(k) = solve_rows(border_.col(k));
    for (int l = 0; l < count; ++l) {
      double sum = 0;
      for (int j = 0; j < matrix.count_v(); ++j)
        for (int i = 0; i < matrix.count_u(); ++i) sum += jets.column(l)(i, j) * product[matrix.at(i, j)];
      corner(l, k) = sum;
    }
  }
  const Eigen::MatrixXd schur = corner - border_.transpose() * solved_border_;
  schur_.compute(0.5 * (schur + schur.transpose()));
  ok_ = schur_.info() == Eigen::Success;
}

Eigen::VectorXd PoleSolver::free_rows(const double* field) const {
  Eigen::VectorXd result(rows_.size());
  Eigen::Index k = 0;
  for (int j = 0; j < rows_.count_v(); ++j)
    for (int i = 0; i < rows_.count_u(); ++i) result[k++] = field[matrix_.at(jets_.first_row() + i, j)];
  return result;
}

Eigen::VectorXd PoleSolver::solve_rows(const Eigen::VectorXd& b) const {
  AlignedVector<double> right(rows_.field_size(), 0.0), x(rows_.field_size(), 0.0);
  Eigen::Index k = 0;
  for (int j = 0; j < rows_.count_v(); ++j)
    for (int i = 0; i < rows_.count_u(); ++i) right[rows_.at(i, j)] = b[k++];
  factor_->solve(right.data(), x.data());
  Eigen::VectorXd result(b.size());
  k = 0;
  for (int j = 0; j < rows_.count_v(); ++j)
    for (int i = 0; i < rows_.count_u(); ++i) result[k++] = x[rows_.at(i, j)];
  return result;
}

void PoleSolver::solve(const double* b, double* x) const {
  const Eigen::VectorXd of_rows = free_rows(b);
  Eigen::VectorXd of_poles(jets_.parameters());
  for (int k = 0; k < jets_.parameters(); ++k) {
    double sum = 0;
    for (int j = 0; j < matrix_.count_v(); ++j)
      for (int i = 0; i < matrix_.count_u(); ++i) sum += jets_.column(k)(i, j) * b[matrix_.at(i, j)];
    of_poles[k] = sum;
  }
  const Eigen::VectorXd parameters = schur_.solve(of_poles - solved_border_.transpose() * of_rows);
  const Eigen::VectorXd rows = solve_rows(of_rows - border_ * parameters);
  std::fill(x, x + matrix_.field_size(), 0.0);
  Eigen::Index at = 0;
  for (int j = 0; j < rows_.count_v(); ++j)
    for (int i = 0; i < rows_.count_u(); ++i) x[matrix_.at(jets_.first_row() + i, j)] = rows[at++];
  for (int k = 0; k < jets_.parameters(); ++k)
    for (int j = 0; j < matrix_.count_v(); ++j)
      for (int i = 0; i < matrix_.count_u(); ++i) x[matrix_.at(i, j)] += parameters[k] * jets_.column(k)(i, j);
}

// The rows' own inverse and what their border adds: G S^-1 G' with G = Q - M_rows^-1 M Q over all free coefficients.
StencilMatrix PoleSolver::inverse_entries() const {
  StencilMatrix entries(matrix_.count_u(), matrix_.band_u(), matrix_.count_v(), matrix_.band_v());
  const StencilMatrix of_rows = factor_->inverse_entries();
  const int first = jets_.first_row(), n = rows_.count_u(), band = rows_.band_u();
  for (int o = 0; o < rows_.planes_v(); ++o)
    for (int du = -band; du <= band; ++du)
      for (int j = 0; j < rows_.count_v(); ++j)
        for (int i = std::max(0, -du); i < std::min(n, n - du); ++i)
          entries.plane(o, du)[entries.at(first + i, j)] = of_rows.plane(o, du)[of_rows.at(i, j)];
  if (jets_.parameters() == 0) return entries;

  Eigen::MatrixXd g(jets_.parameters(), matrix_.size());  // a column an unknown, u running fastest
  for (int k = 0; k < jets_.parameters(); ++k) {
    Eigen::MatrixXd free = jets_.column(k);
    Eigen::Index at = 0;
    for (int j = 0; j < rows_.count_v(); ++j)
      for (int i = 0; i < n; ++i) free(first + i, j) -= solved_border_(at++, k);
    g.row(k) = Eigen::Map<const Eigen::RowVectorXd>(free.data(), free.size());
  }
  schur_.matrixL().solveInPlace(g);
  entries.add_product(g);
  return entries;
}

}  // namespace celadon
