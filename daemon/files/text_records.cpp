#include "daemon/files/text_records.h"

#include <algorithm>

#include "daemon/files/file_problem.h"

namespace celadon {

TextRecords::TextRecords(const InputFile& file, TextLayout layout)
    : file_(file), layout_(std::move(layout)), cursor_(file, layout_.begin, file.size()) {
  last_column_ = *std::max_element(layout_.column.begin(), layout_.column.end());
  line_ = layout_.line;
}

void TextRecords::rewind() {
  cursor_ = ByteCursor(file_, layout_.begin, file_.size());
  line_ = layout_.line;
  records_ = 0;
  error_.clear();
}

bool TextRecords::fail(const std::string& what) {
  error_ = file_.path().string() + " line " + grouped(line_) + ": " + what;
  return false;
}

bool TextRecords::parse(std::string_view line, std::array<double, 3>& values) {
  std::string_view rest = line;
  std::size_t property = 0;
  const std::size_t properties = layout_.lists.empty() ? last_column_ + 1 : layout_.lists.size();
  for (; property < properties && property <= last_column_; ++property) {
    const auto field = take_field(rest, layout_.separator);
    if (!field) {
      return fail("it has " + std::to_string(property) + " values, " + std::to_string(last_column_ + 1) +
                  " are needed; delete the line or export the cloud again");
    }
    if (!layout_.lists.empty() && layout_.lists[property]) {
      const auto items = parse_number(*field);
      if (!items || !(*items >= 0) || *items > static_cast<double>(line.size())) {
        return fail(in_quotes(*field) + " is not the length of a list; export the cloud again");
      }
      for (auto i = static_cast<std::size_t>(*items); i > 0; --i) {
        take_field(rest, layout_.separator);
      }
      continue;
    }
    for (std::size_t k = 0; k < 3; ++k) {
      if (layout_.column[k] != property) {
        continue;
      }
      const auto value = parse_number(*field);
      if (!value) {
        return fail(in_quotes(*field) + " is not a number (column " + std::to_string(property + 1) + ", " +
                    layout_.name[k] + "); correct or delete the line");
      }
      values[k] = *value;
    }
  }
  return true;
}

std::size_t TextRecords::read(std::size_t count, double* a, double* b, double* c) {
  std::size_t done = 0;
  std::string_view line;
  bool too_long = false;
  while (done < count && error_.empty() && (!layout_.promised || records_ < *layout_.promised)) {
    if (!cursor_.line(line, too_long)) {
      if (!file_.error().empty()) {
        error_ = file_.error();
      } else if (layout_.promised) {
        fail("the file ends after " + grouped(records_) + " points, its header promises " + grouped(*layout_.promised) +
             "; copy or export it again");
      }
      break;
    }
    if (too_long) {
      fail("it is longer than any record of a point cloud; the file is damaged or of another kind");
      break;
    }
    const std::size_t first = line.find_first_not_of(" \t");
    if (first == std::string_view::npos || (layout_.comments && line[first] == '#')) {
      ++line_;
      continue;
    }
    std::array<double, 3> values;
    if (!parse(line, values)) {
      break;
    }
    a[done] = values[0];
    b[done] = values[1];
    c[done] = values[2];
    ++done;
    ++records_;
    ++line_;
  }
  return done;
}

}  // namespace celadon
