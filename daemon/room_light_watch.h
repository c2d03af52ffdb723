#pragma once
// How the room's light changes while a scan runs: frames away from the laser's line against the background that is
// subtracted from them. README.md, "The room's light".

#include <cstdint>
#include <deque>
#include <span>

#include "acquisition/frame.h"
#include "acquisition/laser_line.h"
#include "daemon/checks/self_check.h"

namespace celadon {

struct RoomLightReading {
  std::uint64_t frames = 0;  ///< compared
  double change_levels = 0;  ///< the largest that several frames in a row had, brighter positive
  double at_rad = 0;         ///< where it does, turned since the first profile
  int renewed_backgrounds = 0;
};

class RoomLightWatch {
 public:
  /// By how many grey levels a frame is brighter than the background: the mean of the middle half of the differences at
  /// places away from the line. 0 without a background.
  /// @param rows  the line in each row (column) of the picture
  double see(const CameraMode& mode, std::span<const std::uint8_t> frame, std::span<const std::uint8_t> background,
             std::span<const LineRow> rows, LineAlong along, double turned_rad);
  /// The frames to come have a background of their own.
  void renewed();
  const RoomLightReading& reading() const { return reading_; }

 private:
  RoomLightReading reading_;
  std::deque<double> last_levels_;  ///< of frames with the present background
};

/// In step mode the background is taken anew once a frame differs by so much from it.
constexpr double kRenewBackground_levels = 2;

/// The check `room_light`. @param bright_level  of the laser's line, grey levels
SelfCheck room_light_check(const RoomLightReading& reading, double bright_level);

}  // namespace celadon
