#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <limits>
#include <optional>
#include <vector>

#include "daemon/files/binary_records.h"
#include "daemon/files/cloud_kinds.h"
#include "daemon/files/file_problem.h"
#include "daemon/files/lzf_stream.h"
#include "daemon/files/number_text.h"
#include "daemon/files/text_records.h"

namespace celadon {
namespace {

struct PcdField {
  std::string name;
  std::uint64_t size = 4, count = 1;
  char type = 'F';
  std::uint64_t bytes() const { return size * count; }
};

struct PcdHeader {
  std::vector<PcdField> fields;
  std::optional<std::uint64_t> width, height, points;
  std::string data;
  std::uint64_t data_offset = 0, data_line = 0;
};

std::optional<ScalarType> pcd_type(const PcdField& field) {
  const auto pick = [&](ScalarType one, ScalarType two, ScalarType four,
                        ScalarType eight) -> std::optional<ScalarType> {
    switch (field.size) {
      case 1:
        return one;
      case 2:
        return two;
      case 4:
        return four;
      case 8:
        return eight;
      default:
        return std::nullopt;
    }
  };
  switch (field.type) {
    case 'I':
      return pick(ScalarType::i8, ScalarType::i16, ScalarType::i32, ScalarType::i64);
    case 'U':
      return pick(ScalarType::u8, ScalarType::u16, ScalarType::u32, ScalarType::u64);
    case 'F':
      return field.size == 4   ? std::optional(ScalarType::f32)
             : field.size == 8 ? std::optional(ScalarType::f64)
                               : std::nullopt;
    default:
      return std::nullopt;
  }
}

std::optional<std::uint64_t> parse_count(std::string_view word) {
  std::uint64_t value = 0;
  const auto parsed = std::from_chars(word.data(), word.data() + word.size(), value);
  return parsed.ec == std::errc() && parsed.ptr == word.data() + word.size() ? std::optional(value) : std::nullopt;
}

/// Sizes beyond this are mistakes; the limit keeps every product below 2^64 and every record in a buffer.
constexpr std::uint64_t field_limit = 1U << 16;

class PcdHeaderReader {
 public:
  explicit PcdHeaderReader(const InputFile& file) : file_(file), cursor_(file, 0, file.size(), 1U << 16) {}

  tl::expected<PcdHeader, std::string> read() {
    std::string_view line;
    bool too_long = false;
    while (cursor_.line(line, too_long) && line_ < 1000) {
      ++line_;
      if (too_long) {
        return wrong("it is too long for a header");
      }
      if (const auto comment = line.find('#'); comment != std::string_view::npos) {
        line = line.substr(0, comment);
      }
      const auto keyword = take_field(line, Separator::blank);
      if (!keyword) {
        continue;
      }
      std::vector<std::string_view> words;
      while (const auto word = take_field(line, Separator::blank)) {
        words.push_back(*word);
      }
      if (*keyword == "DATA") {
        header_.data = words.empty() ? "" : std::string(words[0]);
        header_.data_offset = cursor_.offset();
        header_.data_line = line_ + 1;
        return header_;
      }
      if (const std::string problem = entry(*keyword, words); !problem.empty()) {
        return wrong(problem);
      }
    }
    return tl::make_unexpected(file_.path().string() + " is a PCD file without a line DATA; copy or export it again");
  }

 private:
  tl::unexpected<std::string> wrong(const std::string& what) const {
    return tl::make_unexpected(file_.path().string() + " line " + std::to_string(line_) +
                               " of its PCD header: " + what + "; export it again");
  }

  std::string entry(std::string_view keyword, const std::vector<std::string_view>& words) {
    if (keyword == "VERSION" || keyword == "VIEWPOINT") {
      return "";
    }
    if (keyword == "FIELDS" || keyword == "COLUMNS") {
      header_.fields.clear();
      for (const auto word : words) {
        header_.fields.emplace_back().name = word;
      }
      return "";
    }
    if (keyword == "SIZE" || keyword == "TYPE" || keyword == "COUNT") {
      if (words.size() != header_.fields.size()) {
        return std::string(keyword) + " has " + std::to_string(words.size()) + " entries for " +
               std::to_string(header_.fields.size()) + " fields";
      }
      for (std::size_t i = 0; i < words.size(); ++i) {
        if (keyword == "TYPE") {
          header_.fields[i].type = words[i][0];
          continue;
        }
        const auto value = parse_count(words[i]);
        if (!value || *value == 0 || *value > field_limit) {
          return std::string(keyword) + " " + in_quotes(words[i]) + " is not within 1 .. 65536";
        }
        (keyword == "SIZE" ? header_.fields[i].size : header_.fields[i].count) = *value;
      }
      return "";
    }
    auto* const number = keyword == "WIDTH"    ? &header_.width
                         : keyword == "HEIGHT" ? &header_.height
                         : keyword == "POINTS" ? &header_.points
                                               : nullptr;
    if (number == nullptr) {
      return in_quotes(keyword) + " is not understood";
    }
    *number = words.size() == 1 ? parse_count(words[0]) : std::nullopt;
    return number->has_value() ? "" : std::string(keyword) + " is not a number";
  }

