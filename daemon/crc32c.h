#pragma once
#include <cstddef>
#include <cstdint>

namespace celadon {

/// CRC32C (Castagnoli; RFC 3720, appendix B.4) of n bytes, continuing `crc` (0 to begin).
std::uint32_t crc32c(const void* bytes, std::size_t n, std::uint32_t crc = 0);

}  // namespace celadon
