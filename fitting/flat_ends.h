#pragma once
// Flat faces that end a body: its top, and the table it stands on. Their samples, many ranges at one height, belong to
// no wall. Source: README.md, "Flat ends".

#include <Eigen/Core>
#include <optional>

#include "fitting/profile.h"

namespace celadon {

/// A plane z = height + slope . (x, y) across the axis.
struct FlatEnd {
  double height_mm = 0;  ///< on the axis
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();
  double half_width_mm = 0;  ///< samples within this distance along z are the face's
  double share = 0;          ///< of all samples
  double tilt_rad() const;
};

struct FlatEnds {
  std::optional<FlatEnd> lower, upper;
  bool any() const { return lower || upper; }
  /// The sample is on the face, or beyond it.
  bool hide(double x, double y, double z) const;
};

/// The flat faces at the ends of a body about the z axis: nearly across it, plane within the noise, wide in radius,
/// with next to nothing beyond. Steps between the ends are left alone, domes too.
/// @param points an even sample, 3 x N
FlatEnds find_flat_ends(const Eigen::Matrix3Xd& points);

/// A stream without what its flat ends hide. Profiles stay, also empty ones.
class WallStream : public ProfileStream {
 public:
  /// The stream must outlive this one, which rewinds and reads it.
  WallStream(ProfileStream& from, const FlatEnds& ends) : from_(from), ends_(ends) {}
  void rewind() override { from_.rewind(); }
  const Profile* next() override;

 private:
  ProfileStream& from_;
  FlatEnds ends_;
  Profile profile_;
};

}  // namespace celadon
