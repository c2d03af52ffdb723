#pragma once
// An even sample of a stream as points.

#include <Eigen/Core>
#include <cstddef>

#include "fitting/profile.h"

namespace celadon {

/// At most so many of the stream's samples, at least half as many if there are; 3 x N, mm, in the stream's frame and
/// order. Samples without numbers are left out. Rewinds the stream and reads it once.
Eigen::Matrix3Xd even_points(ProfileStream& samples, std::size_t most);

}  // namespace celadon
