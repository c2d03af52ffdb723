#pragma once
// Points in memory as a stream for a fit.

#include <Eigen/Core>
#include <vector>

#include "fitting/profile.h"

namespace celadon {

/// Points in any order, in pieces of one size; r, theta in [0, 2 pi), z about the z axis of their frame. Keeps what it
/// makes of them: 24 bytes a point.
class PointStream : public ProfileStream {
 public:
  /// @param points 3 x N, millimetres
  explicit PointStream(const Eigen::Matrix3Xd& points);
  void rewind() override { at_ = 0; }
  const Profile* next() override { return at_ < profiles_.size() ? &profiles_[at_++] : nullptr; }

 private:
  std::vector<Profile> profiles_;
  std::size_t at_ = 0;
};

}  // namespace celadon
