#include "daemon/files/sphere_grid.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "fitting/range_function.h"

namespace celadon {
namespace {

constexpr int kFewestRows = 8;
constexpr double kGrowth = 1.15;
constexpr std::size_t kLargestGrid = 50'000'000;

/// Rows of points in the base frame, from above to below; a pole's row holds one point as often as others hold theirs.
struct PointGrid {
  int rows = 0, columns = 0;  ///< intervals along and around
  int in_row = 0;             ///< points: of a part of the turn one more than intervals
  std::vector<Eigen::Vector3d> p_B;
  const Eigen::Vector3d& at(int i, int j) const {
    return p_B[static_cast<std::size_t>(i) * static_cast<std::size_t>(in_row) + static_cast<std::size_t>(j % in_row)];
  }
};

PointGrid points_of(const RangeFunction& range, int rows, const std::vector<double>& theta) {
  const int in_row = static_cast<int>(theta.size()), columns = in_row - (range.base().arcs.closed() ? 0 : 1);
  if (static_cast<double>(rows) * columns > static_cast<double>(kLargestGrid))
    throw std::length_error("mesh_of: the chord tolerance asks for more than 100 million triangles; take a larger one");
  const BaseSurface& base = range.base();
  const BaseArcs& meridian = BaseSurface::meridian();
  PointGrid grid{rows, columns, in_row, {}};
  std::vector<double> along(theta.size()), rho(theta.size());
  const double first = meridian.theta_of_v(base.band_start), last = meridian.theta_of_v(base.band_end);
  for (int i = 0; i <= rows; ++i) {
    const double phi = first + (last - first) * i / rows;
    const double w = i == 0 ? base.band_start : i == rows ? base.band_end : meridian.v_of_theta(phi);
    std::fill(along.begin(), along.end(), w);
    range.evaluate(theta.data(), along.data(), theta.size(), rho.data());
    const bool pole = w == 0 || w == BaseSurface::kMeridianEnd;
    const double s = pole ? 0 : std::sin(phi), c = w == 0 ? 1 : w == BaseSurface::kMeridianEnd ? -1 : std::cos(phi);
    for (std::size_t j = 0; j < rho.size(); ++j) {
      if (!(rho[j] > 0)) throw std::invalid_argument("mesh_of: the range is not positive everywhere");
      const double r = rho[pole ? 0 : j];
      grid.p_B.emplace_back(r * s * std::cos(theta[j]), r * s * std::sin(theta[j]), r * c);
    }
  }
  return grid;
}

/// Largest distances, along rays, of the surface from edges along, edges around, and diagonals and middles of
/// triangles.
struct Misses {
  double along = 0, around = 0, across = 0;
};

Misses misses_of(const RangeFunction& range, const PointGrid& grid) {
  const BaseSurface& base = range.base();
  Misses misses;
  std::vector<Eigen::Vector3d> probes;
  std::vector<double> theta, along, rho;
  const auto largest = [&] {
    theta.clear(), along.clear();
    for (const auto& p : probes) {
      theta.push_back(std::atan2(p.y(), p.x()));
      along.push_back(base.along_of(p));
    }
    rho.resize(probes.size());
    range.evaluate(theta.data(), along.data(), theta.size(), rho.data());
    double result = 0;
    for (std::size_t k = 0; k < rho.size(); ++k) result = std::max(result, std::abs(probes[k].norm() - rho[k]));
    probes.clear();
    return result;
  };
  for (int i = 0; i < grid.rows; ++i) {
    for (int j = 0; j < grid.columns; ++j) probes.push_back((grid.at(i, j) + grid.at(i + 1, j)) / 2);
    misses.along = std::max(misses.along, largest());
    // A rim's edges belong to the fan too: both ends count.
    for (const int row : {i, i + 1})
      for (int j = 0; j < grid.columns; ++j) probes.push_back((grid.at(row, j) + grid.at(row, j + 1)) / 2);
    misses.around = std::max(misses.around, largest());
    for (int j = 0; j < grid.columns; ++j) {
      const Eigen::Vector3d &a = grid.at(i, j), &b = grid.at(i, j + 1), &c = grid.at(i + 1, j + 1),
                            &d = grid.at(i + 1, j);
      // The diagonal runs from the lower start to the upper end.
      probes.insert(probes.end(), {(b + d) / 2, (b + c + d) / 3, (a + b + d) / 3});
    }
    misses.across = std::max(misses.across, largest());
  }
  return misses;
}

}  // namespace

SphereGrid sphere_grid(const RangeFunction& range, const std::function<std::vector<double>(int)>& columns_of,
                       int fineness, double chord_mm) {
  int rows = kFewestRows;
  PointGrid grid = points_of(range, rows, columns_of(fineness));
  for (;;) {
    const Misses misses = misses_of(range, grid);
    // Half for each direction; what is left of a miss falls with the square of the interval.
    const auto more = [&](int n, double miss, double allowed) {
      return miss <= allowed ? n : static_cast<int>(std::ceil(n * std::max(kGrowth, std::sqrt(miss / allowed))));
    };
    const int next_rows = more(rows, misses.along, chord_mm / 2),
              next_fineness = more(fineness, misses.around, chord_mm / 2);
    if (next_rows == rows && next_fineness == fineness && misses.across <= chord_mm) break;
    const bool only_across = next_rows == rows && next_fineness == fineness;
    rows = only_across ? more(rows, misses.across, chord_mm) : next_rows;
    fineness = only_across ? more(fineness, misses.across, chord_mm) : next_fineness;
    grid = points_of(range, rows, columns_of(fineness));
  }
  SphereGrid result{fineness, {}};
  for (int i = grid.rows; i >= 0; --i) {
    auto& row = result.rows.emplace_back();
    for (int j = 0; j < grid.in_row; ++j) row.push_back(range.base().X_WB * grid.at(i, j));
  }
  return result;
}

}  // namespace celadon
