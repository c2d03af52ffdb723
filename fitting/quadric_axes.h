#pragma once
// Axis and origin of a local frame from a quadric. Source: (4.2) - (4.4), (E.4) and where they go wrong: README.md,
// "Frames".

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>

#include "fitting/quadric.h"
#include "fitting/quadric_type.h"

namespace celadon {

/// What made an eigenvector the axis.
enum class AxisReason : std::uint8_t {
  odd_sign,         ///< its eigenvalue alone has the other sign and exceeds its noise
  no_curvature,     ///< its eigenvalue alone is within its noise of zero
  largest_gap,      ///< its eigenvalue has the largest logarithmic gap from the other two
  comparable_gaps,  ///< nothing singles one out: all three have to be tried
};
const char* to_string(AxisReason reason);

/// Right-handed orthonormal frame: columns of `axes` are i, j, k.
struct QuadricFrame {
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();
  Eigen::Vector3d origin_mm = Eigen::Vector3d::Zero();
};

struct QuadricAxes {
  QuadricType type = QuadricType::none;
  AxisReason reason = AxisReason::comparable_gaps;
  /// Ascending eigenvalues of Q_u and their standard deviations, both over the largest absolute eigenvalue.
  Eigen::Vector3d eigenvalues = Eigen::Vector3d::Zero(), noise = Eigen::Vector3d::Zero();
  /// One frame for every eigenvector as k, the rule's choice first.
  std::array<QuadricFrame, 3> frames;
};

/// Every eigenvector as axis, the best first: the odd sign if |lambda| exceeds three times its noise; the one without
/// curvature; else the largest gap in log |lambda|. Gaps within a factor of 1.5 of each other, or that the noise could
/// turn round, are comparable. The origin is the centre (4.3); along eigenvectors whose eigenvalue is within its noise
/// of zero, where there is no centre, it is next to `centroid_mm` (4.4), (E.4). i has the larger eigenvalue of the
/// other two (the shorter half axis), k points to +z of the points' frame, i to +x.
/// @param noise of the eigenvalues of Q_u in ascending order; 1e-9 of the largest one at least is taken
QuadricAxes quadric_axes(const Quadric& quadric, QuadricType type, const Eigen::Vector3d& noise,
                         const Eigen::Vector3d& centroid_mm);

/// The same for a fit, with its own noise.
QuadricAxes quadric_axes(const QuadricFit& fit);

/// i, j, k with k along `axis` upwards and i the part of `towards` across it, on the side of +x: the sign rule of every
/// frame here.
Eigen::Matrix3d frame_along(const Eigen::Vector3d& axis, const Eigen::Vector3d& towards);

}  // namespace celadon
