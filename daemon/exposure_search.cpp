#include "daemon/exposure_search.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <utility>

#include "daemon/dark_turn.h"
#include "daemon/peak_survey.h"
#include "daemon/scan_preparation.h"
#include "daemon/table_turn.h"

namespace celadon {
namespace {

constexpr int kMostPasses = 5;
constexpr double kShorter = 1. / 8;  // passes overlap: a line of 25 levels is measured as well as one of 200
constexpr double kOfPeriod = 0.95;   // of the frame period; the rest is the sensor's
constexpr double kRoomMost = 100;    // grey levels of the picture with the laser off
constexpr double kRoomShare = 0.95;  // of its places, which are darker than what counts
constexpr double kTaken = 0.1;       // relative, by which an exposure in force may differ from the one asked for
constexpr std::int64_t kShortest_ns = 20'000;

ScanStop exposure_failed(const std::string& reason) {
  return {ScanState::failed, reason, false, false};
}

/// Where the exposure cannot be set, in a sentence that names control and errno.
ScanStop refused_by_camera(ScanStop stop) {
  if (!stop.camera_lost)
    stop.reason =
        "A scan with the exposure auto needs a camera whose exposure can be set; give a number of milliseconds, or "
        "0. " +
        stop.reason;
  return stop;
}

/// Grey level that most of a picture's places are darker than; of every 7th pixel in every 7th row.
double room_levels(const CameraMode& mode, std::span<const std::uint8_t> picture) {
  constexpr int kPitch = 7;
  std::array<double, 256> counts{};
  double all = 0, below = 0;
  for (int y = 0; y < mode.height_px; y += kPitch) {
    for (int x = 0; x < mode.width_px; x += kPitch) {
      ++counts[picture[static_cast<std::size_t>(y) * mode.stride_bytes +
                       static_cast<std::size_t>(x) * bytes_per_pixel(mode.format)]];
      ++all;
    }
  }
  std::size_t level = 0;
  while (level < 255 && (below += counts[level]) < kRoomShare * all) ++level;
  return static_cast<double>(level);
}

double milliseconds_of(std::int64_t ns) {
  return static_cast<double>(ns) * 1e-6;
}

std::string text_of_ms(double ms) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g ms", ms);
  return text;
}

class Search {
 public:
  Search(const ScanEquipment& equipment, FrameFeed& feed, const LaserTurn& turn)
      : equipment_(equipment), feed_(feed), turn_(turn), layout_(equipment, kQuickProfiles) {}

  tl::expected<ExposureChoice, ScanStop> find() {
    const double begin_rad = feed_.status().angle_rad;
    const double end_rad = begin_rad + way_of_sweep(equipment_, layout_).whole_rad;
    if (!turn_fits_travel(equipment_, end_rad)) {
      return tl::make_unexpected(exposure_failed("The quick turn that finds the exposure needs the table to turn to " +
                                                 degrees_text(end_rad) + ", but its travel ends at " +
                                                 degrees_text(equipment_.device->capabilities().travel_rad) +
                                                 "; home it, or give the exposure in milliseconds."));
    }
    if (auto set = set_longest(); !set) return tl::make_unexpected(set.error());
    // Steady and warm, by what the longest exposure shows.
    auto seen = look_at_object(equipment_, feed_, turn_.triangulator, everywhere());
    if (!seen) return tl::make_unexpected(seen.error());
    Backgrounds backgrounds = std::move(seen->backgrounds);
    limits_.longest_ms = limits_.shortest_ms = milliseconds_of(feed_.exposure_in_force_ns());
    for (int passes = 1;; ++passes) {
      if (auto passed = pass(backgrounds); !passed) return tl::make_unexpected(passed.error());
      if (auto off = feed_.laser_off(); !off) return tl::make_unexpected(off.error());
      if (auto rested = feed_.come_to_rest(); !rested) return tl::make_unexpected(rested.error());
      if (auto back = go_back(begin_rad); !back) return tl::make_unexpected(back.error());
      if (passes == kMostPasses || !survey_.asks_for_another()) break;
      const auto shorter = set_shorter();
      if (!shorter) return tl::make_unexpected(shorter.error());
      if (!*shorter) break;
      auto dark = dark_turn(equipment_, feed_, turn_.triangulator, everywhere());
      if (!dark) return tl::make_unexpected(dark.error());
      backgrounds = std::move(*dark);
      if (auto on = feed_.laser_on(); !on) return tl::make_unexpected(on.error());
      if (auto warm = feed_.next_after(feed_.shining_since_ns()); !warm) return tl::make_unexpected(warm.error());
    }
    const auto peaks = survey_.reading();
    if (std::all_of(peaks.begin(), peaks.end(), [](const PeakHistogram& p) { return p.weight() == 0; })) {
      return tl::make_unexpected(
          exposure_failed("The quick turn that finds the exposure saw no line in the volume of the scanner; place the "
                          "object over the middle of the table."));
    }
    if (!reached_shortest_) limits_.shortest_ms = std::min(limits_.shortest_ms, milliseconds_of(kShortest_ns));
    return choose_exposures(peaks, limits_);
  }

