#pragma once
// Bytes as USB has them: little-endian.

#include <cstdint>
#include <initializer_list>
#include <span>
#include <vector>

namespace celadon::sim {

using Bytes = std::vector<std::uint8_t>;

// Byte by byte: g++ 12 sees an overrun in an insertion into a short vector.
inline void put(Bytes& out, std::span<const std::uint8_t> bytes) {
  for (const std::uint8_t byte : bytes) out.push_back(byte);
}
inline void put(Bytes& out, std::initializer_list<std::uint8_t> bytes) {
  put(out, std::span(bytes.begin(), bytes.size()));
}
/// The low `count` bytes of a number.
inline void put_number(Bytes& out, std::uint32_t value, int count) {
  for (int i = 0; i < count; ++i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}
inline Bytes number(std::uint32_t value, int count) {
  Bytes out;
  put_number(out, value, count);
  return out;
}
/// A number of at most four bytes.
inline std::uint32_t get_number(std::span<const std::uint8_t> bytes) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < bytes.size() && i < 4; ++i) value |= std::uint32_t{bytes[i]} << (8 * i);
  return value;
}

}  // namespace celadon::sim
