#pragma once
// The board on the turning table: what shows when frames are exposed. acquisition/calibrate/README.md, (14) to (16).

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibrate/calibration_views.h"
#include "daemon/frame_feed.h"

namespace celadon {

struct PassTools {
  const ScanEquipment& equipment;
  FrameFeed& feed;
  /// Corners of the board in a frame's bytes; empty where it is not found.
  std::function<std::vector<SeenCorner>(std::span<const std::uint8_t>)> find;
};

/// The board of a placement passes the camera forwards and backwards, fast and slowly, then fast with a shorter
/// exposure, which is the usual one again on every way out. Passes that show no board have no views.
/// @param middle_rad, half_width_rad  of the encoder, where the board is seen
tl::expected<std::vector<BoardSweep>, ScanStop> take_passes(const PassTools& tools, int placement, double middle_rad,
                                                            double half_width_rad);

}  // namespace celadon