 private:
  /// The exposure in force, all around.
  ExposurePlan everywhere() const {
    std::array<std::int64_t, ExposurePlan::kSectors> exposures_ns;
    exposures_ns.fill(asked_ns_);
    return ExposurePlan(exposures_ns);
  }
  tl::expected<void, ScanStop> expose(std::int64_t exposure_ns) {
    asked_ns_ = exposure_ns;
    auto exposed = feed_.expose_for(exposure_ns);
    if (!exposed) return tl::make_unexpected(refused_by_camera(exposed.error()));
    return {};
  }

  /// The longest exposure that the frame period and the room's light allow.
  tl::expected<void, ScanStop> set_longest() {
    const std::int64_t period_ns = equipment_.camera.mode().frame_period_ns;
    if (period_ns <= 0) {
      return tl::make_unexpected(exposure_failed(
          "The camera does not tell its frame period, so that its longest exposure is not known; give the exposure in "
          "milliseconds."));
    }
    if (auto off = feed_.laser_off(); !off) return off;
    double asked_ns = kOfPeriod * static_cast<double>(period_ns);
    if (auto exposed = expose(std::llround(kShorter * asked_ns)); !exposed) return exposed;
    const std::int64_t short_ns = feed_.exposure_in_force_ns();
    if (auto exposed = expose(std::llround(asked_ns)); !exposed) return exposed;
    const std::int64_t long_ns = feed_.exposure_in_force_ns();
    if (static_cast<double>(long_ns) < (1 + kTaken) * static_cast<double>(short_ns)) {
      return tl::make_unexpected(exposure_failed(
          "The camera keeps its exposure of " + text_of_ms(milliseconds_of(long_ns)) + " whatever is asked for (" +
          text_of_ms(kShorter * asked_ns * 1e-6) + " and " + text_of_ms(asked_ns * 1e-6) +
          "): set one on the camera itself and scan with the exposure 0, as it stands."));
    }
    for (int tries = 0; tries < kMostPasses; ++tries) {
      auto picture = dark_background(feed_, equipment_.clock);
      if (!picture) return tl::make_unexpected(picture.error());
      const double room = room_levels(equipment_.camera.mode(), *picture);
      limits_.room_levels_per_ms = room / milliseconds_of(feed_.exposure_in_force_ns());
      if (room <= kRoomMost) return {};
      limits_.room_limits = true;
      asked_ns *= std::min(0.8, kRoomMost / room);
      if (auto exposed = expose(std::llround(asked_ns)); !exposed) return exposed;
    }
    return {};
  }

  /// @returns whether the camera exposes for a shorter time now
  tl::expected<bool, ScanStop> set_shorter() {
    const double before_ns = static_cast<double>(feed_.exposure_in_force_ns());
    const std::int64_t asked_ns = std::max<std::int64_t>(kShortest_ns, std::llround(kShorter * before_ns));
    if (auto exposed = expose(asked_ns); !exposed) return tl::make_unexpected(exposed.error());
    const double now_ns = static_cast<double>(feed_.exposure_in_force_ns());
    if (now_ns > (1 - kTaken) * before_ns) {
      reached_shortest_ = true;
      return false;
    }
    limits_.shortest_ms = now_ns * 1e-6;
    reached_shortest_ = now_ns > (1 + kTaken) * static_cast<double>(asked_ns) || asked_ns == kShortest_ns;
    return true;
  }

  tl::expected<void, ScanStop> pass(const Backgrounds& backgrounds) {
    const CameraMode& mode = equipment_.camera.mode();
    const double exposure_ms = milliseconds_of(feed_.exposure_in_force_ns());
    survey_.begin_pass(exposure_ms, limits_.room_levels_per_ms * exposure_ms);
    LaserLineExtractor extractor({.along = turn_.triangulator.along()});
    std::vector<LineRow> rows(turn_.triangulator.line_count());
    Profile profile;
    const auto take = [&](Frame frame, const FrameAngle& angle, double) -> tl::expected<void, ScanStop> {
      const FrameInfo info = frame.info;
      extractor.extract(mode, frame.bytes(),
                        backgrounds.of(info.exposure_ns, angle.middle.angle_rad / layout_.encoder_per_true), rows);
      frame.release();
      turn_.triangulator.triangulate(
          rows, info, [&](std::int64_t ns) { return angle.at(ns); }, profile);
      survey_.see(rows, profile, angle.middle.angle_rad / layout_.encoder_per_true);
      return {};
    };
    return sweep_table(equipment_, feed_, layout_, turn_.triangulator, take);
  }

  /// Only where the travel ends: on and on the same way, the drive's play is taken up. @pre the laser is off
  tl::expected<void, ScanStop> go_back(double begin_rad) {
    ScannerDevice& device = *equipment_.device;
    if (device.capabilities().endless_rotation) return {};
    auto back = device.rotate_to(begin_rad, device.capabilities().max_speed_rad_per_s);
    if (!back) return tl::make_unexpected(stop_of(back.error()));
    return feed_.poll();
  }

  const ScanEquipment& equipment_;
  FrameFeed& feed_;
  const LaserTurn& turn_;
  const TurnLayout layout_;
  PeakSurvey survey_;
  ExposureLimits limits_;
  std::int64_t asked_ns_ = 0;  ///< exposure
  bool reached_shortest_ = false;
};

}  // namespace

tl::expected<ExposureChoice, ScanStop> find_exposures(const ScanEquipment& equipment, FrameFeed& feed,
                                                      const LaserTurn& turn) {
  return Search(equipment, feed, turn).find();
}

}  // namespace celadon
