#include "daemon/files/ply_header.h"

#include <algorithm>
#include <charconv>
#include <utility>

#include "daemon/files/file_problem.h"
#include "daemon/files/number_text.h"

namespace celadon {
namespace {

std::optional<ScalarType> ply_type(std::string_view name) {
  static constexpr std::pair<std::string_view, ScalarType> names[] = {
      {"char", ScalarType::i8},    {"int8", ScalarType::i8},     {"uchar", ScalarType::u8},
      {"uint8", ScalarType::u8},   {"short", ScalarType::i16},   {"int16", ScalarType::i16},
      {"ushort", ScalarType::u16}, {"uint16", ScalarType::u16},  {"int", ScalarType::i32},
      {"int32", ScalarType::i32},  {"uint", ScalarType::u32},    {"uint32", ScalarType::u32},
      {"float", ScalarType::f32},  {"float32", ScalarType::f32}, {"double", ScalarType::f64},
      {"float64", ScalarType::f64}};
  for (const auto& [known, type] : names) {
    if (known == name) {
      return type;
    }
  }
  return std::nullopt;
}

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  while (const auto word = take_field(line, Separator::blank)) {
    words.push_back(*word);
  }
  return words;
}

}  // namespace

bool PlyElement::has_lists() const {
  return std::any_of(properties.begin(), properties.end(), [](const auto& p) { return p.list_length.has_value(); });
}

std::size_t PlyElement::least_bytes(PlyFormat format) const {
  std::size_t bytes = 0;
  for (const PlyProperty& property : properties) {
    bytes += format == PlyFormat::ascii ? 2 : size_of(property.list_length.value_or(property.type));
  }
  return bytes;
}

tl::expected<PlyHeader, std::string> read_ply_header(const InputFile& file) {
  PlyHeader header;
  ByteCursor cursor(file, 0, file.size(), 1U << 16);
  std::uint64_t line_number = 0;
  bool format_known = false;
  std::string_view line;
  bool too_long = false;
  const auto wrong = [&](const std::string& what) {
    return tl::make_unexpected(file.path().string() + " line " + std::to_string(line_number) +
                               " of its PLY header: " + what + "; export it again");
  };
  while (cursor.line(line, too_long) && line_number < 10000) {
    ++line_number;
    if (too_long) {
      return wrong("it is too long for a header");
    }
    const auto words = words_of(line);
    if (words.empty() || words[0] == "comment" || words[0] == "obj_info" || line_number == 1) {
      continue;
    }
    if (words[0] == "end_header") {
      header.data_offset = cursor.offset();
      header.data_line = line_number + 1;
      if (!format_known) {
        return wrong("it ends without a format");
      }
      return header;
    }
    if (words[0] == "format" && words.size() == 3) {
      format_known = true;
      if (words[1] == "ascii") {
        header.format = PlyFormat::ascii;
      } else if (words[1] == "binary_little_endian") {
        header.format = PlyFormat::little_endian;
      } else if (words[1] == "binary_big_endian") {
        header.format = PlyFormat::big_endian;
      } else {
        return wrong("format " + in_quotes(words[1]) + " is none of ascii, binary_little_endian, binary_big_endian");
      }
    } else if (words[0] == "element" && words.size() == 3) {
      PlyElement element;
      element.name = words[1];
      const char* end = words[2].data() + words[2].size();
      const auto parsed = std::from_chars(words[2].data(), end, element.count);
      if (parsed.ec != std::errc() || parsed.ptr != end) {
        return wrong(in_quotes(words[2]) + " is not a number of elements");
      }
      header.elements.push_back(std::move(element));
    } else if (words[0] == "property" && !header.elements.empty() &&
               (words.size() == 3 || (words.size() == 5 && words[1] == "list"))) {
      PlyProperty property;
      const bool list = words.size() == 5;
      const auto type = ply_type(words[list ? 3 : 1]);
      const auto length = list ? ply_type(words[2]) : std::nullopt;
      if (!type || (list && !length)) {
        return wrong(in_quotes(words[list && !length ? 2 : list ? 3 : 1]) + " is not a type of PLY");
      }
      property.name = words.back();
      property.type = *type;
      property.list_length = length;
      header.elements.back().properties.push_back(std::move(property));
    } else {
      return wrong(in_quotes(line) + " is not understood");
    }
  }
  return tl::make_unexpected(file.path().string() + " is a PLY file without \"end_header\": it ends at byte " +
                             grouped(file.size()) + "; copy or export it again");
}

}  // namespace celadon
