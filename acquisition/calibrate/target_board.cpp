#include "acquisition/calibrate/target_board.h"

#include <charconv>
#include <cstdio>
#include <string_view>
#include <system_error>

namespace celadon {
namespace {

constexpr std::string_view kChessboardWord = "chessboard:", kTagsWord = "tags:";
constexpr int kFewest = 3, kMost = 60;
constexpr double kLargest_mm = 1000;

constexpr const char* kGrammar =
    "write chessboard:COLUMNSxROWSxSQUARE or tags:COLUMNSxROWSxSQUARE+FIRST_TAG, for example chessboard:11x8x8 "
    "or tags:10x7x12 (squares of 12 mm)";

template <class Number>
bool take(std::string_view& text, Number& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc()) return false;
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  return true;
}

bool take(std::string_view& text, char letter) {
  if (text.empty() || text.front() != letter) return false;
  text.remove_prefix(1);
  return true;
}

int tags_on(int columns, int rows) {
  return columns * rows / 2;  // the upper left square is black: of an odd number one more is black
}

}  // namespace

tl::expected<TargetBoard, std::string> TargetBoard::parse(const std::string& text) {
  std::string_view rest = text;
  const bool tags = rest.starts_with(kTagsWord);
  if (!tags && !rest.starts_with(kChessboardWord)) {
    return tl::unexpected("board \"" + text + "\" is neither a chessboard nor a tag board; " + kGrammar);
  }
  rest.remove_prefix(tags ? kTagsWord.size() : kChessboardWord.size());
  int columns = 0, rows = 0, first_tag = 0;
  double square_mm = 0;
  bool good = take(rest, columns) && take(rest, 'x') && take(rest, rows) && take(rest, 'x') && take(rest, square_mm);
  if (good && tags && !rest.empty()) good = take(rest, '+') && take(rest, first_tag);
  if (!good || !rest.empty()) return tl::unexpected("board \"" + text + "\" can not be read; " + kGrammar);
  const auto wrong = [&](const std::string& what) { return tl::unexpected("board \"" + text + "\" " + what); };
  if (columns < kFewest || rows < kFewest || columns > kMost || rows > kMost) {
    return wrong("has " + std::to_string(columns) + " x " + std::to_string(rows) +
                 " squares; take 3 to 60 columns and rows");
  }
  if (!(square_mm > 0 && square_mm <= kLargest_mm)) {
    return wrong("has a square outside 0 to 1000 mm; give its side in millimetres");
  }
  if (!tags && (columns + rows) % 2 == 0) {
    return wrong("looks the same upside down, because columns + rows is " + std::to_string(columns + rows) +
                 "; add or leave out one column");
  }
  if (tags && (first_tag < 0 || first_tag > kTagFamilySize - tags_on(columns, rows))) {
    return wrong("needs tags " + std::to_string(first_tag) + " to " +
                 std::to_string(static_cast<long long>(first_tag) + tags_on(columns, rows) - 1) +
                 ", and the family has 0 to " + std::to_string(kTagFamilySize - 1) +
                 "; take fewer squares or another first tag");
  }
  return TargetBoard(columns, rows, square_mm, tags, first_tag);
}

TargetBoard::TargetBoard(int columns, int rows, double square_mm, bool tags, int first_tag)
    : columns_(columns), rows_(rows), square_mm_(square_mm), tags_(tags), first_tag_(first_tag) {
  for (int row = 1; row < rows; ++row) {
    for (int column = 1; column < columns; ++column) {
      const Eigen::Vector2d p(column - 0.5 * columns, row - 0.5 * rows);
      corners_.push_back({static_cast<int>(corners_.size()), p * square_mm});
    }
  }
}

std::string TargetBoard::text() const {
  char square[32];
  const auto [end, error] = std::to_chars(square, square + sizeof square, square_mm_);
  std::string out(tags_ ? kTagsWord : kChessboardWord);
  out += std::to_string(columns_) + "x" + std::to_string(rows_) + "x";
  out.append(square, error == std::errc() ? end : square);
  if (tags_ && first_tag_ != 0) {
    out += '+';
    out += std::to_string(first_tag_);
  }
  return out;
}

int TargetBoard::tag_at(int column, int row) const {
  if (!tags_ || (column + row) % 2 == 0) return -1;
  // Squares before this one, row by row: every second of them is white, the second of the board the first.
  return first_tag_ + (row * columns_ + column - (columns_ % 2 == 0 && row % 2 == 1 ? 0 : 1)) / 2;
}

}  // namespace celadon
