#include "tests/daemon/closed_wall.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace celadon::testing {
namespace {

double binomial(int n, int k) {
  double result = 1;
  for (int i = 1; i <= k; ++i) {
    result *= static_cast<double>(n - k + i) / i;
  }
  return result;
}

double bernstein_value(const std::vector<double>& c, double t) {
  const int n = static_cast<int>(c.size()) - 1;
  double sum = 0;
  for (int k = 0; k <= n; ++k) {
    sum += c[static_cast<std::size_t>(k)] * binomial(n, k) * std::pow(t, k) * std::pow(1 - t, n - k);
  }
  return sum;
}

/// Product of two Bernstein polynomials.
std::vector<double> product(const std::vector<double>& a, const std::vector<double>& b) {
  const int m = static_cast<int>(a.size()) - 1;
  const int n = static_cast<int>(b.size()) - 1;
  std::vector<double> c(static_cast<std::size_t>(m + n + 1), 0.0);
  for (int i = 0; i <= m; ++i) {
    for (int j = 0; j <= n; ++j) {
      c[static_cast<std::size_t>(i + j)] += binomial(m, i) * binomial(n, j) / binomial(m + n, i + j) *
                                            a[static_cast<std::size_t>(i)] * b[static_cast<std::size_t>(j)];
    }
  }
  return c;
}

/// Cox - de Boor by its recursive definition.
double basis(const std::vector<double>& knots, std::size_t i, int degree, double u) {
  if (degree == 0) {
    const bool last = knots[i + 1] == knots.back() && u == knots.back() && knots[i] < knots[i + 1];
    return (knots[i] <= u && u < knots[i + 1]) || last ? 1 : 0;
  }
  const auto p = static_cast<std::size_t>(degree);
  double sum = 0;
  if (knots[i + p] > knots[i]) {
    sum += (u - knots[i]) / (knots[i + p] - knots[i]) * basis(knots, i, degree - 1, u);
  }
  if (knots[i + p + 1] > knots[i + 1]) {
    sum += (knots[i + p + 1] - u) / (knots[i + p + 1] - knots[i + 1]) * basis(knots, i + 1, degree - 1, u);
  }
  return sum;
}

std::vector<double> uniform_clamped(int degree, int count) {
  std::vector<double> knots(static_cast<std::size_t>(degree), 0.0);
  const int intervals = count - degree;
  for (int i = 0; i <= intervals; ++i) {
    knots.push_back(static_cast<double>(i) / intervals);
  }
  knots.insert(knots.end(), static_cast<std::size_t>(degree), 1.0);
  return knots;
}

const double half_sqrt_2 = std::sqrt(0.5);

/// w x, w y, w of the quarter circle number `arc`, as Bernstein coefficients.
std::array<std::vector<double>, 3> quarter(int arc) {
  static constexpr int cosine[] = {1, 0, -1, 0};
  static constexpr int sine[] = {0, 1, 0, -1};
  const int next = (arc + 1) % 4;
  const double x0 = cosine[arc];
  const double y0 = sine[arc];
  const double x2 = cosine[next];
  const double y2 = sine[next];
  return {std::vector<double>{x0, half_sqrt_2 * (x0 + x2), x2}, std::vector<double>{y0, half_sqrt_2 * (y0 + y2), y2},
          std::vector<double>{1, half_sqrt_2, 1}};
}

}  // namespace

double ClosedWall::theta_of_v(double v) {
  const int arc = std::min(3, static_cast<int>(v));
  const auto [x, y, w] = quarter(0);
  const double t = v - arc;
  return arc * std::numbers::pi / 2 + std::atan2(bernstein_value(y, t), bernstein_value(x, t));
}

double ClosedWall::range_mm(double u, double v) const {
  const auto arc = static_cast<std::size_t>(std::min(3, static_cast<int>(v)));
  double sum = 0;
  for (std::size_t i = 0; i < bernstein.size(); ++i) {
    sum += basis(knots_u, i, degree_u, u) * bernstein_value(bernstein[i][arc], v - static_cast<double>(arc));
  }
  return sum;
}

Eigen::Vector3d ClosedWall::point(double u, double v) const {
  const double r = range_mm(u, v);
  const double theta = theta_of_v(v);
  return {r * std::cos(theta), r * std::sin(theta), z_start_mm + u * (z_end_mm - z_start_mm)};
}

