#include "sim/target.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>

#include <cmath>
#include <memory>

namespace celadon::sim {
namespace {

constexpr int kTagCells = 8, kQuietCells = 1;  // the black square; white around it

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

Target Target::chessboard() {
  constexpr int kColumns = 11, kRows = 8;
  Target target(kColumns + 2, kRows + 2, 8);
  for (int row = 0; row < kRows; ++row) {
    for (int column = row % 2; column < kColumns; column += 2) target.ink(column + 1, row + 1);
  }
  for (int row = 1; row < kRows; ++row) {
    for (int column = 1; column < kColumns; ++column) {
      target.corners_.push_back({0, static_cast<int>(target.corners_.size()), target.at(column + 1, row + 1)});
    }
  }
  return target;
}

// The tag's white border begins at (column, row).
void Target::add_tag(int id, int column, int row) {
  const std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)> family(tag36h11_create(), tag36h11_destroy);
  const int left = column + kQuietCells, top = row + kQuietCells, right = left + kTagCells, bottom = top + kTagCells;
  for (int y = top; y < bottom; ++y) {
    for (int x = left; x < right; ++x) ink(x, y);
  }
  // A code's bits, the highest first, are the white cells.
  const std::uint64_t code = family->codes[id];
  for (std::uint32_t i = 0; i < family->nbits; ++i) {
    if ((code >> (family->nbits - 1 - i) & 1) == 0) continue;
    const int x = left + static_cast<int>(family->bit_x[i]), y = top + static_cast<int>(family->bit_y[i]);
    cells_[static_cast<std::size_t>(y * columns_ + x)] = 0;
  }
  corners_.push_back({id, 0, at(left, bottom)});
  corners_.push_back({id, 1, at(right, bottom)});
  corners_.push_back({id, 2, at(right, top)});
  corners_.push_back({id, 3, at(left, top)});
}

Target Target::tag_grid() {
  constexpr int kTags = 5, kTagRows = 4, kStep = 11;  // cells: three white ones between two tags
  Target target(kTags * kStep + 1, kTagRows * kStep + 1, 1.5);
  for (int i = 0; i < kTags * kTagRows; ++i) target.add_tag(i, i % kTags * kStep, i / kTags * kStep);
  return target;
}

Target Target::tag(int id, double size_mm) {
  Target target(kTagCells + 2 * kQuietCells, kTagCells + 2 * kQuietCells, size_mm / kTagCells);
  target.add_tag(id, 0, 0);
  return target;
}

}  // namespace celadon::sim
