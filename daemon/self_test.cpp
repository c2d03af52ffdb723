#include "daemon/self_test.h"

#include <cstdio>

#include "daemon/dark_frame.h"
#include "daemon/frame_feed.h"
#include "daemon/safe_on_exit.h"
#include "daemon/scan_lasers.h"
#include "daemon/scan_preparation.h"

namespace celadon {
namespace {

/// The laser is off: no picture may show its line.
tl::expected<void, ScanStop> look_for_light(const ScanEquipment& equipment, ScanObserver& observer) {
  const int laser = equipment.calibration.lasers.front().laser;
  const Triangulator triangulator(equipment.calibration, laser, equipment.volume,
                                  along_of(laser, equipment.calibration));
  auto feed = FrameFeed::start(equipment, observer, triangulator, laser);
  if (!feed) return tl::make_unexpected(feed.error());
  if (auto off = (*feed)->laser_off(); !off) return off;
  auto picture = dark_background(**feed, equipment.clock);
  if (!picture) return tl::make_unexpected(picture.error());
  if (const auto light = light_in_background(equipment.camera.mode(), *picture, triangulator.along()))
    return tl::make_unexpected(ScanStop{ScanState::failed, *light});
  return {};
}

}  // namespace

tl::expected<std::string, ScanStop> self_test(const ScanEquipment& equipment, ScanObserver& observer) {
  SafeOnExit safe(equipment.device, observer);
  // A machine that has to be homed is homed here.
  if (auto ready = make_device_ready(equipment, {}, observer); !ready) return tl::make_unexpected(ready.error());
  if (auto dark = look_for_light(equipment, observer); !dark) return tl::make_unexpected(dark.error());
  const std::int64_t begun_ns = equipment.clock.now_ns();
  if (auto homed = equipment.device->home(); !homed) return tl::make_unexpected(stop_of(homed.error()));
  const double homing_s = static_cast<double>(equipment.clock.now_ns() - begun_ns) / 1e9;
  if (const auto unsafe = safe.now()) return tl::make_unexpected(ScanStop{ScanState::failed, *unsafe});
  char text[160];
  std::snprintf(
      text, sizeof text,
      "The interlock is closed, the lasers are dark to their sensor and to the camera, and the index was found "
      "within %.1f s.",
      homing_s);
  return std::string(text);
}

}  // namespace celadon
