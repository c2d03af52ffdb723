#include "fitting/regular_grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "fitting/banded_cholesky.h"
#include "fitting/bspline_basis.h"
#include "fitting/moment_kernels.h"
#include "fitting/row_sums.h"

namespace celadon {

namespace {

template <class... Parts>
[[noreturn]] void refuse(const Parts&... parts) {
  std::ostringstream text;
  text << "fit_regular_grid: ";
  (text << ... << parts);
  throw std::invalid_argument(text.str());
}

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// A place of one direction: its interval, and the powers of the local coordinate there.
struct Place {
  int interval = 0;
  std::array<double, kMaxDegree + 1> power{};
};

Place place_in(const RangeSpace& space, double t) {
  const std::vector<double>& breaks = space.breaks();
  const auto after = std::upper_bound(breaks.begin() + 1, breaks.end() - 1, t);
  Place place;
  place.interval = static_cast<int>(after - breaks.begin()) - 1;
  const double s = 2 * (t - after[-1]) / (after[0] - after[-1]) - 1;
  double power = 1;
  for (double& p : place.power) {
    p = power;
    power *= s;
  }
  return place;
}

/// The values of the functions that do not vanish at a place.
std::array<double, kMaxDegree + 1> values_at(const RangeSpace& space, const Place& place) {
  std::array<double, kMaxDegree + 1> values{};
  for (std::size_t a = 0; a < space.active(place.interval).size(); ++a) {
    const auto polynomial = space.polynomial(place.interval, static_cast<int>(a));
    for (std::size_t k = 0; k < polynomial.size(); ++k) values[a] += polynomial[k] * place.power[k];
  }
  return values;
}

/// Sums of the products of a direction's functions over its places.
class Gram {
 public:
  explicit Gram(const RangeSpace& space)
      : space_(space), sums_(Eigen::MatrixXd::Zero(space.free_count(), space.free_count())) {}

  void add(const Place& place) {
    const auto values = values_at(space_, place);
    const auto active = space_.active(place.interval);
    for (std::size_t a = 0; a < active.size(); ++a)
      for (std::size_t b = 0; b < active.size(); ++b) sums_(active[a], active[b]) += values[a] * values[b];
  }

  /// x := x Gram^-1, or false.
  bool divide(Eigen::MatrixXd& x) const {
    const BandedCholesky factor(sums_, space_.degree());
    if (factor.ok()) factor.divide(x);
    return factor.ok();
  }

 private:
  const RangeSpace& space_;
  Eigen::MatrixXd sums_;
};

/// For each function around, the sum over the rows of its value there times the row: one value a column.
class RowSums {
 public:
  RowSums(const RangeSpace& v, Eigen::Index columns)
      : v_(v),
        active_(std::max(2, v.degree() + 1)),
        run_sums_(active_, columns),
        sums_(RowMajor::Zero(v.free_count(), columns)) {}

  /// Rows that share an interval wait until they are summed in one go, as many as stay in the cache.
  void add(const Place& place, const double* row) {
    if (place.interval != interval_ || rows_.size() == kMostRows) finish();
    interval_ = place.interval;
    rows_.push_back(row);
    const auto values = values_at(v_, place);
    values_.insert(values_.end(), values.begin(), values.begin() + active_);
  }

  const RowMajor& finish() {
    if (!rows_.empty()) {
      const auto columns = static_cast<std::size_t>(run_sums_.cols());
      sum_rows({rows_.data(), values_.data(), rows_.size(), columns, active_ - 1, false}, run_sums_.data());
      const auto active = v_.active(interval_);
      for (std::size_t a = 0; a < active.size(); ++a) {
        sums_.row(active[a]) += run_sums_.row(static_cast<Eigen::Index>(a));
      }
    }
    rows_.clear();
    values_.clear();
    return sums_;
  }

