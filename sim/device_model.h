#pragma once
// One machine on one clock: controller core, table, laser, button, lamp and camera. Used by one thread.

#include <array>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibration.h"
#include "firmware_bridge/controller_core.h"
#include "sim/camera.h"
#include "sim/exposure.h"
#include "sim/fault_plan.h"
#include "sim/laser.h"
#include "sim/optics.h"
#include "sim/scene.h"
#include "sim/travel_axis.h"
#include "sim/turntable.h"

namespace celadon::sim {

struct DeviceConfig {
  std::string scene = "vase";
  int rim_tags = 0;                      ///< fiducials round the platter's edge
  std::optional<std::uint64_t> texture;  ///< seed of the object's; nullopt: it has none
  Paint paint;                           ///< on the object
  PrintErrors print;                     ///< of boards
  std::uint64_t seed = 1;
  std::string serial = "SIM-0001";
  std::string date;              ///< of the calibration, ISO 8601; empty: the day of the start
  bool locked_at_start = false;  ///< a press of the button is needed before anything moves or shines
  TurntableConfig turntable;
  TravelAxisConfig elevation = elevation_drive(), lift = lift_drive();  ///< where optics.axes says that there are such
  LaserConfig laser;
  ThermalDrift thermal;
  CameraConfig camera;
  OpticsConfig optics;                    ///< camera size and format follow `camera`
  std::int64_t start_ns = 1'000'000'000;  ///< the device's clock at power-on
};

/// The configuration of the default machine for a camera.
DeviceConfig default_device(const CameraConfig& camera, double sheet_offset_mm = 0.3, double sheet_tilt_rad = 0.002);

/// What the control socket's `state` tells: how things are, not what the controller believes.
struct DeviceState {
  double angle_rad = 0, speed_rad_per_s = 0;  ///< of the table
  double motor_speed_rad_per_s = 0;
  MotionState motion = MotionState::unhomed;
  struct OtherAxis {
    double position = 0;  ///< rad or mm, true
    MotionState motion = MotionState::unhomed;
  };
  std::optional<OtherAxis> elevation, lift;
  std::uint16_t lasers_on = 0;  ///< that emit
  std::uint32_t lease_left_ms = 0;
  LampPattern lamp = LampPattern::off;
  FaultCode fault = FaultCode::none;
  bool interlock_closed = false, local_action_needed = false;
  std::int64_t time_ns = 0;
  std::int64_t dark_since_ns = 0;   ///< no laser emits since then; 0 while one does
  std::int64_t fault_since_ns = 0;  ///< the controller has a fault code since then; 0 without
  std::int64_t struck_ns = 0;       ///< when the newest fault came; 0: none yet
  std::vector<std::string> faults;  ///< that are armed
};

class DeviceModel final : private Plant {
 public:
  /// @throws std::invalid_argument if Scene::make refuses config.scene
  explicit DeviceModel(const DeviceConfig& config);
  DeviceModel(const DeviceModel&) = delete;
  DeviceModel& operator=(const DeviceModel&) = delete;

  std::int64_t now_ns() const { return now_ns_; }
  /// Lets everything happen up to that time; earlier times do nothing.
  void advance_to(std::int64_t time_ns);
  /// The next instant at which something happens that a client may wait for.
  std::int64_t next_event_ns() const;

