#include "fitting/thesis_cap.h"

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>
#include <vector>

#include "fitting/bspline_basis.h"
#include "fitting/knots.h"

namespace celadon {
namespace {

using Curve = std::array<Eigen::Vector3d, 6>;  // control points of a Bezier curve of degree 5

// Less of E than this share of the rim's distance squared leaves a direction of (alpha, beta) open.
constexpr double kOpen = 1e-9;

struct RimPoint {
  Eigen::Vector3d S, S_u, S_uu;
};

// (D.6): the connecting curve between opposite points of the rim.
Curve connect(const RimPoint& a, const RimPoint& b, double alpha, double beta) {
  return {a.S,
          a.S + alpha / 5 * a.S_u,
          a.S + 2 * alpha / 5 * a.S_u + beta / 20 * a.S_uu,
          b.S + 2 * alpha / 5 * b.S_u + beta / 20 * b.S_uu,
          b.S + alpha / 5 * b.S_u,
          b.S};
}

// deCasteljau at t = 1/2; the first half reversed, so that both run from the middle to the rim.
std::pair<Curve, Curve> split(Curve c) {
  Curve front, rear;
  for (int level = 0; level < 6; ++level) {
    const auto last = static_cast<std::size_t>(5 - level);
    front[last] = c[0];
    rear[last] = c[last];
    for (std::size_t k = 0; k < last; ++k) c[k] = (c[k] + c[k + 1]) / 2;
  }
  return {front, rear};
}

// b0 to p*, b1 onto the tangent plane, b2 where the integral of C''^2 is least.
void settle(Curve& b, const Eigen::Vector3d& point, const Eigen::Vector3d& normal) {
  b[0] = point;
  b[1] -= normal * normal.dot(b[1] - point);
  // C'' = 20 sum B_i,3 (b_i - 2 b_i+1 + b_i+2); Gram matrix of the cubic Bernstein polynomials times 140.
  static const Eigen::Matrix4d gram =
      (Eigen::Matrix4d() << 20, 10, 4, 1, 10, 12, 9, 4, 4, 9, 12, 10, 1, 4, 10, 20).finished();
  const Eigen::Vector4d of_b2(1, -2, 1, 0);
  Eigen::Matrix<double, 4, 3> rest;
  for (int i = 0; i < 4; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const auto at = [&](std::size_t m) { return m == 2 ? Eigen::Vector3d(Eigen::Vector3d::Zero()) : b[m]; };
    rest.row(i) = (at(k) - 2 * at(k + 1) + at(k + 2)).transpose();
  }
  b[2] = -(of_b2.transpose() * gram * rest).transpose() / (of_b2.transpose() * gram * of_b2).value();
}

}  // namespace

ThesisCap thesis_cap(const RangeFunction& range) {
  const BaseSurface& base = range.base();
  if (!base.spherical() || !base.arcs.closed() || !(base.band_start > 0))
    throw std::invalid_argument("thesis_cap: no hole around phi = 0 of a closed surface over a sphere");
  const NurbsSurface whole = symbolic_product(range);
  const double rim = whole.knots_u.front();
  const int around = whole.count_v() - 1, half = around / 2;  // m_S
  const std::vector<double> nodes = greville_abscissae(whole.knots_v, whole.degree_v);
  bool opposite = around % 2 == 0;
  for (int j = 0; opposite && j <= half; ++j)
    opposite = std::abs(nodes[static_cast<std::size_t>(j + half)] - nodes[static_cast<std::size_t>(j)] -
                        base.arcs.count() / 2.0) < 1e-9;
  if (!opposite) throw std::invalid_argument("thesis_cap: the knots around do not repeat after half a turn (3.15)");

  std::vector<RimPoint> at;
  for (int j = 0; j < around; ++j) {
    const SurfaceDerivatives d = whole.derivatives(rim, nodes[static_cast<std::size_t>(j)]);
    at.push_back({d.S, d.S_u, d.S_uu});
  }
  const auto pair_of = [&](int j) {
    return std::pair<const RimPoint&, const RimPoint&>(at[static_cast<std::size_t>(j)],
                                                       at[static_cast<std::size_t>(j + half)]);
  };

  // (D.8) - (D.11), E about the natural scale.
  std::array<Eigen::Matrix3Xd, 3> A;
  for (auto& a : A) a.resize(3, half);
  for (int j = 0; j < half; ++j) {
    const auto [a, b] = pair_of(j);
    A[0].col(j) = (1 + 5 + 10) / 32.0 * (a.S + b.S);
    A[1].col(j) = (5 + 2 * 10) / 32.0 / 5 * (a.S_u + b.S_u);
    A[2].col(j) = 10 / 32.0 / 20 * (a.S_uu + b.S_uu);
  }
  for (auto& a : A) a.colwise() -= Eigen::Vector3d(a.rowwise().mean());
  const double alpha0 = -2 * rim, beta0 = alpha0 * alpha0;
  const Eigen::Map<const Eigen::VectorXd> a0(A[0].data(), A[0].size()), a1(A[1].data(), A[1].size()),
      a2(A[2].data(), A[2].size());
  Eigen::MatrixX2d J(a0.size(), 2);
  J << alpha0 * a1, beta0 * a2;
  const Eigen::VectorXd left = a0 + alpha0 * a1 + beta0 * a2;
  Eigen::Matrix2d normal_matrix = J.transpose() * J;
  normal_matrix += kOpen * at.front().S.squaredNorm() * Eigen::Matrix2d::Identity();
  const Eigen::Vector2d step = normal_matrix.ldlt().solve(-(J.transpose() * left));

  ThesisCap cap;
  cap.alpha = alpha0 * (1 + step[0]);
  cap.beta = beta0 * (1 + step[1]);
  std::vector<Curve> curves;
  Eigen::Matrix3Xd middle(3, half), tangent(3, half);
  for (int j = 0; j < half; ++j) {
    const auto [a, b] = pair_of(j);
    curves.push_back(connect(a, b, cap.alpha, cap.beta));
    const Curve& c = curves.back();
    middle.col(j) = (c[0] + 5 * c[1] + 10 * c[2] + 10 * c[3] + 5 * c[4] + c[5]) / 32;
    tangent.col(j) = 5 * ((c[5] - c[0]) + 3 * (c[4] - c[1]) + 2 * (c[3] - c[2])) / 16;
  }
  cap.point = middle.rowwise().mean();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int j = 0; j < half; ++j) {
    const Eigen::Vector3d from = tangent.col(j),
                          to = j + 1 < half ? Eigen::Vector3d(tangent.col(j + 1)) : Eigen::Vector3d(-tangent.col(0));
    const Eigen::Vector3d across = from.cross(to);
    if (across.norm() > 0) sum += std::atan2(across.norm(), from.dot(to)) * across.normalized();
  }
  cap.normal = sum.normalized();
  if (cap.normal.dot(base.X_WB.linear().col(2)) < 0) cap.normal = -cap.normal;

