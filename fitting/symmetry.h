#pragma once
// Surfaces that repeat around their axis, or are their own mirror image: fitted on one sector, into which all samples
// are folded. Source: README.md, "Constraints".

#include <optional>

#include <tl/expected.hpp>

#include "fitting/base_arcs.h"
#include "fitting/profile.h"
#include "fitting/range_fit.h"

namespace celadon {

struct Symmetry {
  int fold = 1;           ///< the surface turned by 360/fold degrees is itself, >= 1
  bool mirrored = false;  ///< the mirror image in the half plane at plane_rad is itself
  double plane_rad = 0;
  bool any() const { return fold > 1 || mirrored; }
  /// What is not a repetition, as few arcs of at most 90 degrees: RangeFitOptions::arcs of the fit.
  BaseArcs sector() const;
  int sectors() const { return mirrored ? 2 * fold : fold; }
};

/// Samples folded into the sector, covariances with them.
class FoldedStream : public ProfileStream {
 public:
  /// The stream must outlive this one, which rewinds and reads it.
  FoldedStream(ProfileStream& from, const Symmetry& symmetry) : from_(from), symmetry_(symmetry) {}
  void rewind() override { from_.rewind(); }
  const Profile* next() override;

 private:
  ProfileStream& from_;
  Symmetry symmetry_;
  Profile profile_;
};

/// The whole function of one over a sector: the same number, and the same knots on each.
RangeFunction unfolded(const RangeFunction& sector, const Symmetry& symmetry);
/// The whole surface of a fit over a sector, with its errors and standard deviations. @pre measured
RangeFit unfolded(RangeFit sector, const Symmetry& symmetry);

/// Where a surface is its own mirror image: the half plane, from the first one at or after theta = 0, about which
/// its harmonics are most alike. Errors: round surfaces, which are at every angle; those that are more unlike than
/// like.
/// @pre `whole` over all of a circle, fold-fold symmetric
tl::expected<double, FitError> find_mirror_plane(const RangeFunction& whole, int fold);

}  // namespace celadon
