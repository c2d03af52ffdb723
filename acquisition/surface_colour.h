#pragma once
// Colour of the surface at the samples of a laser line, from the room's light beside it. README.md, "Colour".

#include <array>
#include <span>
#include <vector>

#include "acquisition/frame.h"
#include "acquisition/laser_line.h"
#include "acquisition/triangulation.h"
#include "fitting/profile.h"

namespace celadon {

/// Reads the colours beside a line while its frame is there, and gives them to the samples that are made of the line.
class SurfaceColour {
 public:
  /// @param along  as the rows to come are extracted
  SurfaceColour(const CameraMode& mode, LineAlong along);

  /// Whether the camera delivers colours. Without them read() and give() do nothing but to leave profiles without.
  bool there() const { return mode_.colour.layout != ColourLayout::none; }

  /// Beside each row that has a line: a window of four pixels on both sides, the nearer end four standard deviations of
  /// the line and two pixels from its middle. A side that leaves the picture, shows a saturated pixel or is darker than
  /// twelve levels in its brightest colour tells nothing: less is the black level and noise.
  /// @pre the frame is of the mode; rows are those of its picture
  void read(const Frame& frame, std::span<const LineRow> rows);

  /// Fills profile.colour, of samples made of the rows read last: the mean of both sides, which is centred on the
  /// sample; the one side of two that tells, at its own place; black where none does. A pixel whose ray passes the
  /// table's axis further away than the sample lies is not of the object, as long as that is round there.
  /// @pre profile.row names rows read last
  void give(const Triangulator& triangulator, Profile& profile) const;

 private:
  struct Side {
    bool tells = false;
    int outermost_px = 0;  ///< along the row, the end of the window that is further from the line
    LinearColour colour;
  };
  struct Window {
    int x0, x1, y0, y1;  ///< pixels x0 <= x < x1, y0 <= y < y1
  };
  Window window(std::size_t row, int from_px) const;
  Side side(const Frame& frame, std::size_t row, int from_px, int outermost_px) const;

  CameraMode mode_;
  LineAlong along_;
  std::vector<std::array<Side, 2>> sides_;  ///< of each row
};

}  // namespace celadon