  // The controller's registers, at the present instant.
  protocol::Exception read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words);
  protocol::Exception read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words);
  protocol::Exception write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words);

  CameraTimeline& camera() { return camera_; }
  /// A frame that is ready to be rendered, with all that the renderer needs.
  struct RenderOrder {
    std::uint64_t number = 0;
    std::uint32_t slot = 0;
    bool corrupt = false;
    bool stale = false;  ///< keep the bytes of the frame before
    Exposure exposure;
    std::shared_ptr<const Scene> scene;
    ObjectPose pose;
    double camera_turn_rad = 0;  ///< the camera was nudged
  };
  /// Called from advance_to() for every frame that has been read out, in order. Returns true if the picture is done,
  /// false if camera().mark_rendered() will be called later.
  void set_render(std::function<bool(const RenderOrder&)> render) { render_ = std::move(render); }
  /// Called after each millisecond's step of the controller.
  void set_sampled(std::function<void()> sampled) { sampled_ = std::move(sampled); }
  /// Advances the clock until a frame has arrived, the time is over or the camera is gone.
  std::optional<FrameTicket> advance_to_frame(std::int64_t until_ns);

  /// Pushes the button for that long, after presses under way. @returns the number of presses so far
  std::uint32_t press(std::int64_t held_ns);
  void inject(const FaultOrder& order);
  void clear_fault(const std::string& name);
  FaultPlan& faults() { return faults_; }
  bool camera_unplugged() const { return faults_.armed("camera-unplug"); }
  /// Set once by modbus-disconnect; reading resets it.
  bool take_disconnect() { return std::exchange(disconnect_, false); }

  DeviceState state();
  /// What stands on the table now.
  const Scene& scene() const { return *placed_.back().scene; }
  /// Puts something else there, between two frames: those whose exposure's middle is over show what was there before.
  /// Errors as Scene::make.
  tl::expected<void, std::string> put(const std::string& scene);
  const DeviceConfig& config() const { return config_; }
  std::string machine() const;
  std::string camera_identity() const;
  /// The true parameters.
  Calibration calibration() const;

 private:
  PlantInputs inputs(std::uint64_t now_us) override;
  AxisSample axis(int axis, std::uint64_t now_us) override;
  void home(int axis, std::uint64_t now_us) override;
  void move(int axis, std::int64_t target_udeg, std::uint32_t speed_udeg_per_s, std::uint32_t acceleration_udeg_per_s2,
            std::uint32_t jerk_mdeg_per_s3, std::uint64_t now_us) override;
  void stop(int axis, std::uint64_t now_us) override;
  void release(int axis, std::uint64_t now_us) override;
  void set_lasers(std::uint16_t mask, std::uint64_t now_us) override;
  void set_lamp(LampPattern pattern, std::uint64_t now_us) override;

  /// An axis besides the table: its plant, and what the drive says.
  struct OtherAxis {
    explicit OtherAxis(std::uint16_t kind_, double units, const TravelAxisConfig& config)
        : kind(kind_), microunits(units), plant(config) {}
    std::uint16_t kind;  ///< protocol::kElevation or kLift
    double microunits;   ///< of the protocol in one rad or mm
    TravelAxis plant;
    AxisSample sample;
    std::uint32_t samples_taken = 0;
  };
  OtherAxis* other(int axis) { return axis > 0 ? &others_[static_cast<std::size_t>(axis - 1)] : nullptr; }
  OtherAxis* other_of(std::uint16_t kind);
  AxisSample table_sample(std::uint64_t now_us);
  AxisSample other_sample(OtherAxis& axis, std::uint64_t now_us);
  MotionRecord::Sample motion_now();

  void boot();
  void tick();
  // device_faults.cpp
  void strike(const std::vector<FaultOrder>& orders);
  OtherAxis* struck_axis(const std::string& name);
  bool button_down() const;
  int laser_count() const { return config_.optics.second_sheet ? 2 : 1; }
  std::uint16_t lasers_that_emit() const;
  std::int64_t bounce_ns() const;
  ObjectPose pose_at(const Scene& scene, std::int64_t time_ns) const;
  double camera_turn_at(std::int64_t time_ns) const;
  std::uint64_t controller_us() const {
    return now_ns_ > boot_ns_ ? static_cast<std::uint64_t>(now_ns_ - boot_ns_) / 1000 : 0;
  }
  void render_frames();
  void replace_scene(Scene scene);
  std::shared_ptr<const Scene> scene_at(std::int64_t time_ns) const;
  MotionRecord record(std::int64_t from_ns, std::int64_t to_ns) const;

  DeviceConfig config_;
  struct Placed {
    std::int64_t from_ns;
    std::shared_ptr<const Scene> scene;
  };
  std::deque<Placed> placed_;  ///< what stands on the table, and what stood there when frames under way were exposed
  Turntable table_;
  std::vector<OtherAxis> others_;  ///< axis blocks 1 and up: elevation before lift
  std::array<Laser, 2> lasers_;
  CameraTimeline camera_;
  FaultPlan faults_;
  std::int64_t now_ns_, boot_ns_, next_tick_ns_;
  std::uint16_t boots_ = 0;
  std::optional<ControllerCore> core_;
  AxisSample sample_;
  std::uint32_t samples_taken_ = 0;
  struct Press {
    std::int64_t from_ns, to_ns;
  };
  std::deque<Press> presses_;
  std::uint32_t press_count_ = 0;
  std::deque<MotionRecord::Sample> history_;  ///< one a millisecond, the last at next_tick_ns_ - 1 ms
  double ambient_ = 1;
  double camera_turn_rad_ = 0;
  std::int64_t last_stamp_ns_ = INT64_MIN, dark_since_ns_ = 0, fault_since_ns_ = 0, struck_ns_ = 0;
  bool disconnect_ = false;
  std::function<bool(const RenderOrder&)> render_;
  std::function<void()> sampled_;
};

/// "2026-05-17T09:30:00Z" of a system time.
std::string utc_date(std::int64_t unix_seconds);

}  // namespace celadon::sim
