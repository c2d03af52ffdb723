#include "sim/texture.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "sim/random.h"

namespace celadon::sim {
namespace {

constexpr std::uint64_t kTexturePurpose = 31;
constexpr int kSide = 64;  // of the lattice
constexpr double kFinest_mm = 1.2;
constexpr double kMean = 0.6, kTextureDepth = 0.55;

std::size_t lattice_at(int x, int y, int z) {
  constexpr int kMask = kSide - 1;
  return static_cast<std::size_t>(((z & kMask) * kSide + (y & kMask)) * kSide + (x & kMask));
}

}  // namespace

Texture::Texture(std::uint64_t seed) : seed_(seed) {
  const RandomKey key = make_key(seed, kTexturePurpose, 0);
  constexpr std::uint32_t kCells = kSide * kSide * kSide;
  lattice_.reserve(kCells);
  for (std::uint32_t i = 0; i < kCells; ++i) lattice_.push_back(static_cast<float>(2 * random_uniform(key, i) - 1));
  const RandomKey places = make_key(seed, kTexturePurpose, 1);
  for (std::uint32_t k = 0; k < kOctaves; ++k) {
    const auto draw = [&](std::uint32_t i) { return random_uniform(places, 8 * k + i); };
    turn_[k] =
        Eigen::Quaterniond(draw(0) - 0.5, draw(1) - 0.5, draw(2) - 0.5, draw(3) - 0.5).normalized().toRotationMatrix();
    shift_[k] = kSide * Eigen::Vector3d(draw(4), draw(5), draw(6));
  }
}

float Texture::noise(const Eigen::Vector3d& at) const {
  const Eigen::Array3d below = at.array().floor();
  const Eigen::Array3f t = (at.array() - below).cast<float>();
  const Eigen::Array3f s = t * t * (3 - 2 * t);
  const int x = static_cast<int>(below.x()), y = static_cast<int>(below.y()), z = static_cast<int>(below.z());
  const auto along_x = [&](int j, int k) {
    const float a = lattice_[lattice_at(x, y + j, z + k)], b = lattice_[lattice_at(x + 1, y + j, z + k)];
    return a + s.x() * (b - a);
  };
  const auto along_y = [&](int k) {
    const float a = along_x(0, k), b = along_x(1, k);
    return a + s.y() * (b - a);
  };
  const float a = along_y(0), b = along_y(1);
  return a + s.z() * (b - a);
}

double Texture::albedo(const Eigen::Vector3d& p_O) const {
  double sum = 0, scale = 1 / kFinest_mm;
  for (std::size_t k = 0; k < kOctaves; ++k, scale *= 0.5) {
    sum += static_cast<double>(noise(scale * (turn_[k] * p_O) + shift_[k]));
  }
  return std::clamp(kMean + kTextureDepth * sum / kOctaves * 2, 0.2, 1.);
}

}  // namespace celadon::sim
