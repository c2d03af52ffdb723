#pragma once
// Which of two peaks in a row is the laser line: the one that goes on where the other does not. README.md, "Line
// extraction", step 6.

#include <cstdint>
#include <span>
#include <vector>

#include "acquisition/laser_line.h"

namespace celadon {

/// Coarse peaks of a row, pixels; -1: none.
struct PeakPair {
  std::int16_t first_px = -1;   ///< the brighter
  std::int16_t second_px = -1;  ///< bright enough to be the line and the first its reflection
};

/// A row that is not what brightness alone made of it.
struct PeakChoice {
  int row = 0;
  int center_px = -1;  ///< coarse position of its line; -1: nobody can tell
};

/// Rows whose peak is chosen by continuity, in ascending order. `rows` holds what brightness alone found, `previous`
/// the rows of the frame before or nothing.
/// @pre peaks, rows and previous (unless empty) have one size
void choose_peaks(std::span<const PeakPair> peaks, std::span<const LineRow> rows, std::span<const LineRow> previous,
                  std::vector<PeakChoice>& choices);

}  // namespace celadon
