#pragma once
// The number types of binary clouds, and their decoding from records of any stride.

#include <bit>
#include <concepts>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string_view>

namespace celadon {

enum class ScalarType : std::uint8_t { i8, u8, i16, u16, i32, u32, i64, u64, f32, f64 };

constexpr std::size_t size_of(ScalarType type) {
  switch (type) {
    case ScalarType::i8:
    case ScalarType::u8:
      return 1;
    case ScalarType::i16:
    case ScalarType::u16:
      return 2;
    case ScalarType::i32:
    case ScalarType::u32:
    case ScalarType::f32:
      return 4;
    default:
      return 8;
  }
}

/// One number at `bytes`, with its bytes reversed if `swapped`.
template <class T>
T load_scalar(const char* bytes, bool swapped) {
  T value;
  if (swapped) {
    char reversed[sizeof(T)];
    for (std::size_t i = 0; i < sizeof(T); ++i) {
      reversed[i] = bytes[sizeof(T) - 1 - i];
    }
    std::memcpy(&value, reversed, sizeof(T));
  } else {
    std::memcpy(&value, bytes, sizeof(T));
  }
  return value;
}

/// Calls `use` with a value of the C++ type of `type`.
template <class Use>
decltype(auto) with_type(ScalarType type, Use&& use) {
  switch (type) {
    case ScalarType::i8:
      return use(std::int8_t{});
    case ScalarType::u8:
      return use(std::uint8_t{});
    case ScalarType::i16:
      return use(std::int16_t{});
    case ScalarType::u16:
      return use(std::uint16_t{});
    case ScalarType::i32:
      return use(std::int32_t{});
    case ScalarType::u32:
      return use(std::uint32_t{});
    case ScalarType::i64:
      return use(std::int64_t{});
    case ScalarType::u64:
      return use(std::uint64_t{});
    case ScalarType::f32:
      return use(float{});
    default:
      return use(double{});
  }
}

/// `count` numbers, `stride` bytes apart, the first at `bytes`.
inline void decode_column(ScalarType type, bool swapped, const char* bytes, std::size_t stride, std::size_t count,
                          double* values) {
  with_type(type, [&]<class T>(T) {
    // Two loops: the plain one is what nearly every file needs, and the compiler unrolls it.
    if (swapped) {
      for (std::size_t i = 0; i < count; ++i) {
        values[i] = static_cast<double>(load_scalar<T>(bytes + i * stride, true));
      }
    } else {
      for (std::size_t i = 0; i < count; ++i) {
        values[i] = static_cast<double>(load_scalar<T>(bytes + i * stride, false));
      }
    }
  });
}

static_assert(std::endian::native == std::endian::little, "binary clouds are decoded on little-endian machines");

}  // namespace celadon
