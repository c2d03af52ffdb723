#include "fitting/first_look.h"

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>

namespace celadon {
namespace {

// Of the sample itself, so that the same ones are kept in whatever order they come.
std::uint32_t hash_of(double r, double v, double z) {
  std::uint64_t hash = scrambled(std::bit_cast<std::uint64_t>(r));
  hash = scrambled(hash ^ std::bit_cast<std::uint64_t>(v));
  return static_cast<std::uint32_t>(scrambled(hash ^ std::bit_cast<std::uint64_t>(z)) >> 32);
}

}  // namespace

FirstLook::FirstLook(const MomentGrid& sums)
    : specification_(sums.specification()), arcs_(sums.arcs()), extents_(sums) {}

FirstLook::FirstLook(const MomentGrid& sums, EvenSample<SamplePoint> samples, SectorExtents extents, std::size_t points)
    : FirstLook(sums) {
  samples_ = std::move(samples);
  extents_ = std::move(extents);
  points_ = points;
  profiles_ = points > 0 ? std::numeric_limits<double>::infinity() : 0;
}

void FirstLook::merge(const FirstLook& other) {
  samples_.merge(other.samples_);
  extents_.merge(other.extents_);
  points_ += other.points_;
  profiles_ += other.profiles_;
  covariances_ = covariances_ || other.covariances_;
}

void FirstLook::add(const Profile& profile) {
  const std::size_t n = profile.size();
  points_ += n;
  profiles_ += profile.order == ProfileOrder::rows ? 1 : std::numeric_limits<double>::infinity();
  covariances_ = covariances_ || !profile.covariance.empty();
  v_.resize(n);
  arcs_.place(profile.theta_rad.data(), n, v_.data());
  for (std::size_t k = 0; k < n; ++k) {
    const double r = profile.r_mm[k], z = profile.z_mm[k];
    if (!(r > 0 && std::isfinite(r) && v_[k] >= 0)) continue;
    if (!(z >= specification_.z_start_mm && z <= specification_.z_end_mm)) continue;
    samples_.add(hash_of(r, v_[k], z), [&] { return SamplePoint{r, v_[k], z}; });
    extents_.add(v_[k], z);
  }
}

void merge(GatheredSamples& samples, const GatheredSamples& others) {
  samples.sums.merge(others.sums);
  samples.look.merge(others.look);
}

GatheredSamples gather(ProfileStream& samples, const GridSpecification& grid) {
  MomentGrid sums(grid);
  FirstLook look(sums);
  samples.rewind();
  while (const Profile* profile = samples.next()) {
    sums.add(profile->r_mm, profile->theta_rad, profile->z_mm);
    look.add(*profile);
  }
  return {std::move(sums), std::move(look)};
}

}  // namespace celadon
