#pragma once
// The samples that a look has kept, as a stream.

#include <utility>

#include "fitting/first_look.h"
#include "fitting/profile.h"

namespace celadon {

/// One piece of scattered points, in the frame and over the base of the look.
class LookStream : public ProfileStream {
 public:
  explicit LookStream(const FirstLook& look) {
    const BaseArcs& arcs = look.specification().arcs;
    profile_.order = ProfileOrder::scattered;
    for (const SamplePoint& s : look.samples()) {
      profile_.r_mm.push_back(s.r_mm);
      profile_.theta_rad.push_back(arcs.theta_of_v(s.v));
      profile_.z_mm.push_back(s.z_mm);
    }
  }
  void rewind() override { read_ = false; }
  const Profile* next() override { return std::exchange(read_, true) ? nullptr : &profile_; }

 private:
  Profile profile_;
  bool read_ = false;
};

}  // namespace celadon
