#include "daemon/calibration/first_look.h"

#include <cmath>

#include "acquisition/laser_line.h"
#include "daemon/calibration/unmeasured.h"
#include "daemon/frame_feed.h"
#include "daemon/safe_on_exit.h"
#include "daemon/scan_preparation.h"
#include "daemon/self_test.h"

namespace celadon {
namespace {

using Stop = tl::unexpected<ScanStop>;

constexpr double kTurning_rad_per_s = 0.35;  // slow enough to be watched

ScanEquipment equipment_of(ScannerConnection& machine, const Calibration& calibration) {
  return {machine.device.get(), *machine.camera, *machine.clock, calibration, nullptr, {}};
}

/// The line of a laser that is on, once it has shone for a whole frame.
tl::expected<LaserLook, ScanStop> look(FrameFeed& feed, const CameraMode& mode,
                                       const std::vector<std::uint8_t>& background) {
  auto frame = feed.next_after(feed.shining_since_ns());
  if (!frame) return Stop(frame.error());
  LaserLineExtractor extractor;
  std::vector<LineRow> rows(static_cast<std::size_t>(mode.height_px));
  extractor.extract(mode, frame->bytes(), background, rows);
  const LineBrightness seen = brightness_of(rows);
  return LaserLook{feed.laser(), seen.lines, mode.height_px, seen.saturated, seen.amplitude};
}

}  // namespace

tl::expected<std::string, ScanStop> test_unmeasured(ScannerConnection& machine, ScanObserver& observer) {
  const Calibration calibration = nothing_known(machine);
  return self_test(equipment_of(machine, calibration), observer);
}

tl::expected<std::vector<LaserLook>, ScanStop> look_at_lasers(ScannerConnection& machine, ScanObserver& observer) {
  const Calibration calibration = nothing_known(machine);
  const ScanEquipment equipment = equipment_of(machine, calibration);
  SafeOnExit safe(equipment.device, observer);
  if (auto ready = make_device_ready(equipment, {}, observer); !ready) return Stop(ready.error());
  const Triangulator triangulator(calibration, 0, equipment.volume);
  auto feed = FrameFeed::start(equipment, observer, triangulator, 0);
  if (!feed) return Stop(feed.error());
  auto background = dark_background(**feed, equipment.clock);
  if (!background) return Stop(background.error());
  std::vector<LaserLook> looks;
  for (int laser = 0; laser < equipment.device->capabilities().lasers; ++laser) {
    (*feed)->use_laser(laser);
    if (auto on = (*feed)->laser_on(); !on) return Stop(on.error());
    auto seen = look(**feed, equipment.camera.mode(), *background);
    if (!seen) return Stop(seen.error());
    looks.push_back(*seen);
    if (auto off = (*feed)->laser_off(); !off) return Stop(off.error());
  }
  if (const auto unsafe = safe.now()) return Stop(ScanStop{ScanState::failed, *unsafe});
  return looks;
}

tl::expected<void, ScanStop> turn_by(double angle_rad, ScannerConnection& machine, ScanObserver& observer) {
  const Calibration calibration = nothing_known(machine);
  const ScanEquipment equipment = equipment_of(machine, calibration);
  ScannerDevice& device = *equipment.device;
  SafeOnExit safe(&device, observer);
  if (auto ready = make_device_ready(equipment, {}, observer); !ready) return ready;
  auto stands = device.poll();
  if (!stands) return Stop(stop_of(stands.error()));
  const double speed = std::min(kTurning_rad_per_s, device.capabilities().max_speed_rad_per_s);
  auto turned = device.rotate_to(stands->angle_rad + angle_rad, speed);
  if (!turned) return Stop(stop_of(turned.error()));
  return {};
}

}  // namespace celadon