  const InputFile& file_;
  ByteCursor cursor_;
  std::uint64_t line_ = 0;
  PcdHeader header_;
};

/// WIDTH x HEIGHT and POINTS say the same thing, or the file lies.
tl::expected<std::uint64_t, std::string> number_of_points(const InputFile& file, const PcdHeader& header) {
  std::optional<std::uint64_t> product;
  if (header.width && header.height) {
    if (*header.height != 0 && *header.width > std::numeric_limits<std::uint64_t>::max() / *header.height) {
      return tl::make_unexpected(file.path().string() + " promises WIDTH " + grouped(*header.width) + " x HEIGHT " +
                                 grouped(*header.height) + " points, more than any file holds; export it again");
    }
    product = *header.width * *header.height;
  }
  if (header.points && product && *header.points != *product) {
    return tl::make_unexpected(file.path().string() + " contradicts itself: POINTS " + grouped(*header.points) +
                               ", but WIDTH x HEIGHT " + grouped(*product) + "; export it again");
  }
  if (!header.points && !product) {
    return tl::make_unexpected(file.path().string() + " says neither POINTS nor WIDTH and HEIGHT; export it again");
  }
  const std::uint64_t count = header.points ? *header.points : *product;
  if (count == 0) {
    return tl::make_unexpected(file.path().string() + " holds 0 points; export it again");
  }
  return count;
}

/// The columns of a binary_compressed block lie one after the other; three decoders run side by side.
class CompressedColumns : public PointSource {
 public:
  struct Column {
    std::uint64_t begin = 0;  ///< in the decoded block
    ScalarType type = ScalarType::f32;
    std::optional<LzfStream> start, stream;
  };

  CompressedColumns(const InputFile& file, std::uint64_t count, std::array<Column, 3> columns)
      : file_(file), count_(count), left_(count), columns_(std::move(columns)) {}

  void rewind() override {
    for (Column& column : columns_) {
      column.stream = column.start;
    }
    left_ = count_;
    error_.clear();
  }

  std::size_t read(std::size_t count, double* a, double* b, double* c) override {
    const auto piece = static_cast<std::size_t>(std::min<std::uint64_t>({count, bytes_.size() / 8, left_}));
    if (piece == 0 || !error_.empty()) {
      return 0;
    }
    double* const values[] = {a, b, c};
    for (std::size_t k = 0; k < 3; ++k) {
      Column& column = columns_[k];
      const std::size_t size = size_of(column.type);
      if (!column.stream->read(piece * size, bytes_.data())) {
        error_ = !file_.error().empty() ? file_.error() : file_.path().string() + ": " + column.stream->error();
        return 0;
      }
      decode_column(column.type, false, bytes_.data(), size, piece, values[k]);
    }
    left_ -= piece;
    return piece;
  }

  std::optional<std::uint64_t> promised() const override { return count_; }

