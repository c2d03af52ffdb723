#include "acquisition/calibrate/target_board.h"

namespace celadon {

TargetBoard::TargetBoard(int columns, int rows, double square_mm, bool tags, int first_tag)
    : columns_(columns), rows_(rows), square_mm_(square_mm), tags_(tags), first_tag_(first_tag) {
  for (int row = 1; row < rows; ++row) {
    for (int column = 1; column < columns; ++column) {
      corners_.push_back(
          {static_cast<int>(corners_.size()), square_mm * Eigen::Vector2d(column - 0.5 * columns, row - 0.5 * rows)});
    }
  }
}

}  // namespace celadon
