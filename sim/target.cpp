#include "sim/target.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>

#include <charconv>
#include <cmath>
#include <memory>
#include <string>

namespace celadon::sim {
namespace {

constexpr int kTagCells = 8, kQuietCells = 1;  // the black square; white around it
constexpr int kFamilySize = 587;
// Of a board's square: whole cells for half of it, and for a tag of three quarters of it with its 8 cells.
constexpr int kPlainCells = 2, kSquareCells = 32, kTagUnit = 3;

struct BoardText {
  int columns = 0, rows = 0, first_tag = 0;
  double square_mm = 0;
};

// "11x8x8" or, with tags, "11x8x8+40".
bool parse_board(std::string_view text, bool tags, BoardText& board) {
  const char *at = text.data(), *const end = at + text.size();
  const auto number = [&](auto& value) {
    const auto [next, error] = std::from_chars(at, end, value);
    at = next;
    return error == std::errc();
  };
  const auto letter = [&](char c) { return at != end && *at++ == c; };
  if (!(number(board.columns) && letter('x') && number(board.rows) && letter('x') && number(board.square_mm)))
    return false;
  if (at == end) return true;
  return tags && letter('+') && number(board.first_tag) && at == end;
}

}  // namespace

Target::Target(int columns, int rows, double cell_mm)
    : columns_(columns), rows_(rows), cell_mm_(cell_mm), cells_(static_cast<std::size_t>(columns * rows), 0) {}

Eigen::Vector2d Target::at(int column, int row) const {
  return {(column - 0.5 * columns_) * cell_mm_, (row - 0.5 * rows_) * cell_mm_};
}

double Target::reflectance(double x_mm, double y_mm) const {
  const double column = std::floor(x_mm / cell_mm_ + 0.5 * columns_), row = std::floor(y_mm / cell_mm_ + 0.5 * rows_);
  if (!(column >= 0 && row >= 0 && column < columns_ && row < rows_)) return 0;
  const auto cell = static_cast<std::size_t>(static_cast<int>(row) * columns_ + static_cast<int>(column));
  return cells_[cell] != 0 ? kInk : kPaper;
}

void Target::fill(int column, int row, int width, int height, bool black) {
  for (int y = row; y < row + height; ++y) {
    for (int x = column; x < column + width; ++x) cells_[static_cast<std::size_t>(y * columns_ + x)] = black ? 1 : 0;
  }
}

tl::expected<Target, std::string> Target::board(std::string_view text) {
  const std::size_t colon = text.find(':');
  const std::string_view kind = text.substr(0, colon);
  const bool tags = kind == "tags";
  if (!tags && kind != "chessboard") {
    return tl::unexpected("board \"" + std::string(kind) + "\" is unknown; choose chessboard or tags");
  }
  BoardText board = tags ? BoardText{10, 7, 0, 12} : BoardText{11, 8, 0, 8};
  if (colon != std::string_view::npos) {
    if (!parse_board(text.substr(colon + 1), tags, board)) {
      return tl::unexpected("board \"" + std::string(text) +
                            "\" can not be read; write COLUMNSxROWSxSQUARE, with tags also +FIRST, for example "
                            "chessboard:11x8x8 or tags:10x7x12+40");
    }
    if (board.columns < 3 || board.rows < 3 || board.columns > 60 || board.rows > 60 ||
        !(board.square_mm >= 0.1 && board.square_mm <= 1000)) {
      return tl::unexpected("board \"" + std::string(text) +
                            "\" is beyond 3 to 60 columns and rows of squares of 0.1 to 1000 mm; choose within");
    }
    if (tags && (board.first_tag < 0 || board.first_tag > kFamilySize - board.columns * board.rows / 2)) {
      return tl::unexpected("board \"" + std::string(text) +
                            "\" needs tags beyond 0 to 586; take fewer squares or another first tag");
    }
    if (!tags && (board.columns + board.rows) % 2 == 0) {
      return tl::unexpected("board \"" + std::string(text) +
                            "\" looks the same upside down; add or leave out one column");
    }
  }
  return squares(board.columns, board.rows, board.square_mm, tags, board.first_tag);
}

Target Target::squares(int columns, int rows, double square_mm, bool tags, int first_tag) {
  const int side = tags ? kSquareCells : kPlainCells, margin = side / 2;
  Target target(columns * side + 2 * margin, rows * side + 2 * margin, square_mm / side);
  int tag = first_tag;
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const int x = margin + column * side, y = margin + row * side;
      if ((column + row) % 2 == 0) {
        target.fill(x, y, side, side, true);
      } else if (tags) {
        constexpr int kFree = (kSquareCells - kTagUnit * kTagCells) / 2;
        target.add_tag(tag++, x + kFree, y + kFree, kTagUnit);
      }
    }
  }
  target.corners_.clear();
  for (int row = 1; row < rows; ++row) {
    for (int column = 1; column < columns; ++column) {
      target.corners_.push_back(
          {0, static_cast<int>(target.corners_.size()), target.at(margin + column * side, margin + row * side)});
    }
  }
  return target;
}

// The tag's black square begins at (left, top).
void Target::add_tag(int id, int left, int top, int unit) {
  const std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)> family(tag36h11_create(), tag36h11_destroy);
  const int right = left + unit * kTagCells, bottom = top + unit * kTagCells;
  fill(left, top, unit * kTagCells, unit * kTagCells, true);
  // A code's bits, the highest first, are the white cells.
  const std::uint64_t code = family->codes[id];
  for (std::uint32_t i = 0; i < family->nbits; ++i) {
    if ((code >> (family->nbits - 1 - i) & 1) == 0) continue;
    fill(left + unit * static_cast<int>(family->bit_x[i]), top + unit * static_cast<int>(family->bit_y[i]), unit, unit,
         false);
  }
  corners_.push_back({id, 0, at(left, bottom)});
  corners_.push_back({id, 1, at(right, bottom)});
  corners_.push_back({id, 2, at(right, top)});
  corners_.push_back({id, 3, at(left, top)});
}

Target Target::tag(int id, double size_mm) {
  Target target(kTagCells + 2 * kQuietCells, kTagCells + 2 * kQuietCells, size_mm / kTagCells);
  target.add_tag(id, kQuietCells, kQuietCells, 1);
  return target;
}

}  // namespace celadon::sim
