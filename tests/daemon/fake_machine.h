#pragma once
// A turntable, a laser and a camera in closed form behind the daemon's real interfaces: a controller core on a plant,
// reached through a Transport, and a FrameSource that draws the laser line. One device clock that moves by declared
// waits, by frames and by the bus time of requests. Host and test share it under one lock.

#include <atomic>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <vector>

#include "acquisition/calibration.h"
#include "acquisition/frame.h"
#include "daemon/scanner_connection.h"
#include "firmware_bridge/controller_core.h"
#include "firmware_bridge/transport.h"
#include "tests/firmware_bridge/test_plant.h"

namespace celadon::testing {

class FakeMachine {
 public:
  static constexpr int kWidth = 320, kHeight = 240;
  static constexpr std::int64_t kPeriod_us = 20'000, kExposure_us = 4'000, kRequest_us = 300;
  static constexpr std::int64_t kHostOffset_ns = 5'000'000'000;  ///< host clock at device time 0

  /// @param features  bits of the turntable's, beside the usual ones
  /// @param travel_deg  of the table; 0: it turns without end
  /// @param axes        whether it has an elevation and a lift axis too: -20 to 160 degrees, -10 to 160 mm
  explicit FakeMachine(std::uint16_t features = 0, double travel_deg = 0, bool axes = false);

  // --- the object: range at (theta, z) in its own frame, 0 where there is nothing ---
  std::function<double(double theta_rad, double z_mm)> shape = vase;
  static double vase(double theta_rad, double z_mm);
  /// Share of laser and room light that it throws back.
  std::function<double(double theta_rad, double z_mm)> reflectance = [](double, double) { return 1.; };

  // --- what the test does to it; at any time ---
  void press_button();
  void with_plant(const std::function<void(test::TestPlant&)>& change);
  std::uint16_t lasers();
  LampPattern lamp();
  double speed();  ///< of the axis that moves fastest
  /// Frames that the camera exposed with a laser on while head or lift moved.
  int lit_while_axes_moved();
  std::atomic<bool> link_down = false, camera_silent = false, camera_unplugged = false, camera_dark = false;
  std::atomic<bool> tells_changes = false;  ///< of the button, as a controller on USB does
  std::atomic<bool> changed = false;        ///< and the host has not looked yet
  std::atomic<int> corrupt_every = 0;       ///< frames
  std::atomic<double> slip_per_turn_deg = 0;
  std::atomic<std::int64_t> stamp_step_us = 0;
  std::atomic<std::int64_t> late_us = 0;  ///< every second frame is exposed so much later, or every one
  std::atomic<bool> all_late = false;
  /// When a driver on a busy computer stamps a frame that was read out at an instant of the device's clock.
  std::function<std::int64_t(std::int64_t read_out_us)> stamped_us = [](std::int64_t read_out_us) {
    return read_out_us;
  };
  std::size_t buffers = 4;      ///< of the driver; when all are full, newer frames are lost; set before anything else
  bool camera_on_side = false;  ///< turned about its optical axis, before anything else is asked of the machine
  // Of the camera's exposure, which is kExposure_us where nobody sets it.
  std::atomic<std::int64_t> exposure_us = kExposure_us;  ///< as the camera stands
  std::atomic<int> exposure_refusal = 0;                 ///< errno of each attempt to set it
  std::atomic<int> exposure_takes = 1'000'000;           ///< attempts before one that it refuses with EIO
  std::atomic<bool> exposure_fixed = false;              ///< it takes any and keeps its own
  std::atomic<std::int64_t> exposure_unit_us = 1;        ///< that it can be set in
  std::atomic<int> exposure_late = 0;                    ///< frames until a new one holds, of which it cannot tell
  std::atomic<bool> laser_hidden = false;  ///< the first shines always, and the controller does not see it

  /// @param lasers  that are calibrated: the first stands to the right of the camera, the second to its left
  Calibration calibration(int lasers = 1) const;
  /// What a daemon connects to; the machine must outlive it.
  tl::expected<ScannerConnection, ConnectError> connect(const Calibration& calibration);

  // --- used by transport, clock and camera ---
  std::int64_t now_ns();
  void advance_to_us(std::uint64_t time_us);
  protocol::Exception read(protocol::Area area, std::uint16_t address, std::span<std::uint16_t> words);
  protocol::Exception write(std::uint16_t address, std::span<const std::uint16_t> words);
  struct Shot {
    std::uint64_t sequence = 0;
    std::int64_t stamp_us = 0;
    double angle_rad = 0, elevation_rad = 0, lift_mm = 0;  ///< as the axes' controllers read
    std::uint16_t lasers = 0;                              ///< that shone
    std::uint32_t lost_before = 0;
    std::int64_t exposure_us = kExposure_us, claimed_us = kExposure_us;  ///< true; as the driver says
    bool exposure_sure = true;
  };
  /// @returns 0 or an errno
  int set_exposure(std::int64_t asked_us);
  void stream(bool on);
  std::optional<Shot> take_shot(std::int64_t timeout_us);
  void draw(const Shot& shot, std::uint8_t* pixels) const;
  double line_px(int laser, const Shot& shot, int row) const { return line_in(laser, shot, row).x_px; }
  /// True exposures of all frames so far, by their sequence.
  std::vector<std::int64_t> exposures_us();

 private:
  struct Line {
    double x_px = -1, reflectance = 0;
  };
  Line line_in(int laser, const Shot& shot, int row) const;
  void advance_locked(std::uint64_t time_us);
  double line_px_with_axes(int laser, const Shot& shot, int row) const;

  const bool axes_;
  std::mutex mutex_;
  test::TestPlant plant_;
  std::uint64_t now_us_ = 0;
  ControllerCore core_;
  bool streaming_ = false;
  std::uint64_t next_middle_us_ = 0, sequence_ = 0;
  std::int64_t last_stamp_us_ = 0;
  std::uint32_t dropped_ = 0;
  int lit_moves_ = 0;
  std::int64_t exposing_us_ = kExposure_us;  ///< of the sensor, which follows exposure_us late
  int exposure_follows_in_ = 0;              ///< frames
  std::vector<std::int64_t> exposures_us_;
  std::deque<Shot> shots_;
};

}  // namespace celadon::testing
