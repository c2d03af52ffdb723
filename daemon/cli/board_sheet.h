#pragma once
// A calibration board as a sheet to print at true size.

#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibrate/target_board.h"

namespace celadon::cli {

/// Millimetres from the page's upper left corner, x to the right, y down.
struct SheetRectangle {
  double x = 0, y = 0, width = 0, height = 0;
};
struct SheetText {
  double x = 0, y = 0;   ///< left end of the base line
  bool upwards = false;  ///< turned by 90 degrees counter-clockwise
  std::string text;      ///< ASCII
};

struct BoardSheet {
  static constexpr double kText_mm = 2.8;  ///< size of the letters

  std::string page;  ///< "A4" ...
  double width_mm = 0, height_mm = 0;
  /// One area by the even-odd rule: squares, tags with their white cells as holes, marks of the rulers. So no renderer
  /// leaves seams between cells.
  std::vector<SheetRectangle> black;
  std::vector<SheetText> texts;
};

/// The board with a white margin of half a square at least, a ruler of 100 mm along x below and one along y on its
/// left, and what to do with it, on the smallest of A4, A3, A2, A1 and A0, upright or across, that holds it all.
/// Errors: one sentence, if none does.
tl::expected<BoardSheet, std::string> lay_out_board(const TargetBoard& board);

/// Fiducials for the platter's rim to cut out, "rim:12x11" or "rim:12x11+100": count x side of a tag's black square in
/// mm, first number. Errors: one sentence.
tl::expected<BoardSheet, std::string> lay_out_rim_tags(const std::string& text);

std::string svg_of(const BoardSheet& sheet);
/// PDF 1.4 with the standard font Helvetica.
std::string pdf_of(const BoardSheet& sheet);

}  // namespace celadon::cli
