#include "daemon/scan_lasers.h"

#include <algorithm>
#include <numeric>

#include "daemon/dark_frame.h"
#include "daemon/scan_stops.h"

namespace celadon {
namespace {

std::string numbers_of(std::span<const int> lasers) {
  std::string text;
  for (const int laser : lasers) text += (text.empty() ? "" : ", ") + std::to_string(laser);
  return text.empty() ? "none" : text;
}

bool holds(std::span<const int> lasers, int laser) {
  return std::find(lasers.begin(), lasers.end(), laser) != lasers.end();
}

std::string name_of(const LaserTurn& turn) {
  const std::string where = text_of(turn.stop);
  const std::string with = turn.other_plan.empty()                               ? ""
                           : turn.plan.values_ns() < turn.other_plan.values_ns() ? " with the shorter exposures"
                                                                                 : " with the longer exposures";
  return "Laser " + std::to_string(turn.laser) + with + (where.empty() ? "" : " at " + where) + ": ";
}

/// Says which laser a sentence is about, where there are several; what ended the scan from outside is about none.
ScanStop about(const LaserTurn& turn, std::span<const LaserTurn> turns, ScanStop stop) {
  if (turns.size() > 1 && stop.state == ScanState::failed && !stop.device_lost && !stop.camera_lost)
    stop.reason = name_of(turn) + stop.reason;
  return stop;
}

tl::expected<void, ScanStop> look_again(const ScanEquipment& equipment, FrameFeed& feed, LaserTurn& turn,
                                        std::span<const LaserTurn> turns, RecordedLook which) {
  auto seen = equipment.device == nullptr
                  ? look_at_recording(equipment, turn.triangulator, turn.laser, turn.stop, which)
                  : look_at_object(equipment, feed, turn.triangulator, turn.plan, turn.other_plan);
  if (!seen) return tl::make_unexpected(about(turn, turns, seen.error()));
  turn.seen = std::move(*seen);
  if (turns.size() > 1) {
    for (std::string& warning : turn.seen.warnings) warning.insert(0, name_of(turn));
  }
  return {};
}

/// A laser that shines although it was switched off just now: by the difference to the background of its turn and,
/// since the object stands differently now, by a line that is too long to be anything else.
tl::expected<bool, ScanStop> still_shines(const CaptureTools& tools, const LaserTurn& before) {
  FrameSource& camera = tools.equipment.camera;
  const std::int64_t dark_since_ns = tools.equipment.clock.now_ns();
  if (!light_although_off(camera, before.triangulator, before.seen, dark_since_ns,
                          tools.feed.status().angle_rad * tools.equipment.calibration.encoder.scale.value))
    return false;
  auto frame = tools.feed.next_after(dark_since_ns);
  if (!frame) return tl::make_unexpected(frame.error());
  const std::vector<std::uint8_t> picture(frame->bytes().begin(), frame->bytes().end());
  return light_in_background(camera.mode(), picture, before.triangulator.along()).has_value();
}

/// From the end of one turn to a steady line of the next one's laser, head and lift where that one wants them.
/// @param k          number of the next turn
/// @param begin_rad  where the table stood before the first turn
tl::expected<void, ScanStop> change_turn(const CaptureTools& tools, std::span<LaserTurn> turns, std::size_t k,
                                         double begin_rad) {
  const LaserTurn& before = turns[k - 1];
  LaserTurn& next = turns[k];
  const ScanEquipment& equipment = tools.equipment;
  FrameFeed& feed = tools.feed;
  feed.pause_record();
  if (auto off = feed.laser_off(); !off) return off;
  const auto shines = still_shines(tools, before);
  if (!shines) return tl::make_unexpected(shines.error());
  if (*shines) {
    return tl::make_unexpected(
        ScanStop{ScanState::failed, "Laser " + std::to_string(before.laser) +
                                        " did not go out after its turn, so that no other was switched on; cut "
                                        "the power at the machine."});
  }
  if (auto rested = feed.come_to_rest(); !rested) return rested;
  // Back only where the travel ends: on and on the same way, the drive's play is taken up.
  if (!turn_fits_travel(tools)) {
    auto back = equipment.device->rotate_to(begin_rad, equipment.device->capabilities().max_speed_rad_per_s);
    if (!back) return tl::make_unexpected(stop_of(back.error()));
    if (auto polled = feed.poll(); !polled) return polled;
  }
  if (next.stop_number != before.stop_number) {
    const auto stop = bring_axes_to(next.stop, *equipment.device, equipment.calibration);
    if (!stop) return tl::make_unexpected(about(next, turns, stop.error()));
    stand_at(*stop, turns_at(next.stop_number, turns), equipment);
    if (auto polled = feed.poll(); !polled) return polled;
  }
  feed.use_laser(next.laser, next.stop, k);
  if (auto looked = look_again(equipment, feed, next, turns, RecordedLook::before_its_turn); !looked) return looked;
  feed.record_in(tools.log);
  return {};
}

}  // namespace

std::vector<int> lasers_present(const ScannerDevice* device, const FrameSource& camera,
                                const Calibration& calibration) {
  if (device != nullptr) {
    std::vector<int> lasers(static_cast<std::size_t>(device->capabilities().lasers));
    std::iota(lasers.begin(), lasers.end(), 0);
    return lasers;
  }
  const RecordedScan* const recorded = camera.recorded();
  if (recorded != nullptr && !recorded->lasers.empty()) return recorded->lasers;
  return {calibration.lasers.front().laser};
}

tl::expected<std::vector<int>, std::string> lasers_of(const ScanRequest& request, const Calibration& calibration,
                                                      std::span<const int> present) {
  std::vector<int> calibrated;
  for (const LaserPlane& plane : calibration.lasers) calibrated.push_back(plane.laser);
  for (const int laser : request.lasers) {
    const std::string asked = "Laser " + std::to_string(laser) + " was asked for, but ";
    if (!holds(present, laser)) {
      return tl::make_unexpected(asked + "the machine has lasers " + numbers_of(present) + "; leave it out.");
    }
    if (!holds(calibrated, laser)) {
      return tl::make_unexpected(asked + "the calibration of " + calibration.date + " holds lasers " +
                                 numbers_of(calibrated) + "; calibrate it (celadon calibrate), or leave it out.");
    }
  }
  if (!request.lasers.empty()) return request.lasers;
  std::erase_if(calibrated, [&](int laser) { return !holds(present, laser); });
  if (calibrated.empty()) {
    return tl::make_unexpected("The machine has lasers " + numbers_of(present) + ", and the calibration of " +
                               calibration.date + " holds none of them; calibrate the machine (celadon calibrate).");
  }
  return calibrated;
}

LineAlong along_of(int laser, const Calibration& calibration) {
  const auto plane = std::find_if(calibration.lasers.begin(), calibration.lasers.end(),
                                  [&](const LaserPlane& candidate) { return candidate.laser == laser; });
  return plane == calibration.lasers.end() ? LineAlong::rows : line_along(*plane);
}

std::vector<LaserTurn> turns_with(std::span<const LaserExposures> lasers, std::span<const AxisStop> stops,
                                  const Calibration& calibration, const ScanVolume& volume) {
  std::vector<LaserTurn> turns;
  for (std::size_t k = 0; k < stops.size(); ++k) {
    for (const auto& [laser, plans] : lasers) {
      const Triangulator triangulator(calibration, laser, volume, along_of(laser, calibration), stops[k]);
      if (plans.empty()) turns.push_back({laser, k, stops[k], triangulator});
      for (std::size_t i = 0; i < plans.size(); ++i) {
        const ExposurePlan other = plans.size() > 1 ? plans[1 - i] : ExposurePlan();
        turns.push_back({laser, k, stops[k], triangulator, plans[i], other});
      }
    }
  }
  return turns;
}

std::span<LaserTurn> turns_at(std::size_t stop_number, std::span<LaserTurn> turns) {
  const auto of_stop = [&](const LaserTurn& turn) { return turn.stop_number == stop_number; };
  const auto begin = std::find_if(turns.begin(), turns.end(), of_stop);
  return {begin, std::find_if_not(begin, turns.end(), of_stop)};
}

void stand_at(const AxisStop& stop, std::span<LaserTurn> turns, const ScanEquipment& equipment) {
  for (LaserTurn& turn : turns) {
    turn.stop = stop;
    turn.triangulator =
        Triangulator(equipment.calibration, turn.laser, equipment.volume, turn.triangulator.along(), stop);
  }
}

tl::expected<ScanPreparation, ScanStop> look_with_each(const ScanEquipment& equipment, FrameFeed& feed,
                                                       std::span<LaserTurn> turns) {
  for (std::size_t k = turns.size(); k-- > 0;) {
    if (equipment.device != nullptr && k + 1 < turns.size()) {
      if (auto off = feed.laser_off(); !off) return tl::make_unexpected(off.error());
    }
    feed.use_laser(turns[k].laser, turns[k].stop, k);
    if (auto looked = look_again(equipment, feed, turns[k], turns, RecordedLook::before_all_turns); !looked)
      return tl::make_unexpected(looked.error());
  }
  ScanPreparation together;
  together.z_low_mm = turns.front().seen.z_low_mm;
  together.z_high_mm = turns.front().seen.z_high_mm;
  together.warnings = turns.front().seen.warnings;
  for (const LaserTurn& turn : turns) {
    together.z_low_mm = std::min(together.z_low_mm, turn.seen.z_low_mm);
    together.z_high_mm = std::max(together.z_high_mm, turn.seen.z_high_mm);
    together.samples += turn.seen.samples;
  }
  return together;
}

tl::expected<CaptureResult, ScanStop> turn_with_each(const CaptureTools& tools, std::span<LaserTurn> turns) {
  const bool recorded = tools.equipment.device == nullptr;
  const double begin_rad = tools.feed.status().angle_rad;
  CaptureSoFar so_far;
  so_far.turns = static_cast<int>(turns.size());
  CaptureResult whole;
  std::vector<std::string> warnings;
  for (std::size_t k = 0; k < turns.size(); ++k) {
    LaserTurn& turn = turns[k];
    CaptureTools of_turn = tools;
    of_turn.turn = &turn;
    of_turn.so_far = &so_far;
    so_far.turn = static_cast<int>(k);
    if (k > 0) {
      auto ready = recorded ? look_again(tools.equipment, tools.feed, turn, turns, RecordedLook::before_its_turn)
                            : change_turn(of_turn, turns, k, begin_rad);
      if (!ready) return tl::make_unexpected(ready.error());
      warnings.insert(warnings.end(), turn.seen.warnings.begin(), turn.seen.warnings.end());
    }
    auto captured = recorded                                ? replay(of_turn)
                    : tools.request.mode == ScanMode::sweep ? sweep(of_turn)
                                                            : step_around(of_turn);
    if (!captured) return tl::make_unexpected(about(turn, turns, captured.error()));
    // Counters and the warnings that come of them are of all turns so far.
    whole.counters = captured->counters;
    whole.warnings = std::move(captured->warnings);
    whole.lasers.insert(whole.lasers.end(), captured->lasers.begin(), captured->lasers.end());
    const auto& closure = captured->closure_mm;
    if (closure && (!whole.closure_mm || closure->rms > whole.closure_mm->rms)) whole.closure_mm = closure;
  }
  whole.warnings.insert(whole.warnings.end(), warnings.begin(), warnings.end());
  return whole;
}

const LaserTurn& turn_of(const FrameFeed& feed, std::span<const LaserTurn> turns) {
  return turns[std::min(feed.turn_number(), turns.size() - 1)];
}

}  // namespace celadon
