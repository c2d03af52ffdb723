#include "daemon/scan_preparation.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <span>

#include "daemon/dark_frame.h"
#include "daemon/dark_turn.h"
#include "daemon/mean_frame.h"
#include "daemon/scan_stops.h"

namespace celadon {
namespace {

constexpr int kSteadyFrames = 3;
constexpr double kSteady = 0.02;  // relative change of the line's brightness from frame to frame
constexpr std::int64_t kWarmUpLimit_ns = 20'000'000'000;
constexpr std::int64_t kLineLimit_ns = 3'000'000'000;
constexpr std::int64_t kWarning_ns = 2'000'000'000, kWarningPoll_ns = 100'000'000;

tl::unexpected<ScanStop> device_failed(const std::string& reason) {
  return tl::make_unexpected(ScanStop{ScanState::failed, reason, false, false});
}

/// What the line on the object as it stands says of the scan to come.
tl::expected<void, ScanStop> learn(const std::vector<LineRow>& rows, const LineBrightness& brightness,
                                   const FrameInfo& seen, double angle_rad, const ScanVolume& volume,
                                   const Triangulator& triangulator, bool by_plan, ScanPreparation& preparation) {
  // A plan by the line's own peaks says by itself what it does not reach.
  if (!by_plan && 2 * brightness.saturated > brightness.lines) {
    preparation.warnings.push_back(std::to_string(brightness.saturated) + " of " + std::to_string(brightness.lines) +
                                   " rows are saturated, which widens the line; a shorter exposure than " +
                                   std::to_string(seen.exposure_ns / 1000) + " us measures better.");
  }
  Profile profile;
  const AngleAtInstant standing{angle_rad, 0, 0};
  triangulator.triangulate(
      rows, seen, [&](std::int64_t) { return standing; }, profile);
  if (profile.size() == 0) {
    return device_failed("The laser line is seen, but none of it lies in the volume of the scanner (r " +
                         std::to_string(volume.r_min_mm) + " .. " + std::to_string(volume.r_max_mm) + " mm, z " +
                         std::to_string(volume.z_min_mm) + " .. " + std::to_string(volume.z_max_mm) +
                         " mm); place the object over the middle of the table, or check calibration and volume.");
  }
  const auto [low, high] = std::minmax_element(profile.z_mm.begin(), profile.z_mm.end());
  preparation.z_low_mm = *low;
  preparation.z_high_mm = *high;
  preparation.samples = profile.size();
  preparation.line = brightness;
  preparation.exposure_ns = seen.exposure_ns;
  return {};
}

tl::expected<void, ScanStop> fit_to_start(const DeviceStatus& status, bool needs_switch) {
  if (status.emergency_stop) {
    return device_failed("The emergency stop is pressed; release it, press the button on the machine and start again.");
  }
  if (!status.interlock_closed) {
    return device_failed("The interlock is open; close the cover, press the button on the machine and start again.");
  }
  if (status.local_action_needed) {
    return device_failed("The machine is locked after a stop; press the button on the machine, then start again.");
  }
  if (needs_switch && !status.remote_enabled) {
    return device_failed(
        "The switch at the machine forbids a start from afar; turn it, or start the scan with the button on the "
        "machine.");
  }
  return {};
}

/// The lamp shows what is about to come; whoever stands there may stop it.
tl::expected<void, ScanStop> warn(const ScanEquipment& equipment, ScanObserver& observer) {
  ScannerDevice& device = *equipment.device;
  const std::int64_t end_ns = equipment.clock.now_ns() + kWarning_ns;
  while (equipment.clock.now_ns() < end_ns) {
    equipment.clock.sleep_until(std::min(end_ns, equipment.clock.now_ns() + kWarningPoll_ns));
    if (const auto reason = observer.cancelled()) return tl::make_unexpected(cancelled_by(*reason));
    auto status = device.poll();
    if (!status) return tl::make_unexpected(stop_of(status.error()));
    observer.on_status(*status);
    if (device.take_button_presses() > 0) return tl::make_unexpected(cancelled_by("by the button on the machine"));
    if (auto fit = fit_to_start(*status, device.capabilities().remote_enable_switch); !fit) return fit;
  }
  return {};
}

std::string seconds(std::int64_t ns) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f s", static_cast<double>(ns) / 1e9);
  return text;
}

/// Turns the table on to where the plans want the shortest exposure: a dark part may show no line to begin with. Where
/// the travel ends it stays. @pre the laser is off
tl::expected<void, ScanStop> stand_where_bright(const ScanEquipment& equipment, FrameFeed& feed,
                                                const ExposurePlan& plan, const ExposurePlan& other_plan) {
  constexpr double kSector_rad = 2 * std::numbers::pi / ExposurePlan::kSectors;
  const double per_encoder = equipment.calibration.encoder.scale.value;
  const auto longest_beside = [&](double rad) {
    std::int64_t longest_ns = 0;
    for (const double off_rad : {-kSector_rad, 0., kSector_rad}) {
      longest_ns = std::max(longest_ns, plan.at_ns(rad + off_rad));
      if (!other_plan.empty()) longest_ns = std::max(longest_ns, other_plan.at_ns(rad + off_rad));
    }
    return longest_ns;
  };
  ScannerDevice& device = *equipment.device;
  const double here_rad = feed.status().angle_rad;
  double there_rad = here_rad;
  for (std::size_t k = 1; k < ExposurePlan::kSectors && device.capabilities().endless_rotation; ++k) {
    const double on_rad = here_rad + static_cast<double>(k) * kSector_rad / per_encoder;
    if (longest_beside(on_rad * per_encoder) < longest_beside(there_rad * per_encoder)) there_rad = on_rad;
  }
  if (there_rad != here_rad) {
    auto turned = device.rotate_to(there_rad, device.capabilities().max_speed_rad_per_s);
    if (!turned) return tl::make_unexpected(stop_of(turned.error()));
    if (auto polled = feed.poll(); !polled) return polled;
  }
  return feed.expose_for(plan.at_ns(there_rad * per_encoder));
}

}  // namespace

