#include "daemon/export/wall_volume.h"

#include <Eigen/Geometry>
#include <vector>

namespace celadon {
namespace {

/// Eight points on [-1, 1]: exact for polynomials of degree 15; the walls' rational integrands are smooth on a knot
/// rectangle.
constexpr double nodes[] = {-0.9602898564975363, -0.7966664774136267, -0.5255324099163290, -0.1834346424956498,
                            0.1834346424956498,  0.5255324099163290,  0.7966664774136267,  0.9602898564975363};
constexpr double weights[] = {0.1012285362903763, 0.2223810344533745, 0.3137066458778873, 0.3626837833783620,
                              0.3626837833783620, 0.3137066458778873, 0.2223810344533745, 0.1012285362903763};

/// One abscissa with the basis functions that do not vanish there and their derivatives.
struct Abscissa {
  double weight = 0;
  int first = 0;  ///< index of the first of degree + 1 functions
  std::vector<double> value, derivative;
};

/// Values of the degree + 1 functions that do not vanish on a span (thesis 2.9), by the triangular scheme.
std::vector<double> basis(const std::vector<double>& knots, int degree, int span, double t) {
  std::vector<double> n(static_cast<std::size_t>(degree) + 1, 0.0);
  n[0] = 1;
  for (int p = 1; p <= degree; ++p) {
    double saved = 0;
    for (int k = 0; k < p; ++k) {
      const double right = knots[static_cast<std::size_t>(span + k + 1)];
      const double left = knots[static_cast<std::size_t>(span + 1 - p + k)];
      const double share = n[static_cast<std::size_t>(k)] / (right - left);
      n[static_cast<std::size_t>(k)] = saved + (right - t) * share;
      saved = (t - left) * share;
    }
    n[static_cast<std::size_t>(p)] = saved;
  }
  return n;
}

std::vector<Abscissa> abscissae(const std::vector<double>& knots, int degree) {
  std::vector<Abscissa> all;
  for (int span = degree; span + degree + 1 < static_cast<int>(knots.size()); ++span) {
    const double from = knots[static_cast<std::size_t>(span)];
    const double to = knots[static_cast<std::size_t>(span) + 1];
    if (!(from < to)) {
      continue;
    }
    for (int i = 0; i < 8; ++i) {
      Abscissa a;
      const double t = (from + to) / 2 + nodes[i] * (to - from) / 2;
      a.weight = weights[i] * (to - from) / 2;
      a.first = span - degree;
      a.value = basis(knots, degree, span, t);
      const std::vector<double> lower = basis(knots, degree - 1, span, t);
      a.derivative.assign(a.value.size(), 0.0);
      for (int k = 0; k < degree; ++k) {
        // N'_j = p N_(j, p-1) / (t_(j+p) - t_j) - p N_(j+1, p-1) / (t_(j+p+1) - t_(j+1))
        const auto j = static_cast<std::size_t>(span - degree + k + 1);
        const double slope =
            degree * lower[static_cast<std::size_t>(k)] / (knots[j + static_cast<std::size_t>(degree)] - knots[j]);
        a.derivative[static_cast<std::size_t>(k) + 1] += slope;
        a.derivative[static_cast<std::size_t>(k)] -= slope;
      }
      all.push_back(std::move(a));
    }
  }
  return all;
}

/// A third of the flux through the fan on the closed curve with these control points, to the left of its direction.
double cap_flux(const Eigen::Matrix4Xd& points, const std::vector<Abscissa>& along) {
  Eigen::Vector3d double_area = Eigen::Vector3d::Zero();
  for (const Abscissa& a : along) {
    const Eigen::Index n = static_cast<Eigen::Index>(a.value.size());
    const auto active = points.middleCols(a.first, n);
    const Eigen::Vector4d h = active * Eigen::Map<const Eigen::VectorXd>(a.value.data(), n);
    const Eigen::Vector4d h_t = active * Eigen::Map<const Eigen::VectorXd>(a.derivative.data(), n);
    double_area += a.weight * h.head<3>().cross(h_t.head<3>()) / (h.w() * h.w());
  }
  return cap_apex(points).dot(double_area) / 6;
}

}  // namespace

Eigen::Vector3d cap_apex(const Eigen::Matrix4Xd& rim) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  const Eigen::Index count = rim.cols() - 1;
  for (Eigen::Index j = 0; j < count; ++j) middle += rim.col(j).head<3>() / rim(3, j) / static_cast<double>(count);
  return middle;
}

double signed_volume_mm3(const NurbsSurface& wall) {
  const auto in_u = abscissae(wall.knots_u, wall.degree_u);
  const auto in_v = abscissae(wall.knots_v, wall.degree_v);
  const int count_v = wall.count_v();
  double volume = 0;
  Eigen::Matrix4Xd row(4, count_v);
  Eigen::Matrix4Xd row_u(4, count_v);
  for (const Abscissa& a : in_u) {
    row.setZero();
    row_u.setZero();
    for (std::size_t k = 0; k < a.value.size(); ++k) {
      const auto control = wall.control_points.middleCols((a.first + static_cast<int>(k)) * count_v, count_v);
      row += a.value[k] * control;
      row_u += a.derivative[k] * control;
    }
    for (const Abscissa& b : in_v) {
      Eigen::Vector4d h = Eigen::Vector4d::Zero();
      Eigen::Vector4d h_u = Eigen::Vector4d::Zero();
      Eigen::Vector4d h_v = Eigen::Vector4d::Zero();
      for (std::size_t k = 0; k < b.value.size(); ++k) {
        const Eigen::Index column = b.first + static_cast<Eigen::Index>(k);
        h += b.value[k] * row.col(column);
        h_u += b.value[k] * row_u.col(column);
        h_v += b.derivative[k] * row.col(column);
      }
      // S . (S_v x S_u) with S = P/w: the terms of the weights' derivatives cancel in the triple product.
      const double triple = h.head<3>().dot(h_v.head<3>().cross(h_u.head<3>())) / (h.w() * h.w() * h.w());
      volume += a.weight * b.weight * triple / 3;
    }
  }
  const Eigen::Matrix4Xd first = wall.control_points.leftCols(count_v);
  const Eigen::Matrix4Xd last = wall.control_points.rightCols(count_v);
  return volume + cap_flux(last, in_v) - cap_flux(first, in_v);
}

}  // namespace celadon
