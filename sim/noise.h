#pragma once
// The sensor's noise, a row at a time, vectorised with run-time dispatch. Same bits on every SIMD level.

#include <cstddef>
#include <cstdint>

#include "sim/random.h"

namespace celadon::sim {

/// What turns a mean brightness into a grey level.
struct SensorNoise {
  float pedestal = 4.F;              ///< black level, grey levels
  float electrons_per_level = 40.F;  ///< shot noise variance = mean / this, in levels^2
  float read_levels = 1.5F;          ///< standard deviation of the read noise, grey levels
};

/// out[i] = clamp(round(pedestal + mean + sqrt(mean / electrons + read^2) * gaussian(key, first + i)), 0, 255) with
/// mean = levels[i] * factor.
/// Shot noise is taken as Gaussian: at 40 electrons a level the pedestal's read noise hides what differs.
/// @pre levels[i] * factor >= 0
void expose_row(const float* levels, float factor, std::size_t count, const SensorNoise& noise, const RandomKey& key,
                std::uint32_t first, std::uint8_t* out);

/// out[i] = gaussian(key, first + i).
void gaussian_row(const RandomKey& key, std::uint32_t first, std::size_t count, float* out);

/// Name of the SIMD target in use ("AVX2", ...).
const char* noise_simd_target();

}  // namespace celadon::sim
