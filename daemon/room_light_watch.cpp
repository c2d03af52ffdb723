#include "daemon/room_light_watch.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>

namespace celadon {
namespace {

constexpr int kPitch_px = 24;       // of the places that are compared
constexpr float kFromLine_px = 40;  // a line's glow is no light of the room
constexpr int kFewestBesideLine = 100;
constexpr std::size_t kInARow = 4;   // frames: a lamp stays on for longer
constexpr double kLeast_levels = 6;  // less than this hardly adds noise
constexpr double kOfLine = 0.1;      // of the line's brightness

/// Mean of the middle half of whole numbers from -255 to 255.
class MiddleHalf {
 public:
  void add(int difference) {
    ++counts_[static_cast<std::size_t>(difference + 255)];
    ++total_;
  }
  int count() const { return total_; }
  double mean() const {
    const double from = 0.25 * total_, to = 0.75 * total_;
    double below = 0, sum = 0;
    for (std::size_t i = 0; i < counts_.size(); ++i) {
      const double above = below + counts_[i];
      sum += std::max(0.0, std::min(above, to) - std::max(below, from)) * (static_cast<double>(i) - 255);
      below = above;
    }
    return sum / (to - from);
  }

 private:
  std::array<int, 511> counts_{};
  int total_ = 0;
};

}  // namespace

double RoomLightWatch::see(const CameraMode& mode, std::span<const std::uint8_t> frame,
                           std::span<const std::uint8_t> background, std::span<const LineRow> rows, LineAlong along,
                           double turned_rad) {
  if (background.size() != frame.size()) return 0;
  const std::size_t step = bytes_per_pixel(mode.format);
  MiddleHalf differences;
  for (int y = kPitch_px / 2; y < mode.height_px; y += kPitch_px) {
    for (int x = kPitch_px / 2; x < mode.width_px; x += kPitch_px) {
      const LineRow& row = rows[static_cast<std::size_t>(along == LineAlong::rows ? y : x)];
      const auto across = static_cast<float>(along == LineAlong::rows ? x : y);
      if (row.x_px >= 0 && std::abs(row.x_px - across) < kFromLine_px) continue;
      const std::size_t at = static_cast<std::size_t>(y) * mode.stride_bytes + static_cast<std::size_t>(x) * step;
      differences.add(static_cast<int>(frame[at]) - static_cast<int>(background[at]));
    }
  }
  if (differences.count() < kFewestBesideLine) return 0;
  const double change = differences.mean();
  ++reading_.frames;
  last_levels_.push_back(change);
  if (last_levels_.size() > kInARow) last_levels_.pop_front();
  const auto [least, most] = std::minmax_element(last_levels_.begin(), last_levels_.end());
  const double lasting = *least > 0 ? *least : *most < 0 ? *most : 0;
  if (last_levels_.size() == kInARow && std::abs(lasting) > std::abs(reading_.change_levels)) {
    reading_.change_levels = lasting;
    reading_.at_rad = turned_rad;
  }
  return change;
}

void RoomLightWatch::renewed() {
  ++reading_.renewed_backgrounds;
  last_levels_.clear();
}

SelfCheck room_light_check(const RoomLightReading& reading, double bright_level) {
  SelfCheck check{"room_light", "grey levels", {}, {}, {}, CheckVerdict::not_verifiable, {}, {}, {}};
  if (reading.frames == 0) {
    check.note = "no frame was compared with a background";
    return check;
  }
  char text[160];
  std::snprintf(text, sizeof text, "largest change of the picture beside the line since the laser was off%s",
                reading.renewed_backgrounds > 0 ? ", which was looked at again as the light changed" : "");
  check.note = text;
  check.value = reading.change_levels;
  check.limit = std::max(kLeast_levels, kOfLine * bright_level);
  check.verdict = CheckVerdict::passed;
  if (std::abs(reading.change_levels) <= *check.limit) return check;
  check.verdict = CheckVerdict::failed;
  std::snprintf(text, sizeof text, "the room became %s %.0f degrees after the start",
                reading.change_levels > 0 ? "brighter" : "darker", reading.at_rad * 180 / std::numbers::pi);
  check.cause = text;
  check.remedy = "keep lamps and daylight as they are during a scan, or scan in steps, which look again";
  return check;
}

}  // namespace celadon
