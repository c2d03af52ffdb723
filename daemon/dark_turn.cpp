#include "daemon/dark_turn.h"

#include <cstdint>
#include <map>
#include <utility>

#include "daemon/mean_frame.h"
#include "daemon/table_turn.h"

namespace celadon {

tl::expected<Backgrounds, ScanStop> dark_turn(const ScanEquipment& equipment, FrameFeed& feed,
                                              const Triangulator& triangulator, const ExposurePlan& plan) {
  const TurnLayout turn(equipment, kQuickProfiles);
  const TableWay way = way_of_sweep(equipment, turn);
  const double stood_rad = feed.status().angle_rad;
  const auto expose_at = [&](double encoder_rad) {
    return feed.expose_for(plan.at_ns(encoder_rad / turn.encoder_per_true));
  };
  const auto turn_to = [&](double encoder_rad) -> tl::expected<void, ScanStop> {
    ScannerDevice& device = *equipment.device;
    auto moved = device.rotate_to(encoder_rad, device.capabilities().max_speed_rad_per_s);
    if (!moved) return tl::make_unexpected(stop_of(moved.error()));
    return feed.poll();
  };
  if (!turn_fits_travel(equipment, stood_rad + way.whole_rad)) {
    if (auto back = turn_to(0); !back) return tl::make_unexpected(back.error());
  }
  if (auto exposed = expose_at(feed.status().angle_rad + way.run_up_rad); !exposed)
    return tl::make_unexpected(exposed.error());
  std::map<std::pair<std::int64_t, int>, MeanFrame> means;
  const auto take = [&](Frame frame, const FrameAngle& angle, double) -> tl::expected<void, ScanStop> {
    if (auto exposed = expose_at(angle.at(equipment.clock.now_ns()).angle_rad); !exposed) return exposed;
    const int part = Backgrounds::part_of(angle.middle.angle_rad / turn.encoder_per_true);
    return means[{frame.info.exposure_ns, part}].add(frame.bytes());
  };
  if (auto swept = sweep_table(equipment, feed, turn, triangulator, take); !swept)
    return tl::make_unexpected(swept.error());
  if (auto rested = feed.come_to_rest(); !rested) return tl::make_unexpected(rested.error());
  if (!equipment.device->capabilities().endless_rotation) {
    if (auto back = turn_to(stood_rad); !back) return tl::make_unexpected(back.error());
  }
  if (auto exposed = expose_at(feed.status().angle_rad); !exposed) return tl::make_unexpected(exposed.error());
  Backgrounds backgrounds;
  for (const auto& [of, mean] : means) backgrounds.put(of.first, of.second, mean.mean());
  return backgrounds;
}

}  // namespace celadon
