#pragma once
// Sum of all bytes by SIMD: reading a frame once is the limit that extraction is measured against.

#include <cstddef>
#include <cstdint>

namespace celadon::bench {

std::uint64_t sum_of_bytes(const std::uint8_t* bytes, std::size_t count);

}  // namespace celadon::bench
