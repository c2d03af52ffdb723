#pragma once
// What an object's surface looks like under even light: albedo as a smooth random function of the place in it.

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

namespace celadon::sim {

/// The albedo of a textured object, a function of the point of the object frame: four octaves of value noise (random
/// numbers on a cubic lattice, in between smooth of class C^1) of 1.2, 2.4, 4.8 and 9.6 mm, each on a lattice that is
/// turned and moved. It repeats after 77 mm in the finest octave, after 614 mm in the coarsest, never in all.
class Texture {
 public:
  explicit Texture(std::uint64_t seed);
  std::uint64_t seed() const { return seed_; }
  /// 0.2 to 1.
  double albedo(const Eigen::Vector3d& p_O) const;

 private:
  static constexpr int kOctaves = 4;
  float noise(const Eigen::Vector3d& at) const;

  std::uint64_t seed_;
  std::vector<float> lattice_;  ///< in [-1, 1]
  std::array<Eigen::Matrix3d, kOctaves> turn_;
  std::array<Eigen::Vector3d, kOctaves> shift_;
};

}  // namespace celadon::sim