LineBrightness brightness_of(const std::vector<LineRow>& rows) {
  LineBrightness b;
  for (const LineRow& row : rows) {
    if (row.status != RowStatus::found && row.status != RowStatus::saturated) continue;
    ++b.lines;
    b.saturated += row.status == RowStatus::saturated ? 1 : 0;
    b.amplitude += row.amplitude;
  }
  if (b.lines > 0) b.amplitude /= b.lines;
  return b;
}

tl::expected<std::vector<std::uint8_t>, ScanStop> dark_background(FrameFeed& feed, Clock& clock) {
  MeanFrame mean;
  const std::int64_t dark_since_ns = clock.now_ns();
  while (mean.count() < MeanFrame::kEnough) {
    auto frame = feed.next_after(dark_since_ns);
    if (!frame) return tl::make_unexpected(frame.error());
    if (auto added = mean.add(frame->bytes()); !added) return tl::make_unexpected(added.error());
    const AngleAtInstant standing{feed.status().angle_rad, 0, 0};
    if (auto kept = feed.keep(*frame, standing, FrameUse::background); !kept) return tl::make_unexpected(kept.error());
  }
  return mean.mean();
}

tl::expected<void, ScanStop> make_device_ready(const ScanEquipment& equipment, const ScanTask& task,
                                               ScanObserver& observer) {
  ScannerDevice& device = *equipment.device;
  auto status = device.poll();
  if (!status) return tl::make_unexpected(stop_of(status.error()));
  observer.on_status(*status);
  if (auto fit = fit_to_start(*status, task.from_afar && device.capabilities().remote_enable_switch); !fit) return fit;
  if (auto off = device.laser_off(); !off) return tl::make_unexpected(stop_of(off.error()));
  if (task.from_afar) {
    if (auto warned = warn(equipment, observer); !warned) return warned;
  }
  const bool stopped = status->motion == MotionState::fault || status->motion == MotionState::stopped;
  if (stopped || status->fault_code != 0) {
    if (auto cleared = device.clear_fault(); !cleared) return tl::make_unexpected(stop_of(cleared.error()));
  }
  if (stopped || status->motion == MotionState::unhomed || !status->homed) {
    if (auto homed = device.home(); !homed) return tl::make_unexpected(stop_of(homed.error()));
  }
  if (task.request.exposure_ms > 0) {
    auto exposure = equipment.camera.set_exposure(std::llround(task.request.exposure_ms * 1e6));
    if (!exposure) return tl::make_unexpected(stop_of(exposure.error()));
  }
  return {};
}

