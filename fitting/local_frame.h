#pragma once
// The frame in which an arbitrarily placed cloud of points is a single-valued r(theta, z), or rho(phi, theta).
// Source: thesis 4.3, which it goes past: README.md, "Frames".

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "fitting/quadric_type.h"

namespace celadon {

/// The simplest shape that the points do not contradict.
enum class FrameShape : std::uint8_t {
  sphere,
  cylinder,
  cone,
  revolution,  ///< round about the axis
  elliptic     ///< similar ellipses about the axis
};
const char* to_string(FrameShape shape);

/// Where the search for the axis began.
enum class AxisStart : std::uint8_t { quadric, line_geometry, normals, none };
const char* to_string(AxisStart start);

struct LocalFrame {
  /// Local to the points' coordinates: columns i, j, k and the origin o of (4.5). k points to the points' +z; i is the
  /// short axis of an elliptic shape, else next to the points' x.
  Eigen::Isometry3d X_SL = Eigen::Isometry3d::Identity();
  FrameShape shape = FrameShape::revolution;
  QuadricType quadric = QuadricType::none;  ///< of the quadric through the points
  AxisStart start = AxisStart::none;
  /// Standard deviations if errors of points are independent: the direction of k (its larger one), and the origin
  /// across k (its larger one; any direction for a sphere). Infinite for the axis of a sphere: every one is as good.
  double axis_sd_rad = 0, origin_sd_mm = 0;
  double scale_mm = 0;  ///< robust standard deviation of the points about the shape
  double noise_mm = 0;  ///< of the points about planes through their neighbours
  double inliers = 1;   ///< share of the points within 4.685 scales, or, if it is more, round about the axis
  std::string reason;   ///< what decided, in one sentence
  std::vector<std::string> warnings;  ///< what a user should know, one sentence each
};

/// Why there is no frame: a value and a remedy in one sentence.
struct FrameError {
  std::string message;
};

/// The frame of points in any order, place and attitude; a tenth of them may be strays. From the quadric's axis, the
/// axis that all normals meet and the direction across all normals, surfaces of revolution are fitted; the best start
/// is refined as sphere, cylinder, cone, surface of revolution and with elliptic sections, and the simplest of these
/// whose cost is within a twentieth of the lowest is taken. The origin of a sphere is its centre; else it is the point
/// of the axis next to the points' mean (E.4), and the quadric's centre where that is known and lies within the points.
/// Same points in the same order: same bits.
/// @param points 3 x N, millimetres
/// @return an error for coordinates that are not finite, fewer than 50 points, and points that coincide or lie on one
/// line, curve or plane
tl::expected<LocalFrame, FrameError> local_frame(const Eigen::Matrix3Xd& points);

}  // namespace celadon
