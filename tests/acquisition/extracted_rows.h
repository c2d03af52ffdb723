#pragma once
// The rows of one frame, by an extractor of its own.

#include <span>
#include <vector>

#include "acquisition/laser_line.h"

namespace celadon {

inline std::vector<LineRow> extract(const CameraMode& mode, std::span<const std::uint8_t> on,
                                    std::span<const std::uint8_t> off = {}, const LaserLineOptions& options = {}) {
  std::vector<LineRow> rows(static_cast<std::size_t>(mode.height_px));
  LaserLineExtractor(options).extract(mode, on, off, rows);
  return rows;
}

}  // namespace celadon
