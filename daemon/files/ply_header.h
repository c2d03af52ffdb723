#pragma once
// The header of a PLY file: its elements and their properties.

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/files/input_file.h"
#include "daemon/files/scalar_type.h"

namespace celadon {

enum class PlyFormat { ascii, little_endian, big_endian };

struct PlyProperty {
  std::string name;
  ScalarType type = ScalarType::f32;
  std::optional<ScalarType> list_length;  ///< of a list property
};

struct PlyElement {
  std::string name;
  std::uint64_t count = 0;
  std::vector<PlyProperty> properties;

  bool has_lists() const;
  /// Bytes of the smallest record: all of it without lists, empty lists else. ASCII: a digit and a separator each.
  std::size_t least_bytes(PlyFormat format) const;
};

struct PlyHeader {
  PlyFormat format = PlyFormat::ascii;
  std::vector<PlyElement> elements;
  std::uint64_t data_offset = 0;
  std::uint64_t data_line = 0;
};

/// Errors: one sentence with file, line and remedy.
tl::expected<PlyHeader, std::string> read_ply_header(const InputFile& file);

}  // namespace celadon
