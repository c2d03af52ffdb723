#include "daemon/files/wall_grid.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "daemon/files/chord_bound.h"

namespace celadon {
namespace {

constexpr std::size_t largest_grid = 50'000'000;

/// Density of grid lines that an interval between knots asks for at scale 1.
struct Stretch {
  double from, to, density;
  bool kink_after;
};

/// Grid lines at equal shares of the integral of the density, and at every kink.
std::vector<double> lines(const std::vector<Stretch>& stretches, double scale) {
  std::vector<double> lines = {stretches.front().from};
  for (std::size_t first = 0; first < stretches.size();) {
    std::size_t last = first;
    double total = 0;
    for (;; ++last) {
      total += (stretches[last].to - stretches[last].from) * stretches[last].density;
      if (last + 1 == stretches.size() || stretches[last].kink_after) {
        break;
      }
    }
    const double pieces = std::max(1.0, std::ceil(total * scale));
    if (pieces > static_cast<double>(largest_grid)) {
      throw std::length_error(
          "mesh_of: the chord tolerance asks for more than 100 million triangles; take a larger one");
    }
    double before = 0;
    std::size_t at = first;
    for (std::size_t piece = 1; piece < static_cast<std::size_t>(pieces); ++piece) {
      const double wanted = total * static_cast<double>(piece) / pieces;
      const auto weight = [&] { return (stretches[at].to - stretches[at].from) * stretches[at].density; };
      while (at < last && before + weight() < wanted) {
        before += weight();
        ++at;
      }
      lines.push_back(std::min(stretches[at].to, stretches[at].from + (wanted - before) / stretches[at].density));
    }
    lines.push_back(stretches[last].to);
    first = last + 1;
  }
  return lines;
}

/// For each interval between lines, the first and the last of the table's intervals it touches.
std::vector<std::pair<std::size_t, std::size_t>> touched(const std::vector<double>& lines,
                                                         const std::vector<double>& borders) {
  std::vector<std::pair<std::size_t, std::size_t>> spans;
  std::size_t first = 0;
  for (std::size_t i = 0; i + 1 < lines.size(); ++i) {
    while (first + 2 < borders.size() && borders[first + 1] <= lines[i]) {
      ++first;
    }
    std::size_t last = first;
    while (last + 2 < borders.size() && borders[last + 1] < lines[i + 1]) {
      ++last;
    }
    spans.emplace_back(first, last);
  }
  return spans;
}

// The ranges at all points of a grid's lines.
void fill(const RangeFunction& range, WallGrid& grid) {
  const std::size_t count = grid.around() * grid.along.size();
  std::vector<double> theta(count);
  std::vector<double> along(count);
  for (std::size_t k = 0; k < count; ++k) {
    theta[k] = grid.theta_rad[k % grid.around()];
    along[k] = grid.along[k / grid.around()];
  }
  grid.r_mm.resize(count);
  range.evaluate(theta.data(), along.data(), count, grid.r_mm.data());
  if (!std::all_of(grid.r_mm.begin(), grid.r_mm.end(), [](double r) { return r > 0; })) {
    throw std::invalid_argument("mesh_of: the range is not positive everywhere");
  }
}

class Mesher {
 public:
  Mesher(const RangeFunction& range, double chord_mm)
      : range_(range), chord_mm_(chord_mm), table_(range), heights_(height_bounds(range.base())) {
    const std::size_t rows = table_.z_mm().size() - 1;
    const std::size_t columns = table_.theta_rad().size() - 1;
    // Errors of both directions add up: an equal share for each is the cheapest (README.md, "Meshes").
    const double unit = std::sqrt(8 * chord_mm);
    for (std::size_t j = 0; j < columns; ++j) {
      RangeBounds bounds;
      for (std::size_t i = 0; i < rows; ++i) {
        bounds.widen(table_.at(i, j));
      }
      const double bend = bounds.bend + 2 * bounds.slope_max * bounds.slope_max * bounds.r_max + heights_.theta_theta;
      const double density = std::max(std::sqrt(bend) / unit, 16 / (2 * std::numbers::pi));
      around_.push_back(
          {table_.theta_rad()[j], table_.theta_rad()[j + 1], density, j + 1 < columns && table_.theta_kink()[j]});
    }
    const double height = table_.z_mm().back() - table_.z_mm().front();
    for (std::size_t i = 0; i < rows; ++i) {
      RangeBounds bounds;
      for (std::size_t j = 0; j < columns; ++j) {
        bounds.widen(table_.at(i, j));
      }
      // The second term holds the twist of a cell down where the wall is straight but slanted.
      const double density = std::sqrt(bounds.r_zz) / unit + 4 * bounds.r_z / bounds.r_max;
      upward_.push_back({table_.z_mm()[i], table_.z_mm()[i + 1], std::max(density, 1e-3 / height),
                         i + 1 < rows && table_.z_kink()[i + 1]});
    }
  }

  /// The coarsest grid of a geometric ladder whose every cell is proved.
  WallGrid grid() const {
    for (double scale = 0.7;; scale *= 1.06) {
      WallGrid grid;
      grid.closed = range_.base().arcs.closed();
      grid.theta_rad = lines(around_, scale);
      grid.along = lines(upward_, scale);
      if (static_cast<double>(grid.around()) * static_cast<double>(grid.along.size()) >
          static_cast<double>(largest_grid)) {
        throw std::length_error(
            "mesh_of: the chord tolerance asks for more than 100 million triangles; take a larger one");
      }
      fill(range_, grid);
      if (proved(grid)) {
        return grid;
      }
    }
  }

 private:
  bool proved(const WallGrid& grid) const {
    const auto rows = touched(grid.along, table_.z_mm());
    const auto columns = touched(grid.theta_rad, table_.theta_rad());
    for (std::size_t i = 0; i < rows.size(); ++i) {
      for (std::size_t j = 0; j < columns.size(); ++j) {
        RangeBounds bounds;
        for (std::size_t a = rows[i].first; a <= rows[i].second; ++a) {
          for (std::size_t b = columns[j].first; b <= columns[j].second; ++b) {
            bounds.widen(table_.at(a, b));
          }
        }
        const CellCorners corners{grid.r(i, j), grid.r(i, j + 1), grid.r(i + 1, j), grid.r(i + 1, j + 1)};
        const double h_theta = grid.theta_rad[j + 1] - grid.theta_rad[j];
        const double h_along = grid.along[i + 1] - grid.along[i];
        if (chord_bound_mm(bounds, corners, h_theta, h_along) + height_bound_mm(heights_, corners, h_theta, h_along) >
            chord_mm_) {
          return false;
        }
      }
    }
    return true;
  }

  const RangeFunction& range_;
  double chord_mm_;
  BoundTable table_;
  HeightBounds heights_;
  std::vector<Stretch> around_, upward_;
};

}  // namespace

WallGrid wall_grid(const RangeFunction& range, double chord_mm) {
  return Mesher(range, chord_mm).grid();
}

WallGrid wall_grid(const RangeFunction& range, std::vector<double> theta_rad, std::vector<double> along) {
  WallGrid grid{std::move(theta_rad), std::move(along), {}, range.base().arcs.closed()};
  fill(range, grid);
  return grid;
}

}  // namespace celadon
