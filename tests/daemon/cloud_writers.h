#pragma once
// Writers of point clouds for the tests, written from the formats' descriptions and sharing nothing with the readers.

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace celadon::testing {

using Points = std::vector<std::array<double, 3>>;

/// A column of a binary or text cloud: x, y, z or a filler.
struct Column {
  std::string name;
  char kind = 'f';       ///< 'f' floating, 'i' signed, 'u' unsigned
  std::size_t size = 4;  ///< 1, 2, 4, 8
};

/// One number in the bytes of its type.
std::string number_bytes(double value, const Column& column, bool big_endian);

enum class PlyKind { ascii, little_endian, big_endian };
/// Vertices with the given columns; with_list adds a list property in the second place of each vertex, of varying
/// length; with_faces adds faces after, leading_lists an element with lists before the vertices.
struct PlyShape {
  PlyKind kind = PlyKind::little_endian;
  std::vector<Column> columns = {{"x"}, {"y"}, {"z"}};
  bool with_list = false, with_faces = false, leading_lists = false;
};
std::string ply(const Points& points, const PlyShape& shape);

enum class PcdKind { ascii, binary, compressed };
std::string pcd(const Points& points, PcdKind kind, const std::vector<Column>& columns);

/// LZF: greedy matches by exhaustive look-back over 8192 bytes.
std::string lzf(const std::string& bytes);

}  // namespace celadon::testing
