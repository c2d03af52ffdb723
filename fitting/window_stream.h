#pragma once
// The samples of a stream between two heights.

#include "fitting/profile.h"

namespace celadon {

/// Passes on what lies within [lowest_mm, highest_mm] along z, both ends included; samples without a number never do.
/// The profiles keep their order and their descriptions; one that loses all samples stays, empty.
class WindowStream : public ProfileStream {
 public:
  /// The stream must outlive this one, which rewinds and reads it.
  WindowStream(ProfileStream& from, double lowest_mm, double highest_mm)
      : from_(from), lowest_mm_(lowest_mm), highest_mm_(highest_mm) {}
  void rewind() override { from_.rewind(); }
  const Profile* next() override;

 private:
  ProfileStream& from_;
  double lowest_mm_, highest_mm_;
  Profile profile_;
};

}  // namespace celadon
