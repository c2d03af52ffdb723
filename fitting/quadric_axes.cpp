#include "fitting/quadric_axes.h"

#include <Eigen/Dense>
#include <cmath>
#include <utility>

namespace celadon {
namespace {

constexpr double kSure = 3;          // standard deviations
constexpr double kComparable = 1.5;  // factor between two gaps that are told apart

// Towards +z; with no part along z towards +y, then +x.
Eigen::Vector3d upward(const Eigen::Vector3d& k) {
  for (const int axis : {2, 1, 0}) {
    if (std::abs(k[axis]) > 1e-12) return k[axis] > 0 ? k : Eigen::Vector3d(-k);
  }
  return k;
}

struct Choice {
  int axis = 0;
  AxisReason reason = AxisReason::comparable_gaps;
};

// lambda ascending, largest absolute value 1; noise in the same unit.
Choice choose(const Eigen::Vector3d& lambda, const Eigen::Vector3d& noise) {
  std::array<int, 3> sign{};
  int sum = 0, zeros = 0, zero = 0;
  for (int j = 0; j < 3; ++j) {
    sign[static_cast<std::size_t>(j)] = lambda[j] > kSure * noise[j] ? 1 : lambda[j] < -kSure * noise[j] ? -1 : 0;
    sum += sign[static_cast<std::size_t>(j)];
    if (sign[static_cast<std::size_t>(j)] == 0) ++zeros, zero = j;
  }
  if (zeros == 1) return {zero, AxisReason::no_curvature};
  if (zeros == 0 && std::abs(sum) == 1) return {sum > 0 ? 0 : 2, AxisReason::odd_sign};
  if (zeros > 1) return {0, AxisReason::comparable_gaps};
  // All of one sign: gaps between neighbours of log |lambda|, with what the noise makes of them.
  const auto gap = [&](int a, int b) { return std::abs(std::log(std::abs(lambda[a] / lambda[b]))); };
  const auto error = [&](int a, int b) { return kSure * std::hypot(noise[a] / lambda[a], noise[b] / lambda[b]); };
  const double low = gap(0, 1), high = gap(1, 2);
  const int odd = low > high ? 0 : 2;
  const double large = std::max(low, high), small = std::min(low, high);
  const double unsure = odd == 0 ? error(0, 1) : error(1, 2);
  const bool clear = large > kComparable * small && large - small > unsure;
  return {odd, clear ? AxisReason::largest_gap : AxisReason::comparable_gaps};
}

}  // namespace

const char* to_string(AxisReason reason) {
  switch (reason) {
    case AxisReason::odd_sign:
      return "its eigenvalue alone has the other sign";
    case AxisReason::no_curvature:
      return "the quadric does not curve along it";
    case AxisReason::largest_gap:
      return "its eigenvalue differs most from the other two";
    case AxisReason::comparable_gaps:
      break;
  }
  return "no eigenvalue stands out";
}

Eigen::Matrix3d frame_along(const Eigen::Vector3d& axis, const Eigen::Vector3d& towards) {
  Eigen::Matrix3d frame;
  const Eigen::Vector3d k = upward(axis.normalized());
  Eigen::Vector3d i = towards - towards.dot(k) * k;
  if (i.norm() < 1e-6 * towards.norm() || i.norm() == 0) i = k.unitOrthogonal();
  i.normalize();
  for (const int side : {0, 1, 2}) {
    if (std::abs(i[side]) <= 1e-12) continue;
    if (i[side] < 0) i = -i;
    break;
  }
  frame << i, k.cross(i), k;
  return frame;
}

QuadricAxes quadric_axes(const Quadric& quadric, QuadricType type, const Eigen::Vector3d& noise,
                         const Eigen::Vector3d& centroid_mm) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(quadric.Q_u);
  QuadricAxes result;
  result.type = type;
  Eigen::Vector3d lambda = solver.eigenvalues(), spread = noise;
  const double largest = lambda.cwiseAbs().maxCoeff();
  if (largest > 0) {
    lambda /= largest;
    spread /= largest;
  }
  spread = spread.cwiseMax(1e-9);
  result.eigenvalues = lambda;
  result.noise = spread;

  // The centre, from the centroid along the axes that have one.
  const Eigen::Vector3d slope = solver.eigenvectors().transpose() * quadric.gradient(centroid_mm);
  Eigen::Vector3d origin = centroid_mm;
  for (int j = 0; j < 3; ++j) {
    if (std::abs(lambda[j]) > kSure * spread[j])
      origin -= solver.eigenvectors().col(j) * slope[j] / (2 * solver.eigenvalues()[j]);
  }

  const Choice choice = choose(lambda, spread);
  result.reason = choice.reason;
  std::array<int, 3> order = {choice.axis, (choice.axis + 1) % 3, (choice.axis + 2) % 3};
  for (std::size_t n = 0; n < 3; ++n) {
    int first = (order[n] + 1) % 3, second = (order[n] + 2) % 3;
    if (std::abs(lambda[second]) > std::abs(lambda[first])) std::swap(first, second);
    result.frames[n] = {frame_along(solver.eigenvectors().col(order[n]), solver.eigenvectors().col(first)), origin};
  }
  return result;
}

QuadricAxes quadric_axes(const QuadricFit& fit) {
  // From the normalised coordinates, which lose no digits far from the origin.
  QuadricAxes result = quadric_axes(fit.normalised, classify(fit), eigenvalue_noise(fit), Eigen::Vector3d::Zero());
  for (QuadricFrame& frame : result.frames) frame.origin_mm = fit.centre_mm + fit.size_mm * frame.origin_mm;
  return result;
}

}  // namespace celadon