tl::expected<ScanPreparation, ScanStop> look_at_object(const ScanEquipment& equipment, FrameFeed& feed,
                                                       const Triangulator& triangulator, const ExposurePlan& plan,
                                                       const ExposurePlan& other_plan) {
  ScanPreparation preparation;
  if (auto off = feed.laser_off(); !off) return tl::make_unexpected(off.error());
  if (plan.empty()) {
    auto background = dark_background(feed, equipment.clock);
    if (!background) return tl::make_unexpected(background.error());
    preparation.backgrounds.put(feed.exposure_in_force_ns(), {}, std::move(*background));
  } else {
    auto backgrounds = dark_turn(equipment, feed, triangulator, plan);
    if (!backgrounds) return tl::make_unexpected(backgrounds.error());
    preparation.backgrounds = std::move(*backgrounds);
    if (auto stands = stand_where_bright(equipment, feed, plan, other_plan); !stands)
      return tl::make_unexpected(stands.error());
  }
  const std::span<const std::uint8_t> background = preparation.backgrounds.of(
      feed.exposure_in_force_ns(), feed.status().angle_rad * equipment.calibration.encoder.scale.value);
  preparation.background_at_rad = feed.status().angle_rad;

  if (auto on = feed.laser_on(); !on) return tl::make_unexpected(on.error());
  const CameraMode mode = equipment.camera.mode();
  LaserLineExtractor extractor({.along = triangulator.along()});
  std::vector<LineRow> rows(triangulator.line_count());
  LineBrightness last;
  FrameInfo seen;
  int steady = 0;
  std::int64_t warm_after_ns = 0;  // from the grant until the first exposure that looked like those after it
  while (steady < kSteadyFrames) {
    auto frame = feed.next_after(feed.shining_since_ns());
    if (!frame) return tl::make_unexpected(frame.error());
    seen = frame->info;
    extractor.extract(mode, frame->bytes(), background, rows);
    const LineBrightness now = brightness_of(rows);
    const bool unchanged = now.lines > 0 && std::abs(now.amplitude - last.amplitude) <= kSteady * now.amplitude;
    steady = unchanged ? steady + 1 : 0;
    if (!unchanged) {
      warm_after_ns = triangulator.row_instant_ns(seen, 0) - seen.exposure_ns / 2 - feed.shining_since_ns();
    }
    last = now;
    const std::int64_t waited_ns = equipment.clock.now_ns() - feed.shining_since_ns();
    if (now.lines == 0 && waited_ns > kLineLimit_ns) {
      if (const auto shines = light_in_background(mode, background, triangulator.along()))
        return device_failed(*shines);
      return device_failed(
          "No laser line is seen in " + seconds(waited_ns) +
          ": check that the laser shines on the object, that nothing covers the camera, and the exposure (" +
          std::to_string(seen.exposure_ns / 1000) + " us).");
    }
    if (waited_ns > kWarmUpLimit_ns) {
      preparation.warnings.push_back("The laser's brightness was still changing after " + seconds(waited_ns) +
                                     "; let it warm up or check its supply.");
      break;
    }
    if (steady == kSteadyFrames) {
      const AngleAtInstant standing{feed.status().angle_rad, 0, 0};
      if (auto kept = feed.keep(*frame, standing, FrameUse::look); !kept) return tl::make_unexpected(kept.error());
    }
  }
  feed.set_warm_up(std::max<std::int64_t>(warm_after_ns, 0));
  if (auto learned =
          learn(rows, last, seen, feed.status().angle_rad, equipment.volume, triangulator, !plan.empty(), preparation);
      !learned) {
    return tl::make_unexpected(learned.error());
  }
  return preparation;
}

bool is_of_turn(const FrameSource& camera, const FrameInfo& frame, int laser, const AxisStop& stop) {
  const RecordedScan* const recorded = camera.recorded();
  return recorded == nullptr || ((recorded->lasers.empty() || frame.laser == laser) && frame.stop == stop);
}

tl::expected<ScanPreparation, ScanStop> look_at_recording(const ScanEquipment& equipment,
                                                          const Triangulator& triangulator, int laser,
                                                          const AxisStop& stop, RecordedLook which) {
  FrameSource& camera = equipment.camera;
  camera.stop();  // from its first frame again
  if (auto started = camera.start(); !started) return tl::make_unexpected(stop_of(started.error()));
  ScanPreparation preparation;
  MeanFrame dark;
  Frame look;
  // The look is the last one before the turn, or the turn's first frame; the background is the one before it.
  while (!look || look.info.use == FrameUse::look) {
    auto frame = camera.next(0);
    if (!frame && frame.error().kind == CameraError::Kind::end_of_stream) break;
    if (!frame) return tl::make_unexpected(stop_of(frame.error()));
    if (!is_of_turn(camera, frame->info, laser, stop)) {
      const bool turns = frame->info.use == FrameUse::turn || frame->info.use == FrameUse::overlap;
      if (turns && look && which == RecordedLook::before_all_turns) break;
      continue;
    }
    if (frame->info.use == FrameUse::background) {
      if (look) {
        look.release();
        dark = MeanFrame();
      }
      if (dark.count() == MeanFrame::kEnough) continue;
      if (auto added = dark.add(frame->bytes()); !added) return tl::make_unexpected(added.error());
      preparation.background_at_rad = frame->info.table_angle_rad;
    } else if (!look || frame->info.use == FrameUse::look) {
      look = std::move(*frame);
    } else {
      break;
    }
  }
  if (!look) {
    const std::string where = text_of(stop);
    return device_failed("The recording has no frame with laser " + std::to_string(laser) + " on" +
                         (where.empty() ? "" : " at " + where) + "; record again.");
  }
  preparation.backgrounds.put(look.info.exposure_ns, {}, dark.mean());
  LaserLineExtractor extractor({.along = triangulator.along()});
  std::vector<LineRow> rows(triangulator.line_count());
  extractor.extract(camera.mode(), look.bytes(), preparation.backgrounds.of(look.info.exposure_ns, 0), rows);
  const LineBrightness brightness = brightness_of(rows);
  if (brightness.lines == 0) {
    return device_failed("No laser line is seen in frame " + std::to_string(look.info.sequence) +
                         " of the recording; record again with the laser on the object.");
  }
  if (auto learned = learn(rows, brightness, look.info, look.info.table_angle_rad, equipment.volume, triangulator,
                           false, preparation);
      !learned) {
    return tl::make_unexpected(learned.error());
  }
  return preparation;
}

}  // namespace celadon
