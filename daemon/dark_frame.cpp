#include "daemon/dark_frame.h"

#include "acquisition/laser_line.h"

namespace celadon {
namespace {

constexpr std::int64_t kFrameLimit_ns = 250'000'000;
constexpr int kMostFrames = 20;  // those that wait in the driver's buffers come first
constexpr double kRowShare = 0.5, kBrightnessShare = 1. / 3;
constexpr double kBackgroundShare = 0.25;  // of the picture's rows: nothing else is so long

std::string shines(int rows, const std::string& frame) {
  return frame + " shows the laser's line in " + std::to_string(rows) +
         " rows: the laser emits although it is switched off. Its enable is dropped; cut the power at the machine.";
}

}  // namespace

std::optional<std::string> light_although_off(FrameSource& camera, const Triangulator& triangulator,
                                              const ScanPreparation& seen, std::int64_t dark_since_ns,
                                              double turn_rad) {
  for (int k = 0; k < kMostFrames; ++k) {
    auto frame = camera.next(kFrameLimit_ns);
    if (!frame) return std::nullopt;
    const FrameInfo& info = frame->info;
    if (info.corrupt || triangulator.row_instant_ns(info, 0) - info.exposure_ns / 2 < dark_since_ns) continue;
    LaserLineExtractor extractor({.along = triangulator.along()});
    std::vector<LineRow> rows(triangulator.line_count());
    extractor.extract(camera.mode(), frame->bytes(), seen.backgrounds.of(info.exposure_ns, turn_rad), rows);
    const LineBrightness now = brightness_of(rows);
    // At a shorter exposure than before the same light is darker.
    const double as_exposed = seen.exposure_ns > info.exposure_ns && info.exposure_ns > 0
                                  ? static_cast<double>(info.exposure_ns) / static_cast<double>(seen.exposure_ns)
                                  : 1;
    if (now.lines < kRowShare * seen.line.lines || now.amplitude < kBrightnessShare * as_exposed * seen.line.amplitude)
      return std::nullopt;
    return shines(now.lines, "A frame taken after the laser was switched off");
  }
  return std::nullopt;
}

std::optional<std::string> light_in_background(const CameraMode& mode, std::span<const std::uint8_t> background,
                                               LineAlong along) {
  LaserLineExtractor extractor({.along = along});
  std::vector<LineRow> rows(static_cast<std::size_t>(along == LineAlong::rows ? mode.height_px : mode.width_px));
  extractor.extract(mode, background, {}, rows);
  const LineBrightness line = brightness_of(rows);
  if (line.lines < kBackgroundShare * static_cast<double>(rows.size())) return std::nullopt;
  return shines(line.lines, "The picture taken with the laser switched off");
}

}  // namespace celadon