  std::vector<Curve> spokes(static_cast<std::size_t>(around) + 1);
  for (int j = 0; j < half; ++j) {
    auto [front, rear] = split(curves[static_cast<std::size_t>(j)]);
    settle(front, cap.point, cap.normal);
    settle(rear, cap.point, cap.normal);
    spokes[static_cast<std::size_t>(j)] = front;
    spokes[static_cast<std::size_t>(j + half)] = rear;
  }
  spokes.back() = spokes.front();

  // (3.24), corrected.
  const int q = whole.degree_v;
  Eigen::MatrixXd N = Eigen::MatrixXd::Zero(around + 1, around + 1);
  const std::size_t columns = static_cast<std::size_t>(around) + 1;
  for (int k = 0; k <= around; ++k) {
    const double v = nodes[static_cast<std::size_t>(k)];
    const int span = find_span(whole.knots_v, q, v);
    const BasisValues values = basis_values(whole.knots_v, q, span, v);
    for (int i = 0; i <= q; ++i) N(k, span - q + i) = values[static_cast<std::size_t>(i)];
  }
  Eigen::VectorXd rim_weights(around + 1);
  for (int j = 0; j <= around; ++j) rim_weights[j] = whole.control_point(0, j)[3];
  const Eigen::VectorXd weight = N * rim_weights;
  const Eigen::PartialPivLU<Eigen::MatrixXd> solver(N);
  cap.surface.degree_u = 5;
  cap.surface.degree_v = q;
  cap.surface.knots_u = {0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1};
  cap.surface.knots_v = whole.knots_v;
  cap.surface.control_points.resize(4, static_cast<Eigen::Index>(6 * columns));
  for (int i = 0; i < 6; ++i) {
    Eigen::MatrixX4d points(around + 1, 4);
    for (int k = 0; k <= around; ++k) {
      const Eigen::Vector3d& c = spokes[static_cast<std::size_t>(k)][static_cast<std::size_t>(i)];
      points.row(k) << weight[k] * c.transpose(), weight[k];
    }
    cap.surface.control_points.middleCols(i * (around + 1), around + 1) = solver.solve(points).transpose();
  }
  return cap;
}

}  // namespace celadon
