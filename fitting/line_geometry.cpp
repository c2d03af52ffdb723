#include "fitting/line_geometry.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "fitting/robust_least_squares.h"

namespace celadon {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

struct Complex {
  Eigen::Vector3d c, c_bar;
  Eigen::Vector3d misfits;
};

// lines: (n, p x n) in columns, for (c_bar, c).
Complex nearest_complex(const Eigen::Matrix<double, 6, Eigen::Dynamic>& lines, const Eigen::VectorXd& weights) {
  const Matrix6d M = lines * weights.asDiagonal() * lines.transpose() / weights.sum();
  const Eigen::Matrix3d translations = M.topLeftCorner<3, 3>(), mixed = M.topRightCorner<3, 3>();
  // Directions across all normals: a translation that costs nothing says nothing about the axis.
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(translations);
  Eigen::Matrix3d inverse = Eigen::Matrix3d::Zero();
  for (int j = 0; j < 3; ++j) {
    if (solver.eigenvalues()[j] > 1e-6 * solver.eigenvalues()[2])
      inverse += solver.eigenvectors().col(j) * solver.eigenvectors().col(j).transpose() / solver.eigenvalues()[j];
  }
  const Eigen::Matrix3d rest = M.bottomRightCorner<3, 3>() - mixed.transpose() * inverse * mixed;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> rotations(rest);
  const Eigen::Vector3d c = rotations.eigenvectors().col(0);
  return {c, -inverse * mixed * c, rotations.eigenvalues().cwiseMax(0).cwiseSqrt()};
}

}  // namespace

std::optional<RotationAxis> rotation_axis(const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals,
                                          std::span<const double> weights) {
  const Eigen::Index N = points.cols();
  Eigen::VectorXd given = Eigen::VectorXd::Ones(N);
  if (!weights.empty()) given = Eigen::Map<const Eigen::VectorXd>(weights.data(), N);
  if ((given.array() > 0).count() < 6) return std::nullopt;
  const Eigen::Vector3d mean = points * given / given.sum();
  const Eigen::Matrix3Xd centred = points.colwise() - mean;
  const double size = std::sqrt(centred.colwise().squaredNorm().dot(given) / given.sum());
  if (!(size > 0) || !std::isfinite(size)) return std::nullopt;

  Eigen::Matrix<double, 6, Eigen::Dynamic> lines(6, N);
  for (Eigen::Index k = 0; k < N; ++k)
    lines.col(k) << normals.col(k), (centred.col(k) / size).cross(Eigen::Vector3d(normals.col(k)));
  Eigen::VectorXd applied = given;
  Complex complex = nearest_complex(lines, applied);
  Eigen::VectorXd angles(N);
  double scale = 0;
  for (int round = 0; round < 12; ++round) {
    Vector6d motion;
    motion << complex.c_bar, complex.c;
    const Eigen::VectorXd misses = lines.transpose() * motion;
    for (Eigen::Index k = 0; k < N; ++k) {
      // Seen from the point: the part of the normal along its velocity; near the axis there is no angle to speak of.
      const double speed = (complex.c_bar + complex.c.cross(Eigen::Vector3d(centred.col(k) / size))).norm();
      angles[k] = misses[k] / std::max(speed, 0.1);
    }
    scale = median_scale(angles, given);
    for (Eigen::Index k = 0; k < N; ++k) applied[k] = given[k] * tukey_weight(angles[k], std::max(scale, 1e-12));
    if ((applied.array() > 0).count() < 6) break;
    complex = nearest_complex(lines, applied);
  }

  RotationAxis axis;
  const double pitch = complex.c.dot(complex.c_bar);
  axis.direction = complex.c;
  axis.point_mm = mean + size * complex.c.cross(complex.c_bar);
  axis.pitch_mm = pitch * size;
  axis.miss_rad = scale;
  axis.misfits_rad = complex.misfits;
  return axis;
}

}  // namespace celadon
