#include "daemon/files/sphere_mesh.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "fitting/range_function.h"

namespace celadon {
namespace {

constexpr int kFewestRows = 8, kFewestColumns = 16;
constexpr double kGrowth = 1.15;
constexpr std::size_t kLargestGrid = 50'000'000;

/// Rows of points in the base frame; a pole's row holds one point as often as others hold theirs.
struct PointGrid {
  int rows = 0, columns = 0;  ///< intervals along and around
  std::vector<Eigen::Vector3d> p_B;
  const Eigen::Vector3d& at(int i, int j) const {
    return p_B[static_cast<std::size_t>(i) * static_cast<std::size_t>(columns) + static_cast<std::size_t>(j % columns)];
  }
};

PointGrid points_of(const RangeFunction& range, int rows, int columns) {
  if (static_cast<double>(rows) * columns > static_cast<double>(kLargestGrid))
    throw std::length_error("mesh_of: the chord tolerance asks for more than 100 million triangles; take a larger one");
  const BaseSurface& base = range.base();
  const BaseArcs& meridian = BaseSurface::meridian();
  PointGrid grid{rows, columns, {}};
  std::vector<double> theta(static_cast<std::size_t>(columns)), along(theta.size()), rho(theta.size());
  for (int j = 0; j < columns; ++j) theta[static_cast<std::size_t>(j)] = 2 * std::numbers::pi * j / columns;
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
      probes.insert(probes.end(), {(a + c) / 2, (a + c + d) / 3, (a + b + c) / 3});
    }
    misses.across = std::max(misses.across, largest());
  }
  return misses;
}

}  // namespace

TriangleMesh sphere_mesh(const RangeFunction& range, double chord_mm) {
  const BaseSurface& base = range.base();
  int rows = kFewestRows, columns = kFewestColumns;
  PointGrid grid = points_of(range, rows, columns);
  for (;;) {
    const Misses misses = misses_of(range, grid);
    // Half for each direction; what is left of a miss falls with the square of the interval.
    const auto more = [&](int n, double miss, double allowed) {
      return miss <= allowed ? n : static_cast<int>(std::ceil(n * std::max(kGrowth, std::sqrt(miss / allowed))));
    };
    const int next_rows = more(rows, misses.along, chord_mm / 2),
              next_columns = more(columns, misses.around, chord_mm / 2);
    if (next_rows == rows && next_columns == columns && misses.across <= chord_mm) break;
    const bool only_across = next_rows == rows && next_columns == columns;
    rows = only_across ? more(rows, misses.across, chord_mm) : next_rows;
    columns = only_across ? more(columns, misses.across, chord_mm) : next_columns;
    grid = points_of(range, rows, columns);
  }

  TriangleMesh mesh;
  const bool first_pole = base.band_start == 0, last_pole = base.band_end == BaseSurface::kMeridianEnd;
  const auto add = [&](const Eigen::Vector3d& p_B) {
    mesh.vertices_mm.push_back(base.X_WB * p_B);
    return static_cast<std::uint32_t>(mesh.vertices_mm.size() - 1);
  };
  std::vector<std::vector<std::uint32_t>> index(static_cast<std::size_t>(rows) + 1);
  for (int i = 0; i <= rows; ++i) {
    auto& row = index[static_cast<std::size_t>(i)];
    const bool pole = (i == 0 && first_pole) || (i == rows && last_pole);
    for (int j = 0; j < columns; ++j) row.push_back(pole && j > 0 ? row.front() : add(grid.at(i, j)));
  }
  const auto vertex = [&](int i, int j) {
    return index[static_cast<std::size_t>(i)][static_cast<std::size_t>(j % columns)];
  };
  const auto triangle = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (a != b && b != c && c != a) mesh.triangles.push_back({a, b, c});
  };
  // phi grows downward and theta to the left of it, seen from outside.
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j < columns; ++j) {
      triangle(vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1));
      triangle(vertex(i, j), vertex(i + 1, j + 1), vertex(i, j + 1));
    }
  for (const bool last : {false, true}) {
    if (last ? last_pole : first_pole) continue;
    const int i = last ? rows : 0;
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    for (int j = 0; j < columns; ++j) middle += grid.at(i, j) / columns;
    middle.head<2>().setZero();  // on the axis: every ray from it meets the rim once
    const std::uint32_t apex = add(middle);
    for (int j = 0; j < columns; ++j)
      last ? triangle(apex, vertex(i, j + 1), vertex(i, j)) : triangle(apex, vertex(i, j), vertex(i, j + 1));
  }
  return mesh;
}

}  // namespace celadon
