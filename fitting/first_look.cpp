#include "fitting/first_look.h"

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
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
  v_.resize(profile.size());
  arcs_.place(profile.theta_rad.data(), profile.size(), v_.data());
  add(profile, v_);
}

void FirstLook::add(const Profile& profile, std::span<const double> v) {
  const std::size_t n = profile.size();
  points_ += n;
  profiles_ += profile.order == ProfileOrder::rows ? 1 : std::numeric_limits<double>::infinity();
  covariances_ = covariances_ || !profile.covariance.empty();
  for (std::size_t k = 0; k < n; ++k) {
    const double r = profile.r_mm[k], z = profile.z_mm[k];
    if (!(r > 0 && std::isfinite(r) && v[k] >= 0)) continue;
    if (!(z >= specification_.z_start_mm && z <= specification_.z_end_mm)) continue;
    samples_.add(hash_of(r, v[k], z), [&] { return SamplePoint{r, v[k], z}; });
    extents_.add(v[k], z);
  }
}

void merge(GatheredSamples& samples, const GatheredSamples& others) {
  samples.sums.merge(others.sums);
  samples.look.merge(others.look);
}

GatheredSamples gather(ProfileStream& samples, const GridSpecification& grid) {
  MomentGrid sums(grid);
  FirstLook look(sums);
  std::vector<double> v;
  samples.rewind();
  while (const Profile* profile = samples.next()) {
    v.resize(profile->size());
    grid.arcs.place(profile->theta_rad.data(), v.size(), v.data());
    sums.add_synchronised(profile->r_mm, v, profile->z_mm);
    look.add(*profile, v);
  }
  return {std::move(sums), std::move(look)};
}

GatheredSamples gather(ProfileParts parts, const GridSpecification& grid, const Executor& executor) {
  std::vector<std::optional<GatheredSamples>> gathered(parts.size());
  executor(static_cast<int>(parts.size()), [&](int k) {
    const auto at = static_cast<std::size_t>(k);
    gathered[at] = gather(*parts[at], grid);
  });
  for (std::size_t k = 1; k < gathered.size(); ++k) {
    merge(*gathered.front(), *gathered[k]);
    gathered[k].reset();
  }
  return std::move(*gathered.front());
}

}  // namespace celadon