 private:
  const InputFile& file_;
  std::uint64_t count_, left_;
  std::array<Column, 3> columns_;
  std::array<char, 32768> bytes_{};
};

Opened open_compressed(const InputFile& file, const PcdHeader& header, std::uint64_t count, std::uint64_t stride,
                       const std::array<std::size_t, 3>& wanted) {
  const std::string name = file.path().string();
  std::uint32_t sizes[2] = {};
  if (file.read_at(header.data_offset, reinterpret_cast<char*>(sizes), sizeof sizes) < sizeof sizes) {
    return tl::make_unexpected(name + " ends at byte " + grouped(file.size()) +
                               ", before its compressed block; copy it again");
  }
  const std::uint64_t begin = header.data_offset + sizeof sizes;
  const auto [compressed, decoded] = sizes;
  if (compressed > file.size() - begin) {
    return tl::make_unexpected(name + " promises a compressed block of " + grouped(compressed) + " bytes from byte " +
                               grouped(begin) + " on, but it ends at byte " + grouped(file.size()) + "; copy it again");
  }
  // Three bytes of LZF give at most 264.
  if (count > decoded / stride || count * stride != decoded || decoded / 88 > compressed) {
    return tl::make_unexpected(name + " promises " + grouped(count) + " points of " + std::to_string(stride) +
                               " bytes, but its compressed block of " + grouped(compressed) + " bytes stands for " +
                               grouped(decoded) + " bytes; export it again");
  }
  std::array<CompressedColumns::Column, 3> columns;
  std::array<std::size_t, 3> order = {0, 1, 2};
  for (std::size_t k = 0; k < 3; ++k) {
    for (std::size_t i = 0; i < wanted[k]; ++i) {
      columns[k].begin += header.fields[i].bytes() * count;
    }
    columns[k].type = *pcd_type(header.fields[wanted[k]]);
  }
  std::sort(order.begin(), order.end(), [&](auto a, auto b) { return columns[a].begin < columns[b].begin; });
  // One pass finds where each column starts and proves that the whole block decodes.
  LzfStream stream(file, begin, begin + compressed);
  bool good = true;
  for (const std::size_t k : order) {
    good = good && stream.skip(columns[k].begin - stream.decoded());
    columns[k].start = columns[k].stream = stream;
  }
  if (!good || !stream.skip(decoded - stream.decoded())) {
    return tl::make_unexpected(
        !file.error().empty() ? file.error() : name + " is damaged: " + stream.error() + "; copy or export it again");
  }
  if (!stream.at_end()) {
    return tl::make_unexpected(name +
                               " is damaged: its compressed block goes on after the last point; export it again");
  }
  return std::make_unique<CompressedColumns>(file, count, std::move(columns));
}

}  // namespace

Opened open_pcd(const InputFile& file) {
  const auto header = PcdHeaderReader(file).read();
  if (!header) {
    return tl::make_unexpected(header.error());
  }
  const auto count = number_of_points(file, *header);
  if (!count) {
    return tl::make_unexpected(count.error());
  }
  std::uint64_t stride = 0;
  std::uint64_t columns_before = 0;
  std::array<std::size_t, 3> wanted{};
  BinaryLayout binary;
  TextLayout text;
  static constexpr const char* names[] = {"x", "y", "z"};
  std::array<bool, 3> found{};
  for (std::size_t i = 0; i < header->fields.size(); ++i) {
    const PcdField& field = header->fields[i];
    for (std::size_t k = 0; k < 3; ++k) {
      if (field.name != names[k] || found[k]) {
        continue;
      }
      const auto type = pcd_type(field);
      if (!type || field.count != 1) {
        return tl::make_unexpected(file.path().string() + " has a field " + names[k] + " of SIZE " +
                                   std::to_string(field.size) + ", TYPE " + field.type + ", COUNT " +
                                   std::to_string(field.count) + ", which is not one number; export it again");
      }
      found[k] = true;
      wanted[k] = i;
      binary.field[k] = {static_cast<std::size_t>(stride), *type};
      text.column[k] = static_cast<std::size_t>(columns_before);
    }
    stride += field.bytes();
    columns_before += field.count;
  }
  for (std::size_t k = 0; k < 3; ++k) {
    if (!found[k]) {
      return tl::make_unexpected(file.path().string() + " has no field " + names[k] + "; export it with x, y and z");
    }
  }
  if (stride > (1U << 24)) {
    return tl::make_unexpected(file.path().string() + " has points of " + grouped(stride) +
                               " bytes, more than any cloud needs; export it again");
  }
  if (header->data == "ascii") {
    // A digit and a separator for every number, but for the last of the file.
    auto problem = broken_promise(file, *count, 2 * columns_before, header->data_offset - 1);
    if (!problem.empty()) {
      return tl::make_unexpected(std::move(problem));
    }
    text.begin = header->data_offset;
    text.line = header->data_line;
    text.promised = *count;
    return std::make_unique<TextRecords>(file, std::move(text));
  }
  if (header->data == "binary") {
    if (auto problem = broken_promise(file, *count, stride, header->data_offset); !problem.empty()) {
      return tl::make_unexpected(std::move(problem));
    }
    binary.begin = header->data_offset;
    binary.count = *count;
    binary.stride = static_cast<std::size_t>(stride);
    return std::make_unique<BinaryRecords>(file, binary);
  }
  if (header->data == "binary_compressed") {
    return open_compressed(file, *header, *count, stride, wanted);
  }
  return tl::make_unexpected(file.path().string() + " has DATA " + in_quotes(header->data) +
                             ", which is none of ascii, binary, binary_compressed; export it again");
}

}  // namespace celadon
