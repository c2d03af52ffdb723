#pragma once
// What a fit has to know of the samples before it can judge one of them; gathered while they come in.
// Source: README.md, "Passes".

#include <cstddef>
#include <span>
#include <vector>

#include "fitting/coverage.h"
#include "fitting/even_sample.h"
#include "fitting/executor.h"
#include "fitting/moment_grid.h"
#include "fitting/profile.h"

namespace celadon {

/// One kept sample of the stream.
struct SamplePoint {
  double r_mm, v, z_mm;
};

/// An even sample of the samples inside a band, how far they reach in every sector, and how many there are.
class FirstLook {
 public:
  static constexpr std::size_t kSamples = 1 << 17;  ///< kept at most
  /// Over the band of these sums, which need not hold samples yet.
  explicit FirstLook(const MomentGrid& sums);
  /// As another look at scattered points without covariances was.
  FirstLook(const MomentGrid& sums, EvenSample<SamplePoint> samples, SectorExtents extents, std::size_t points);

  void add(const Profile& profile);
  /// The same with v as BaseArcs::place() gives it of the profile's angles.
  void add(const Profile& profile, std::span<const double> v);
  /// What another look has seen of other samples. @pre over the same band
  void merge(const FirstLook& other);

  const GridSpecification& specification() const { return specification_; }
  const std::vector<SamplePoint>& samples() const { return samples_.values(); }
  const EvenSample<SamplePoint>& sample() const { return samples_; }
  const SectorExtents& extents() const { return extents_; }
  std::size_t points() const { return points_; }         ///< all, usable or not
  double profiles() const { return profiles_; }          ///< lines of rows; infinite where points are scattered
  bool has_covariances() const { return covariances_; }  ///< some profile did

 private:
  GridSpecification specification_;
  BaseArcs arcs_;
  EvenSample<SamplePoint> samples_{kSamples};
  SectorExtents extents_;
  std::size_t points_ = 0;
  double profiles_ = 0;
  bool covariances_ = false;
  std::vector<double> v_;
};

/// What a fit starts from.
struct GatheredSamples {
  MomentGrid sums;
  FirstLook look;
};

/// The sums and looks of two sets of samples as one. @throws std::invalid_argument if their grids differ
void merge(GatheredSamples& samples, const GatheredSamples& others);

/// One pass over a stream. @pre its samples are over the grid's base
GatheredSamples gather(ProfileStream& samples, const GridSpecification& grid);
/// The same of parts, each read once. @pre one at least; the same parts give the same bits whatever the executor
GatheredSamples gather(ProfileParts parts, const GridSpecification& grid, const Executor& executor);

}  // namespace celadon
