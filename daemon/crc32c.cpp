#include "daemon/crc32c.h"

#include <array>
#include <bit>
#include <cstring>

namespace celadon {
namespace {

static_assert(std::endian::native == std::endian::little, "slicing reads words in file order");

constexpr std::size_t kSlices = 16;
using Tables = std::array<std::array<std::uint32_t, 256>, kSlices>;

constexpr Tables make_tables() {
  Tables t{};
  for (std::uint32_t i = 0; i < 256; ++i) {
    std::uint32_t crc = i;
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0x82F63B78u : 0u);
    t[0][i] = crc;
  }
  for (std::size_t s = 1; s < kSlices; ++s) {
    for (std::size_t i = 0; i < 256; ++i) t[s][i] = (t[s - 1][i] >> 8) ^ t[0][t[s - 1][i] & 0xFF];
  }
  return t;
}

constexpr Tables kTable = make_tables();

}  // namespace

std::uint32_t crc32c(const void* bytes, std::size_t n, std::uint32_t crc) {
  const auto* p = static_cast<const unsigned char*>(bytes);
  crc = ~crc;
  // Sixteen table look-ups at a time have no chain between them: several times the speed of a byte at a time.
  for (; n >= kSlices; n -= kSlices, p += kSlices) {
    std::uint64_t a = 0, b = 0;
    std::memcpy(&a, p, 8);
    std::memcpy(&b, p + 8, 8);
    a ^= crc;
    crc = kTable[15][a & 0xFF] ^ kTable[14][(a >> 8) & 0xFF] ^ kTable[13][(a >> 16) & 0xFF] ^
          kTable[12][(a >> 24) & 0xFF] ^ kTable[11][(a >> 32) & 0xFF] ^ kTable[10][(a >> 40) & 0xFF] ^
          kTable[9][(a >> 48) & 0xFF] ^ kTable[8][a >> 56] ^ kTable[7][b & 0xFF] ^ kTable[6][(b >> 8) & 0xFF] ^
          kTable[5][(b >> 16) & 0xFF] ^ kTable[4][(b >> 24) & 0xFF] ^ kTable[3][(b >> 32) & 0xFF] ^
          kTable[2][(b >> 40) & 0xFF] ^ kTable[1][(b >> 48) & 0xFF] ^ kTable[0][b >> 56];
  }
  for (; n > 0; --n, ++p) crc = (crc >> 8) ^ kTable[0][(crc ^ *p) & 0xFF];
  return ~crc;
}

}  // namespace celadon
