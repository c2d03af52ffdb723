#include "tests/daemon/cloud_writers.h"

#include <algorithm>
#include <cstdio>
#include <cstring>

namespace celadon::testing {
namespace {

template <class T>
std::string raw(T value, bool big_endian) {
  std::string bytes(sizeof(T), '\0');
  std::memcpy(bytes.data(), &value, sizeof(T));
  if (big_endian) {
    std::reverse(bytes.begin(), bytes.end());
  }
  return bytes;
}

double value_of(const std::array<double, 3>& point, const Column& column, std::size_t index) {
  if (column.name == "x" || column.name == "y" || column.name == "z") {
    return point[static_cast<std::size_t>(column.name[0] - 'x')];
  }
  return static_cast<double>(index % 100);
}

std::string text_of(double value, const Column& column) {
  char buffer[64];
  std::snprintf(buffer, sizeof buffer, column.kind == 'f' ? (column.size == 4 ? "%.9g" : "%.17g") : "%.0f", value);
  return buffer;
}

std::string ply_type(const Column& column) {
  static const char* const floats[] = {"float", "double"};
  static const char* const integers[] = {"char", "short", "int"};
  static const char* const unsigned_integers[] = {"uint8", "uint16", "uint32"};
  if (column.kind == 'f') {
    return floats[column.size / 8];
  }
  return (column.kind == 'i' ? integers : unsigned_integers)[column.size / 2];
}

}  // namespace

std::string number_bytes(double value, const Column& column, bool big_endian) {
  switch (column.kind) {
    case 'f':
      return column.size == 4 ? raw(static_cast<float>(value), big_endian) : raw(value, big_endian);
    case 'i':
      return column.size == 1   ? raw(static_cast<std::int8_t>(value), big_endian)
             : column.size == 2 ? raw(static_cast<std::int16_t>(value), big_endian)
             : column.size == 4 ? raw(static_cast<std::int32_t>(value), big_endian)
                                : raw(static_cast<std::int64_t>(value), big_endian);
    default:
      return column.size == 1   ? raw(static_cast<std::uint8_t>(value), big_endian)
             : column.size == 2 ? raw(static_cast<std::uint16_t>(value), big_endian)
             : column.size == 4 ? raw(static_cast<std::uint32_t>(value), big_endian)
                                : raw(static_cast<std::uint64_t>(value), big_endian);
  }
}

std::string ply(const Points& points, const PlyShape& shape) {
  const bool text = shape.kind == PlyKind::ascii;
  const bool big = shape.kind == PlyKind::big_endian;
  std::string bytes = "ply\nformat ";
  bytes += text ? "ascii" : big ? "binary_big_endian" : "binary_little_endian";
  bytes += " 1.0\ncomment made by a test\nobj_info none\n";
  if (shape.leading_lists) {
    bytes += "element strip 2\nproperty list ushort double weights\nproperty char kind\n";
  }
  bytes += "element vertex " + std::to_string(points.size()) + "\n";
  for (std::size_t i = 0; i < shape.columns.size(); ++i) {
    bytes += "property " + ply_type(shape.columns[i]) + " " + shape.columns[i].name + "\n";
    if (i == 0 && shape.with_list) {
      bytes += "property list uchar short neighbours\n";
    }
  }
  if (shape.with_faces) {
    bytes += "element face 1\nproperty list uchar int vertex_indices\n";
  }
  bytes += "end_header\n";
  if (shape.leading_lists) {
    for (int strip = 0; strip < 2; ++strip) {
      const int length = 3 - strip;
      bytes += text ? std::to_string(length) : raw(static_cast<std::uint16_t>(length), big);
      for (int i = 0; i < length; ++i) {
        bytes += text ? " 0.5" : raw(0.5, big);
      }
      bytes += text ? " 7\n" : "\7";
    }
  }
  for (std::size_t n = 0; n < points.size(); ++n) {
    for (std::size_t i = 0; i < shape.columns.size(); ++i) {
      const double value = value_of(points[n], shape.columns[i], n);
      bytes += text ? std::string(i > 0 ? " " : "").append(text_of(value, shape.columns[i]))
                    : number_bytes(value, shape.columns[i], big);
      if (i == 0 && shape.with_list) {
        const auto length = static_cast<std::uint8_t>(n % 4);
        bytes += text ? std::string(" ").append(std::to_string(length)) : raw(length, big);
        for (int k = 0; k < length; ++k) {
          bytes += text ? " -3" : raw(static_cast<std::int16_t>(-3), big);
        }
      }
    }
    bytes += text ? "\n" : "";
  }
  if (shape.with_faces) {
    bytes += text ? std::string("3 0 1 2\n") : std::string("\3") + raw(0, big) + raw(1, big) + raw(2, big);
  }
  return bytes;
}

std::string lzf(const std::string& bytes) {
  std::string out;
  std::string literals;
  const auto flush = [&] {
    if (!literals.empty()) {
      out += static_cast<char>(literals.size() - 1);
      out += literals;
      literals.clear();
    }
  };
  for (std::size_t at = 0; at < bytes.size();) {
    std::size_t best = 0;
    std::size_t from = 0;
    for (std::size_t distance = 1; distance <= std::min<std::size_t>(at, 8192) && best < 264; ++distance) {
      std::size_t length = 0;
      while (length < 264 && at + length < bytes.size() && bytes[at + length] == bytes[at + length - distance]) {
        ++length;
      }
      if (length > best) {
        best = length;
        from = distance;
      }
    }
    if (best < 3) {
      literals += bytes[at++];
      if (literals.size() == 32) {
        flush();
      }
      continue;
    }
    flush();
    const std::size_t code = best - 2;
    const std::size_t back = from - 1;
    if (code < 7) {
      out += static_cast<char>((code << 5) | (back >> 8));
    } else {
      out += static_cast<char>((7U << 5) | (back >> 8));
      out += static_cast<char>(code - 7);
    }
    out += static_cast<char>(back & 0xFF);
    at += best;
  }
  flush();
  return out;
}

std::string pcd(const Points& points, PcdKind kind, const std::vector<Column>& columns) {
  std::string fields = "FIELDS";
  std::string sizes = "SIZE";
  std::string types = "TYPE";
  std::string counts = "COUNT";
  for (const Column& column : columns) {
    // A filler has two numbers a point.
    const bool filler = column.name == "filler";
    fields.append(" ").append(column.name);
    sizes.append(" ").append(std::to_string(column.size));
    types += std::string(" ") + static_cast<char>(column.kind - 'a' + 'A');
    counts += filler ? " 2" : " 1";
  }
  std::string bytes = "# .PCD v.7 - Point Cloud Data file format\nVERSION .7\n" + fields + "\n" + sizes + "\n" + types +
                      "\n" + counts + "\nWIDTH " + std::to_string(points.size()) +
                      "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + std::to_string(points.size()) + "\nDATA ";
  const auto repeats = [](const Column& column) { return column.name == "filler" ? 2 : 1; };
  if (kind == PcdKind::compressed) {
    std::string block;
    for (const Column& column : columns) {
      for (std::size_t n = 0; n < points.size(); ++n) {
        for (int k = 0; k < repeats(column); ++k) {
          block += number_bytes(value_of(points[n], column, n), column, false);
        }
      }
    }
    const std::string packed = lzf(block);
    return bytes + "binary_compressed\n" + raw(static_cast<std::uint32_t>(packed.size()), false) +
           raw(static_cast<std::uint32_t>(block.size()), false) + packed;
  }
  bytes += kind == PcdKind::ascii ? "ascii\n" : "binary\n";
  for (std::size_t n = 0; n < points.size(); ++n) {
    std::string line;
    for (const Column& column : columns) {
      for (int k = 0; k < repeats(column); ++k) {
        const double value = value_of(points[n], column, n);
        line += kind == PcdKind::ascii ? std::string(line.empty() ? "" : " ").append(text_of(value, column))
                                       : number_bytes(value, column, false);
      }
    }
    bytes += line + (kind == PcdKind::ascii ? "\n" : "");
  }
  return bytes;
}

}  // namespace celadon::testing
