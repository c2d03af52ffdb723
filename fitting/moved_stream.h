#pragma once
// Range data about another axis.

#include <Eigen/Geometry>
#include <memory>
#include <vector>

#include "fitting/profile.h"

namespace celadon {

/// The samples of a profile in the frame L, covariances carried over: theta in [0, 2 pi). @pre `to` is another one
void move_profile(const Profile& from, const Eigen::Isometry3d& X_LS, Profile& to);

/// A stream of (r, theta, z) in the scanner's frame S as the local frame L sees it, covariances carried over: theta in
/// [0, 2 pi). Samples on the local axis get r = 0, which a fit rejects.
class MovedStream : public ProfileStream {
 public:
  /// The stream must outlive this one, which rewinds and reads it.
  MovedStream(ProfileStream& from, const Eigen::Isometry3d& X_LS) : from_(from), X_LS_(X_LS) {}
  void rewind() override { from_.rewind(); }
  const Profile* next() override;

 private:
  ProfileStream& from_;
  Eigen::Isometry3d X_LS_;
  Profile profile_;
};

/// All parts of a sequence in another frame, as parts.
class MovedParts {
 public:
  /// The parts must outlive this one.
  MovedParts(ProfileParts parts, const Eigen::Isometry3d& X_LS);
  ProfileParts streams() const { return streams_; }

 private:
  std::vector<std::unique_ptr<MovedStream>> moved_;
  std::vector<ProfileStream*> streams_;
};

/// Parts one after the other.
class JoinedStream : public ProfileStream {
 public:
  explicit JoinedStream(ProfileParts parts) : parts_(parts) {}
  void rewind() override;
  const Profile* next() override;

 private:
  ProfileParts parts_;
  std::size_t at_ = 0;
};

}  // namespace celadon
