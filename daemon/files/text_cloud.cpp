#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <optional>
#include <vector>

#include "daemon/files/cloud_kinds.h"
#include "daemon/files/file_problem.h"
#include "daemon/files/text_records.h"

namespace celadon {
namespace {

std::string lower_case(std::string_view text) {
  std::string lower(text);
  std::transform(lower.begin(), lower.end(), lower.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return lower;
}

/// Fields of a header, without quotation marks, in lower case.
std::vector<std::string> names_of(std::string_view line, Separator separator) {
  std::vector<std::string> names;
  while (const auto field = take_field(line, separator)) {
    std::string name = lower_case(*field);
    if (name.size() >= 2 && name.front() == '"' && name.back() == '"') {
      name = name.substr(1, name.size() - 2);
    }
    names.push_back(std::move(name));
  }
  return names;
}

/// Columns of three names, if all are there.
std::optional<std::array<std::size_t, 3>> columns_of(const std::vector<std::string>& names,
                                                     const std::array<std::string, 3>& wanted) {
  std::array<std::size_t, 3> columns{};
  for (std::size_t k = 0; k < 3; ++k) {
    const auto found = std::find(names.begin(), names.end(), wanted[k]);
    if (found == names.end()) {
      return std::nullopt;
    }
    columns[k] = static_cast<std::size_t>(found - names.begin());
  }
  return columns;
}

/// Takes the columns a header names; false if it names none of the triples.
bool take_header(std::string_view line, TextLayout& layout, CloudColumns& columns) {
  struct Triple {
    std::array<std::string, 3> names;
    CloudColumns columns;
  };
  static const Triple triples[] = {{{"r", "theta", "z"}, CloudColumns::cylindrical},
                                   {{"rho", "phi", "theta"}, CloudColumns::spherical},
                                   {{"x", "y", "z"}, CloudColumns::cartesian}};
  const auto names = names_of(line, separator_of(line));
  for (const Triple& triple : triples) {
    if (const auto found = columns_of(names, triple.names)) {
      layout.column = *found;
      if (triple.columns != CloudColumns::cartesian) layout.name = triple.names;
      columns = triple.columns;
      return true;
    }
  }
  return false;
}

}  // namespace

Opened open_text(const InputFile& file, CloudColumns& columns) {
  columns = CloudColumns::cartesian;
  TextLayout layout;
  layout.comments = true;
  char mark[3] = {};
  const bool byte_order_mark =
      file.read_at(0, mark, 3) == 3 && mark[0] == '\xEF' && mark[1] == '\xBB' && mark[2] == '\xBF';
  ByteCursor cursor(file, byte_order_mark ? 3 : 0, file.size(), 1U << 16);
  layout.begin = cursor.offset();
  const auto wrong = [&](const std::string& what) {
    return tl::make_unexpected(file.path().string() + " line " + grouped(layout.line) + ": " + what);
  };
  bool header_seen = false;
  std::string_view line;
  bool too_long = false;
  for (; cursor.line(line, too_long); ++layout.line, layout.begin = cursor.offset()) {
    if (too_long || line.find('\0') != std::string_view::npos) {
      return wrong("this is not text; the file is none of PLY, PCD, XYZ and CSV: export it as one of them");
    }
    std::string_view rest = line.substr(std::min(line.size(), line.find_first_not_of(" \t")));
    if (rest.empty()) {
      continue;
    }
    if (rest.front() == '#') {
      // A commented header, as many programs write it, is a header all the same.
      header_seen = take_header(rest.substr(1), layout, columns) || header_seen;
      continue;
    }
    layout.separator = separator_of(line);
    std::string_view fields = line;
    const auto first = take_field(fields, layout.separator);
    if (first && parse_number(*first)) {
      return std::make_unique<TextRecords>(file, std::move(layout));
    }
    if (header_seen) {
      return wrong(in_quotes(line) + " is not a record of numbers; correct or delete the line");
    }
    header_seen = true;
    const auto names = names_of(line, layout.separator);
    const bool some_number =
        std::any_of(names.begin(), names.end(), [](const auto& n) { return parse_number(n).has_value(); });
    if (!take_header(line, layout, columns) && (names.size() < 3 || some_number)) {
      return wrong(in_quotes(line) +
                   " is neither a header of column names nor three numbers; the file is none of PLY, " +
                   "PCD, XYZ and CSV, or damaged");
    }
  }
  if (!file.error().empty()) {
    return tl::make_unexpected(file.error());
  }
  return tl::make_unexpected(file.path().string() + " holds no points, only a header or comments; export it again");
}

}  // namespace celadon
