#pragma once
// Cylinders whose ends are not plane: a wall cut slantwise, a bowl with a scalloped rim. Source: README.md, "Rims that
// are not plane".

#include <memory>

#include <tl/expected.hpp>

#include "fitting/profile.h"
#include "fitting/range_fit.h"

namespace celadon {

/// Where a wall ends.
struct Rims {
  std::shared_ptr<const RangeFunction> heights;       ///< as BaseSurface has them
  double lower_scatter_mm = 0, upper_scatter_mm = 0;  ///< of the ends of the samples about smooth curves
  double share_beyond = 0;                            ///< of the samples, outside both
};

/// Heights z(theta, along) between the two ends of the samples as they run around: linear along a band that ends at
/// the ends' mean heights, of options.degree_v around. The ends are what half of the samples there reach, or a little
/// less: nothing is extrapolated.
/// Errors: too few samples, an angle without any, ends that cross or are no functions of the angle; one sentence with
/// the remedy.
/// @pre options.arcs is the whole turn; the samples are (r, theta, z)
tl::expected<Rims, FitError> find_rims(ProfileStream& samples, const RangeFitOptions& options);

/// A stream of (r, theta, z) as (r, theta, along), with covariances carried over. What lies beyond the rims is left
/// out.
class RimmedStream : public ProfileStream {
 public:
  /// The stream must outlive this one, which rewinds and reads it.
  RimmedStream(ProfileStream& from, std::shared_ptr<const RangeFunction> heights)
      : from_(from), heights_(std::move(heights)) {}
  void rewind() override { from_.rewind(), beyond_ = 0; }
  const Profile* next() override;
  /// Samples left out since it was made or rewound.
  std::size_t beyond() const { return beyond_; }

 private:
  ProfileStream& from_;
  std::shared_ptr<const RangeFunction> heights_;
  std::vector<double> lower_, upper_, along_;
  std::size_t beyond_ = 0;
  Profile profile_;
};

/// The surface that was fitted to a RimmedStream, between its rims.
void put_between_rims(RangeFit& fit, std::shared_ptr<const RangeFunction> heights);

}  // namespace celadon
