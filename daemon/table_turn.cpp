#include "daemon/table_turn.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <optional>
#include <utility>

namespace celadon {
namespace {

constexpr double kFullTurn_rad = 2 * std::numbers::pi;
constexpr int kFramesAtRest = 20;  // of a sweep, after which the table has stopped short

tl::unexpected<ScanStop> turn_failed(const std::string& reason) {
  return tl::make_unexpected(ScanStop{ScanState::failed, reason, false, false});
}

}  // namespace

TurnLayout::TurnLayout(const ScanEquipment& equipment, int profiles_of_turn)
    : profiles(profiles_of_turn),
      pitch_rad(kFullTurn_rad / profiles),
      overlap_profiles(std::max(4, profiles / 60)),
      overlap_rad(overlap_profiles * pitch_rad),
      encoder_per_true(1 / equipment.calibration.encoder.scale.value),
      encoder(equipment.calibration.encoder) {}

TableWay way_of_sweep(const ScanEquipment& equipment, const TurnLayout& turn) {
  const ScannerDevice& device = *equipment.device;
  const double period_s = static_cast<double>(equipment.camera.mode().frame_period_ns) * 1e-9;
  TableWay way;
  way.speed_rad_per_s =
      std::min(turn.pitch_rad * turn.encoder_per_true / period_s, device.capabilities().max_speed_rad_per_s);
  way.run_up_rad = device.run_up_rad(way.speed_rad_per_s) + 4 * way.speed_rad_per_s * period_s;
  way.whole_rad = (kFullTurn_rad + turn.overlap_rad) * turn.encoder_per_true + 2 * way.run_up_rad;
  return way;
}

TableWay way_of_steps(const TurnLayout& turn) {
  return {0, 0, (turn.profiles + turn.overlap_profiles + 1) * turn.pitch_rad * turn.encoder_per_true};
}

bool turn_fits_travel(const ScanEquipment& equipment, double target_rad) {
  const DeviceCapabilities& limits = equipment.device->capabilities();
  return limits.endless_rotation || target_rad <= limits.travel_rad;
}

std::string degrees_text(double rad) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f degrees", rad * 180 / std::numbers::pi);
  return text;
}

tl::expected<void, ScanStop> sweep_table(const ScanEquipment& equipment, FrameFeed& feed, const TurnLayout& turn,
                                         const Triangulator& triangulator, const TakeFrame& take) {
  ScannerDevice& device = *equipment.device;
  const TableWay way = way_of_sweep(equipment, turn);
  const double start = feed.status().angle_rad + way.run_up_rad;
  const double end_turned = kFullTurn_rad + turn.overlap_rad;
  const double target = feed.status().angle_rad + way.whole_rad;
  if (!turn_fits_travel(equipment, target)) {
    return turn_failed("A sweep needs the table to turn to " + degrees_text(target) + ", but its travel ends at " +
                       degrees_text(device.capabilities().travel_rad) + "; scan in steps.");
  }
  if (auto moving = device.start_sweep(target, way.speed_rad_per_s); !moving)
    return tl::make_unexpected(stop_of(moving.error()));
  const double middle_row = (static_cast<double>(equipment.camera.mode().height_px) - 1) / 2;
  int at_rest = 0;
  std::optional<Frame> newest;  // held back until the one after it tells whether it came late
  bool newest_doubtful = false;
  while (true) {
    auto next = feed.next();
    if (!next) return tl::make_unexpected(next.error());
    const bool doubtful = std::exchange(newest_doubtful, feed.may_be_late());
    if (!newest) {
      newest = std::move(*next);
      continue;
    }
    Frame frame = std::exchange(*newest, std::move(*next));
    const FrameInfo info = frame.info;
    if (doubtful && feed.came_late(info, newest->info)) {
      feed.leave_out_late(info);
      continue;
    }
    const std::int64_t middle_ns = triangulator.row_instant_ns(info, middle_row);
    const auto angle = feed.timeline().at(middle_ns);
    at_rest = feed.status().motion == MotionState::moving ? 0 : at_rest + 1;
    if (!angle) {
      if (at_rest > kFramesAtRest) {
        return turn_failed("The table has turned, but the time stamps of the frames belong to no position of it (" +
                           std::string(angle.error()) + "); check the camera's clock and start a new scan.");
      }
      feed.verdict(info, FrameVerdict::no_angle);
      continue;
    }
    const double turned = turn.turned_rad(start, angle->angle_rad);
    if (turned >= end_turned) return {};
    if (at_rest > kFramesAtRest) {
      return turn_failed("The table stopped after " + degrees_text(std::max(turned, 0.)) + " of " +
                         degrees_text(end_turned) + "; check what blocks it and start a new scan.");
    }
    if (turned < 0) {
      feed.verdict(info, FrameVerdict::outside_turn);
      continue;
    }
    if (auto taken = take(std::move(frame), {*angle, middle_ns}, turned); !taken) return taken;
  }
}

}  // namespace celadon
