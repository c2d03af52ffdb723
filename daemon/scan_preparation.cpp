#include "daemon/scan_preparation.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace celadon {
namespace {

constexpr int kBackgroundFrames = 8;
constexpr int kSteadyFrames = 3;
constexpr double kSteady = 0.02;  // relative change of the line's brightness from frame to frame
constexpr std::int64_t kWarmUpLimit_ns = 20'000'000'000;
constexpr std::int64_t kLineLimit_ns = 3'000'000'000;

tl::unexpected<ScanStop> failed(const std::string& reason) {
  return tl::make_unexpected(ScanStop{ScanState::failed, reason, false, false});
}

/// Mean of several frames, rounded: one frame would add its whole noise to every line.
tl::expected<std::vector<std::uint8_t>, ScanStop> mean_frame(FrameFeed& feed, Clock& clock) {
  std::vector<std::uint16_t> sum;
  const std::int64_t dark_since_ns = clock.now_ns();
  for (int k = 0; k < kBackgroundFrames; ++k) {
    auto frame = feed.next_after(dark_since_ns);
    if (!frame) return tl::make_unexpected(frame.error());
    const auto bytes = frame->bytes();
    if (sum.empty()) sum.assign(bytes.size(), kBackgroundFrames / 2);
    if (sum.size() != bytes.size()) {
      return failed("The camera changed its frame size from " + std::to_string(sum.size()) + " to " +
                    std::to_string(bytes.size()) + " bytes during the scan; restart it.");
    }
    for (std::size_t i = 0; i < bytes.size(); ++i) sum[i] = static_cast<std::uint16_t>(sum[i] + bytes[i]);
  }
  std::vector<std::uint8_t> mean(sum.size());
  for (std::size_t i = 0; i < sum.size(); ++i) mean[i] = static_cast<std::uint8_t>(sum[i] / kBackgroundFrames);
  return mean;
}

struct Brightness {
  int lines = 0, saturated = 0;
  double amplitude = 0;  // mean over the rows with a line
};

Brightness brightness_of(const std::vector<LineRow>& rows) {
  Brightness b;
  for (const LineRow& row : rows) {
    if (row.status != RowStatus::found && row.status != RowStatus::saturated) continue;
    ++b.lines;
    b.saturated += row.status == RowStatus::saturated ? 1 : 0;
    b.amplitude += row.amplitude;
  }
  if (b.lines > 0) b.amplitude /= b.lines;
  return b;
}

std::string seconds(std::int64_t ns) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f s", static_cast<double>(ns) / 1e9);
  return text;
}

}  // namespace

tl::expected<void, ScanStop> make_device_ready(const ScanEquipment& equipment, const ScanRequest& request,
                                               ScanObserver& observer) {
  ScannerDevice& device = equipment.device;
  auto status = device.poll();
  if (!status) return tl::make_unexpected(stop_of(status.error()));
  observer.on_status(*status);
  if (status->emergency_stop) {
    return failed("The emergency stop is pressed; release it, press the button on the machine and start a new scan.");
  }
  if (!status->interlock_closed) {
    return failed("The interlock is open; close the cover, press the button on the machine and start a new scan.");
  }
  if (status->local_action_needed) {
    return failed("The machine is locked after a stop; press the button on the machine, then start a new scan.");
  }
  if (auto off = device.laser_off(); !off) return tl::make_unexpected(stop_of(off.error()));
  const bool stopped = status->motion == MotionState::fault || status->motion == MotionState::stopped;
  if (stopped || status->fault_code != 0) {
    if (auto cleared = device.clear_fault(); !cleared) return tl::make_unexpected(stop_of(cleared.error()));
  }
  if (stopped || status->motion == MotionState::unhomed || !status->homed) {
    if (auto homed = device.home(); !homed) return tl::make_unexpected(stop_of(homed.error()));
  }
  if (request.exposure_ms > 0) {
    auto exposure = equipment.camera.set_exposure(std::llround(request.exposure_ms * 1e6));
    if (!exposure) return tl::make_unexpected(stop_of(exposure.error()));
  }
  return {};
}

tl::expected<ScanPreparation, ScanStop> look_at_object(const ScanEquipment& equipment, FrameFeed& feed,
                                                       LaserLineExtractor& extractor,
                                                       const Triangulator& triangulator) {
  ScanPreparation preparation;
  if (auto off = feed.laser_off(); !off) return tl::make_unexpected(off.error());
  auto background = mean_frame(feed, equipment.clock);
  if (!background) return tl::make_unexpected(background.error());
  preparation.background = std::move(*background);

  if (auto on = feed.laser_on(); !on) return tl::make_unexpected(on.error());
  const CameraMode mode = equipment.camera.mode();
  std::vector<LineRow> rows(static_cast<std::size_t>(mode.height_px));
  Brightness last;
  FrameInfo seen;
  int steady = 0;
  while (steady < kSteadyFrames) {
    auto frame = feed.next_after(feed.shining_since_ns());
    if (!frame) return tl::make_unexpected(frame.error());
    seen = frame->info;
    extractor.extract(mode, frame->bytes(), preparation.background, rows);
    const Brightness now = brightness_of(rows);
    const bool kept = now.lines > 0 && std::abs(now.amplitude - last.amplitude) <= kSteady * now.amplitude;
    steady = kept ? steady + 1 : 0;
    last = now;
    const std::int64_t waited_ns = equipment.clock.now_ns() - feed.shining_since_ns();
    if (now.lines == 0 && waited_ns > kLineLimit_ns) {
      return failed("No laser line is seen in " + seconds(waited_ns) +
                    ": check that the laser shines on the object, that nothing covers the camera, and the exposure (" +
                    std::to_string(seen.exposure_ns / 1000) + " us).");
    }
    if (waited_ns > kWarmUpLimit_ns) {
      preparation.warnings.push_back("The laser's brightness was still changing after " + seconds(waited_ns) +
                                     "; let it warm up or check its supply.");
      break;
    }
    preparation.warm_up_ns = waited_ns;
  }
  if (2 * last.saturated > last.lines) {
    preparation.warnings.push_back(std::to_string(last.saturated) + " of " + std::to_string(last.lines) +
                                   " rows are saturated, which widens the line; a shorter exposure than " +
                                   std::to_string(seen.exposure_ns / 1000) + " us measures better.");
  }

  Profile profile;
  const AngleAtInstant standing{feed.status().angle_rad, 0, 0};
  triangulator.triangulate(
      rows, seen, [&](std::int64_t) { return standing; }, profile);
  if (profile.size() == 0) {
    return failed("The laser line is seen, but none of it lies in the volume of the scanner (r " +
                  std::to_string(equipment.volume.r_min_mm) + " .. " + std::to_string(equipment.volume.r_max_mm) +
                  " mm, z " + std::to_string(equipment.volume.z_min_mm) + " .. " +
                  std::to_string(equipment.volume.z_max_mm) +
                  " mm); place the object over the middle of the table, or check calibration and volume.");
  }
  const auto [low, high] = std::minmax_element(profile.z_mm.begin(), profile.z_mm.end());
  preparation.z_low_mm = *low;
  preparation.z_high_mm = *high;
  preparation.samples = profile.size();
  return preparation;
}

}  // namespace celadon