 private:
  static constexpr std::size_t kMostRows = 16;
  const RangeSpace& v_;
  int active_;  // functions that are summed for each row, one of them zero if the space is constant
  RowMajor run_sums_, sums_;
  int interval_ = 0;
  std::vector<const double*> rows_;
  std::vector<double> values_;
};

/// Neighbouring columns that share an interval of u: where they begin, and the values of its functions there, one array
/// of the length of all columns for each.
struct ColumnRuns {
  std::vector<std::size_t> first;
  std::vector<int> interval;
  RowMajor values;
};

}  // namespace

std::optional<RangeFunction> fit_regular_grid(const FitSpace& space, const BaseArcs& arcs, const RangeGrid& r,
                                              double offset_rows, std::span<const double> z) {
  const RangeSpace &u = space.u, &v = space.v;
  const auto columns = static_cast<std::size_t>(r.cols());
  if (z.size() != columns) refuse(z.size(), " heights are given for ", columns, " columns");
  if (!arcs.closed()) refuse("the arcs are open, rows go all around");
  if (space.poles.any()) refuse("the space has closed poles, a grid over a cylinder has none");

  Gram gram_u(u), gram_v(v);
  ColumnRuns runs{{}, {}, RowMajor::Zero(u.degree() + 1, r.cols())};
  for (std::size_t j = 0; j < columns; ++j) {
    if (!(z[j] >= u.breaks().front() && z[j] <= u.breaks().back())) {
      refuse("column ", j, " is at z = ", z[j], " mm, outside the band of the space, ", u.breaks().front(), " to ",
             u.breaks().back(), " mm");
    }
    const Place place = place_in(u, z[j]);
    gram_u.add(place);
    if (runs.interval.empty() || runs.interval.back() != place.interval) {
      runs.first.push_back(j);
      runs.interval.push_back(place.interval);
    }
    const auto values = values_at(u, place);
    for (Eigen::Index a = 0; a < runs.values.rows(); ++a) {
      runs.values(a, static_cast<Eigen::Index>(j)) = values[static_cast<std::size_t>(a)];
    }
  }
  runs.first.push_back(columns);

  RowSums row_sums(v, r.cols());
  for (Eigen::Index i = 0; i < r.rows(); ++i) {
    const double* row = r.row(i).data();
    if (!moment_kernels::all_positive(row, columns)) {
      const auto bad = std::find_if(row, row + columns, [](double x) { return !(x > 0 && std::isfinite(x)); });
      refuse("the range in row ", i, ", column ", bad - row, " is ", *bad,
             ", it must be finite and positive; leave samples out by adding the others to a MomentGrid");
    }
    const double turn = (static_cast<double>(i) + offset_rows) / static_cast<double>(r.rows());
    const Place place = place_in(v, arcs.v_of_theta(2 * std::numbers::pi * turn));
    gram_v.add(place);
    row_sums.add(place, row);
  }
  const RowMajor& sums = row_sums.finish();

  Eigen::MatrixXd right = Eigen::MatrixXd::Zero(v.free_count(), u.free_count());
  constexpr int kDotProducts = 8;  // at a time, as many as the kernel takes
  for (std::size_t k = 0; k < runs.interval.size(); ++k) {
    const std::size_t first = runs.first[k], count = runs.first[k + 1] - first;
    const auto active = u.active(runs.interval[k]);
    for (std::size_t a = 0; a < active.size(); ++a) {
      const double* values = runs.values.row(static_cast<Eigen::Index>(a)).data() + first;
      for (int row = 0; row < v.free_count(); row += kDotProducts) {
        const int rows = std::min(kDotProducts, v.free_count() - row);
        std::array<double, kDotProducts> products;
        moment_kernels::dot_products(sums.row(row).data() + first, columns, rows, values, count, products.data());
        for (int i = 0; i < rows; ++i) right(row + i, active[a]) += products[static_cast<std::size_t>(i)];
      }
    }
  }
  if (!gram_u.divide(right)) return std::nullopt;
  Eigen::MatrixXd free = right.transpose();
  if (!gram_v.divide(free)) return std::nullopt;
  return range_function(space, BaseKind::cylinder, arcs, free);
}

}  // namespace celadon
