#include <algorithm>
#include <array>
#include <optional>
#include <vector>

#include "daemon/files/binary_records.h"
#include "daemon/files/cloud_kinds.h"
#include "daemon/files/file_problem.h"
#include "daemon/files/ply_header.h"
#include "daemon/files/text_records.h"

namespace celadon {
namespace {

/// Walks one binary record with lists; false when the range ends inside of it. Takes numbers of the wanted properties.
bool walk_record(ByteCursor& cursor, const PlyElement& element, bool swapped, const std::array<std::size_t, 3>& wanted,
                 std::array<double, 3>* values) {
  for (std::size_t i = 0; i < element.properties.size(); ++i) {
    const PlyProperty& property = element.properties[i];
    const ScalarType type = property.list_length.value_or(property.type);
    const std::string_view bytes = cursor.peek(size_of(type));
    if (bytes.size() < size_of(type)) {
      return false;
    }
    const double value =
        with_type(type, [&]<class T>(T) { return static_cast<double>(load_scalar<T>(bytes.data(), swapped)); });
    cursor.skip(size_of(type));
    if (property.list_length) {
      // Bytes of the list in doubles: a length of 4e9 times 8 is exact, and a negative or fractional one is refused.
      const double length = value * static_cast<double>(size_of(property.type));
      if (!(length >= 0) || length > static_cast<double>(cursor.end() - cursor.offset())) {
        return false;
      }
      cursor.seek(cursor.offset() + static_cast<std::uint64_t>(length));
    } else if (values != nullptr) {
      for (std::size_t k = 0; k < 3; ++k) {
        if (wanted[k] == i) {
          (*values)[k] = value;
        }
      }
    }
  }
  return true;
}

/// Binary vertices whose records differ in length.
class ListRecords : public PointSource {
 public:
  ListRecords(const InputFile& file, std::uint64_t begin, PlyElement element, bool swapped,
              const std::array<std::size_t, 3>& wanted)
      : file_(file),
        begin_(begin),
        element_(std::move(element)),
        swapped_(swapped),
        wanted_(wanted),
        cursor_(file, begin, file.size()) {}

  void rewind() override {
    cursor_ = ByteCursor(file_, begin_, file_.size());
    done_ = 0;
    error_.clear();
  }

  std::size_t read(std::size_t count, double* a, double* b, double* c) override {
    std::size_t got = 0;
    std::array<double, 3> values{};
    while (got < count && done_ < element_.count && error_.empty()) {
      const std::uint64_t at = cursor_.offset();
      if (!walk_record(cursor_, element_, swapped_, wanted_, &values)) {
        error_ = !file_.error().empty()
                     ? file_.error()
                     : file_.path().string() + " ends inside vertex " + grouped(done_) + " of " +
                           grouped(element_.count) + ", which starts at byte " + grouped(at) + "; copy it again";
        break;
      }
      a[got] = values[0];
      b[got] = values[1];
      c[got] = values[2];
      ++got;
      ++done_;
    }
    return got;
  }

  std::optional<std::uint64_t> promised() const override { return element_.count; }

 private:
  const InputFile& file_;
  std::uint64_t begin_;
  PlyElement element_;
  bool swapped_;
  std::array<std::size_t, 3> wanted_;
  ByteCursor cursor_;
  std::uint64_t done_ = 0;
};

/// Moves past the elements in front of the vertices; false when the file ends before.
bool pass_over(ByteCursor& cursor, const PlyElement& element, PlyFormat format, std::uint64_t& line_number) {
  if (format == PlyFormat::ascii) {
    std::string_view line;
    bool too_long = false;
    for (std::uint64_t i = 0; i < element.count;) {
      if (!cursor.line(line, too_long)) {
        return false;
      }
      if (!too_long) {
        ++line_number;
        ++i;
      }
    }
    return true;
  }
  if (!element.has_lists()) {
    cursor.seek(cursor.offset() + element.count * element.least_bytes(format));
    return true;
  }
  for (std::uint64_t i = 0; i < element.count; ++i) {
    if (!walk_record(cursor, element, format == PlyFormat::big_endian, {}, nullptr)) {
      return false;
    }
  }
  return true;
}

Opened source_of(const InputFile& file, const PlyHeader& header, std::size_t vertex_index) {
  const PlyElement& vertex = header.elements[vertex_index];
  std::array<std::size_t, 3> wanted{};
  static constexpr const char* names[] = {"x", "y", "z"};
  for (std::size_t k = 0; k < 3; ++k) {
    const auto found = std::find_if(vertex.properties.begin(), vertex.properties.end(),
                                    [&](const PlyProperty& p) { return p.name == names[k] && !p.list_length; });
    if (found == vertex.properties.end()) {
      return tl::make_unexpected(file.path().string() + " has vertices without a property " + names[k] +
                                 "; export it with x, y and z");
    }
    wanted[k] = static_cast<std::size_t>(found - vertex.properties.begin());
  }
  if (vertex.count == 0) {
    return tl::make_unexpected(file.path().string() + " holds 0 vertices; export it again");
  }

  ByteCursor cursor(file, header.data_offset, file.size());
  std::uint64_t line = header.data_line;
  for (std::size_t i = 0; i <= vertex_index; ++i) {
    const PlyElement& element = header.elements[i];
    // Elements without properties take no bytes: any number of them can be promised and passed over.
    if (const std::size_t least = element.least_bytes(header.format); least > 0) {
      // The last ASCII number of a file needs no separator after it.
      const std::uint64_t spare = header.format == PlyFormat::ascii ? 1 : 0;
      if (auto problem = broken_promise(file, element.count, least, cursor.offset() - spare); !problem.empty()) {
        return tl::make_unexpected(std::move(problem));
      }
      if (i < vertex_index && !pass_over(cursor, element, header.format, line)) {
        return tl::make_unexpected(file.path().string() + " ends inside its element \"" + element.name +
                                   "\", before the first vertex; copy it again");
      }
    }
  }

  if (header.format == PlyFormat::ascii) {
    TextLayout layout;
    layout.begin = cursor.offset();
    layout.line = line;
    layout.column = wanted;
    layout.promised = vertex.count;
    if (vertex.has_lists()) {
      for (const PlyProperty& property : vertex.properties) {
        layout.lists.push_back(property.list_length.has_value());
      }
    }
    return std::make_unique<TextRecords>(file, std::move(layout));
  }
  const bool swapped = header.format == PlyFormat::big_endian;
  if (vertex.has_lists()) {
    return std::make_unique<ListRecords>(file, cursor.offset(), vertex, swapped, wanted);
  }
  BinaryLayout layout;
  layout.begin = cursor.offset();
  layout.count = vertex.count;
  layout.swapped = swapped;
  for (std::size_t i = 0; i < vertex.properties.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      if (wanted[k] == i) {
        layout.field[k] = {layout.stride, vertex.properties[i].type};
      }
    }
    layout.stride += size_of(vertex.properties[i].type);
  }
  return std::make_unique<BinaryRecords>(file, layout);
}

}  // namespace

Opened open_ply(const InputFile& file) {
  const auto header = read_ply_header(file);
  if (!header) {
    return tl::make_unexpected(header.error());
  }
  for (std::size_t i = 0; i < header->elements.size(); ++i) {
    if (header->elements[i].name == "vertex") {
      return source_of(file, *header, i);
    }
  }
  return tl::make_unexpected(file.path().string() + " is a PLY file without an element \"vertex\"; export it again");
}

}  // namespace celadon
