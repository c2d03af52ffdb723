#pragma once
// The part of the turn that points cover.

#include <Eigen/Core>

#include "fitting/base_arcs.h"

namespace celadon {

/// Angles about the z axis outside the widest gap in which next to no points lie; the full circle if that gap is below
/// 10 degrees. @param points 3 x N, an even sample
BaseArcs covered_angles(const Eigen::Matrix3Xd& points);

}  // namespace celadon