double ClosedWall::volume_mm3() const {
  // Eight-point Gauss-Legendre on [-1, 1].
  static constexpr double node[] = {0.1834346424956498, 0.5255324099163290, 0.7966664774136267, 0.9602898564975363};
  static constexpr double weight[] = {0.3626837833783620, 0.3137066458778873, 0.2223810344533745, 0.1012285362903763};
  std::vector<double> breaks(knots_u);
  breaks.erase(std::unique(breaks.begin(), breaks.end()), breaks.end());
  const auto quadrature = [](double from, double to, auto&& f) {
    double sum = 0;
    for (int i = 0; i < 4; ++i) {
      const double half = (to - from) / 2;
      sum += weight[i] * half * (f(from + half - half * node[i]) + f(from + half + half * node[i]));
    }
    return sum;
  };
  double total = 0;
  for (std::size_t i = 0; i + 1 < breaks.size(); ++i) {
    total += quadrature(breaks[i], breaks[i + 1], [&](double u) {
      double ring = 0;
      // Pieces of a quarter of an arc: dtheta/dv is smooth there, eight points give full precision.
      for (int piece = 0; piece < 16; ++piece) {
        ring += quadrature(piece / 4.0, (piece + 1) / 4.0, [&](double v) {
          const double t = v - std::floor(v);
          const double s = 1 - 2 * t * (1 - t) * (1 - half_sqrt_2);
          const double theta_v = std::numbers::sqrt2 * (1 - (2 - std::numbers::sqrt2) * t * (1 - t)) / (s * s);
          const double r = range_mm(u, v);
          // x = (1 - t)^2 + sqrt2 t (1 - t), y = sqrt2 t (1 - t) + t^2 over s: x y' - y x' = theta_v of the unit
          // circle.
          return r * r / 2 * theta_v;
        });
      }
      return ring;
    });
  }
  return total * (z_end_mm - z_start_mm);
}

NurbsSurface ClosedWall::surface() const {
  NurbsSurface surface;
  surface.degree_u = degree_u;
  surface.degree_v = degree_v + 2;
  surface.knots_u = knots_u;
  const auto order = static_cast<std::size_t>(surface.degree_v);
  surface.knots_v.assign(1, 0.0);
  for (int joint = 0; joint <= 4; ++joint) {
    surface.knots_v.insert(surface.knots_v.end(), order, joint);
  }
  surface.knots_v.push_back(4.0);
  const auto rows = static_cast<Eigen::Index>(bernstein.size());
  const auto columns = static_cast<Eigen::Index>(4 * order + 1);
  surface.control_points.resize(4, rows * columns);
  const std::vector<double> one(static_cast<std::size_t>(degree_v) + 1, 1.0);
  for (Eigen::Index i = 0; i < rows; ++i) {
    // z is linear in u: its control values are the Greville abscissae.
    double greville = 0;
    for (int k = 1; k <= degree_u; ++k) {
      greville += knots_u[static_cast<std::size_t>(i + k)] / degree_u;
    }
    const double z = z_start_mm + greville * (z_end_mm - z_start_mm);
    for (int arc = 0; arc < 4; ++arc) {
      const auto [wx, wy, w] = quarter(arc);
      const auto& f = bernstein[static_cast<std::size_t>(i)][static_cast<std::size_t>(arc)];
      const auto x = product(f, wx);
      const auto y = product(f, wy);
      const auto weight = product(one, w);
      for (std::size_t k = 0; k <= order; ++k) {
        const Eigen::Index column = static_cast<Eigen::Index>(static_cast<std::size_t>(arc) * order + k);
        surface.control_points.col(i * columns + column) = Eigen::Vector4d(x[k], y[k], z * weight[k], weight[k]);
      }
    }
  }
  return surface;
}

ClosedWall cylinder(double radius_mm, double height_mm) {
  return revolution(1, {radius_mm, radius_mm}, height_mm);
}

ClosedWall revolution(int degree_u, const std::vector<double>& control_ranges_mm, double height_mm) {
  ClosedWall wall;
  wall.degree_u = degree_u;
  wall.knots_u = uniform_clamped(degree_u, static_cast<int>(control_ranges_mm.size()));
  for (const double r : control_ranges_mm) {
    wall.bernstein.push_back({std::vector<double>{r}, {r}, {r}, {r}});
  }
  wall.z_end_mm = height_mm;
  return wall;
}

ClosedWall lobed(int degree_u, int rows, int degree_v, double height_mm) {
  ClosedWall wall;
  wall.degree_u = degree_u;
  wall.degree_v = degree_v;
  wall.knots_u = uniform_clamped(degree_u, rows);
  wall.z_end_mm = height_mm;
  for (int i = 0; i < rows; ++i) {
    std::array<std::vector<double>, 4> arcs;
    const auto coefficient = [&](int arc, int k) {
      const int place = (arc * degree_v + k) % (4 * degree_v);
      return 40 + 6 * std::sin(0.7 * i) + 3 * std::cos(1.3 * place + 0.4 * i);
    };
    for (int arc = 0; arc < 4; ++arc) {
      for (int k = 0; k <= degree_v; ++k) {
        arcs[static_cast<std::size_t>(arc)].push_back(coefficient(arc, k));
      }
    }
    wall.bernstein.push_back(std::move(arcs));
  }
  return wall;
}

}  // namespace celadon::testing
