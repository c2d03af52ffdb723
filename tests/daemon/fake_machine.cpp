#include "tests/daemon/fake_machine.h"
#include "tests/acquisition/turned_camera.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace celadon::testing {
namespace {

// The camera stands at y = -300, 60 mm above the platter, and looks along +y; the planes of the lasers hold the axis
// and leave it 30 degrees beside the camera, on both sides.
constexpr double kFocal_px = 500, kCx = 159.5, kCy = 119.5, kDistance_mm = 300, kHeight_mm = 60;
const double kAside_rad = std::numbers::pi / 6;

double aside_rad(int laser) {
  return laser == 0 ? kAside_rad : -kAside_rad;
}

// Where the further axes truly are, a little off their nominal places.
const Eigen::Vector3d kHeadOrigin_mm(0.4, -0.3, 50), kHeadDirection = Eigen::Vector3d(-1, 0.01, 0.005).normalized(),
                                                     kLiftDirection = Eigen::Vector3d(0.01, -0.005, 1).normalized();
constexpr double kHeadScale = 1.003, kLiftScale = 0.998;

constexpr double kBlackLevel = 4;  // grey levels without any light
constexpr const char* kCameraName = "fake camera 1";

class FakeTransport final : public Transport {
 public:
  explicit FakeTransport(FakeMachine& machine) : machine_(machine) {}
  tl::expected<void, LinkError> read_inputs(std::uint16_t address, std::span<std::uint16_t> words) override {
    return answer([&] { return machine_.read(protocol::Area::input, address, words); });
  }
  tl::expected<void, LinkError> read_holding(std::uint16_t address, std::span<std::uint16_t> words) override {
    return answer([&] { return machine_.read(protocol::Area::holding, address, words); });
  }
  tl::expected<void, LinkError> write_holding(std::uint16_t address, std::span<const std::uint16_t> words) override {
    return answer([&] { return machine_.write(address, words); });
  }
  tl::expected<void, LinkError> reconnect() override {
    return answer([] { return protocol::Exception::none; });
  }
  const std::string& url() const override { return url_; }
  bool has_events() const override { return machine_.tells_changes; }
  bool wait_for_event(std::int64_t /*wait_ns*/) override { return machine_.changed.exchange(false); }

 private:
  template <class Exchange>
  tl::expected<void, LinkError> answer(Exchange exchange) {
    if (machine_.link_down)
      return tl::make_unexpected(LinkError{DeviceError::Kind::lost, ECONNRESET, "cable cut", true});
    const auto exception = exchange();
    if (exception == protocol::Exception::none) return {};
    return tl::make_unexpected(LinkError{DeviceError::Kind::refused, static_cast<int>(exception), "refused", false});
  }
  FakeMachine& machine_;
  const std::string url_ = "fake:machine";
};

class FakeClock final : public Clock {
 public:
  explicit FakeClock(FakeMachine& machine) : machine_(machine) {}
  std::int64_t now_ns() override { return machine_.now_ns(); }
  void sleep_until(std::int64_t time_ns) override {
    const std::int64_t wait_ns = time_ns - machine_.now_ns();
    if (wait_ns > 0)
      machine_.advance_to_us(static_cast<std::uint64_t>((time_ns - FakeMachine::kHostOffset_ns + 999) / 1000));
  }

 private:
  FakeMachine& machine_;
};

class FakeCamera final : public FrameSource, public FrameReturn {
 public:
  explicit FakeCamera(FakeMachine& machine) : machine_(machine), buffers_(machine.buffers) {
    mode_.width_px = FakeMachine::kWidth;
    mode_.height_px = FakeMachine::kHeight;
    if (machine.camera_on_side) std::swap(mode_.width_px, mode_.height_px);
    mode_.stride_bytes = static_cast<std::size_t>(mode_.width_px);
    mode_.frame_period_ns = FakeMachine::kPeriod_us * 1000;
    mode_.exposure_ns = machine.exposure_us * 1000;
    mode_.identity = kCameraName;
    mode_.simulated = true;
  }
  ~FakeCamera() override { machine_.stream(false); }
  const CameraMode& mode() const override { return mode_; }
  tl::expected<void, CameraError> start() override {
    if (machine_.camera_unplugged) return unplugged();
    machine_.stream(true);
    return {};
  }
  void stop() noexcept override { machine_.stream(false); }
  tl::expected<Frame, CameraError> next(std::int64_t timeout_ns) override {
    if (machine_.camera_unplugged) return unplugged();
    const auto free = std::find_if(buffers_.begin(), buffers_.end(), [](const Buffer& buffer) { return !buffer.lent; });
    if (free == buffers_.end()) {
      return tl::make_unexpected(CameraError{CameraError::Kind::busy, 0, "fake: all buffers are lent"});
    }
    const auto shot = machine_.take_shot(timeout_ns / 1000);
    if (!shot) return tl::make_unexpected(CameraError{CameraError::Kind::timed_out, 0, "no frame in time"});
    free->pixels.resize(FakeMachine::kWidth * FakeMachine::kHeight);
    machine_.draw(*shot, free->pixels.data());
    if (machine_.camera_on_side) free->pixels = turned(free->pixels, FakeMachine::kWidth, FakeMachine::kHeight);
    free->lent = true;
    FrameInfo info;
    info.sequence = shot->sequence;
    info.stamp_ns = (shot->stamp_us + machine_.stamp_step_us) * 1000 + FakeMachine::kHostOffset_ns;
    info.exposure_ns = shot->claimed_us * 1000;
    info.exposure_sure = shot->exposure_sure;
    info.lost_before = shot->lost_before;
    const int every = machine_.corrupt_every;
    info.corrupt = every > 0 && shot->sequence % static_cast<std::uint64_t>(every) == 0;
    return Frame(this, static_cast<std::uint32_t>(free - buffers_.begin()), free->pixels, info);
  }
  tl::expected<void, CameraError> check_present() const override {
    if (machine_.camera_unplugged) return unplugged();
    return {};
  }
  tl::expected<std::int64_t, CameraError> set_exposure(std::int64_t exposure_ns) override {
    if (machine_.camera_unplugged) return unplugged();
    if (const int code = machine_.set_exposure((exposure_ns + 500) / 1000); code != 0) {
      return tl::make_unexpected(
          CameraError{CameraError::Kind::system, code,
                      "fake: setting the exposure failed: errno " + std::to_string(code) + "; set it by hand."});
    }
    if (!found_us_) found_us_ = mode_.exposure_ns / 1000;
    mode_.exposure_ns = machine_.exposure_us * 1000;
    return mode_.exposure_ns;
  }
  void restore_exposure() noexcept override {
    if (found_us_) machine_.set_exposure(*found_us_);
    found_us_.reset();
    mode_.exposure_ns = machine_.exposure_us * 1000;
  }
  void give_back(std::uint32_t index) noexcept override { buffers_[index].lent = false; }

 private:
  static tl::unexpected<CameraError> unplugged() {
    return tl::make_unexpected(CameraError{CameraError::Kind::unplugged, ENODEV, "The camera was unplugged."});
  }
  FakeMachine& machine_;
  CameraMode mode_;
  std::optional<std::int64_t> found_us_;  ///< before the first set_exposure()
  struct Buffer {
    std::vector<std::uint8_t> pixels;
    bool lent = false;
  };
  std::vector<Buffer> buffers_;
};

Measured exact(double value) {
  return {value, 0};
}

}  // namespace

FakeMachine::FakeMachine(std::uint16_t features, double travel_deg, bool axes)
    : axes_(axes),
      core_(
          [features, travel_deg, axes] {
            ControllerConfig config = axes ? test::three_axes() : test::test_config();
            config.axis[0].features = static_cast<std::uint16_t>(config.axis[0].features | features);
            if (travel_deg > 0) {
              config.axis[0].features = static_cast<std::uint16_t>(config.axis[0].features & ~protocol::kEndless);
              config.axis[0].travel_max_udeg = static_cast<std::int32_t>(travel_deg * 1e6);
            }
            config.safety_hardware |= protocol::kHasRemoteEnable;
            return config;
          }(),
          plant_, 1, 0) {}

double FakeMachine::vase(double theta_rad, double z_mm) {
  if (z_mm < 5 || z_mm > 100) return 0;
  return 30 + 2 * std::cos(2 * theta_rad + 0.3) + 4 * std::sin(z_mm / 20);
}

void FakeMachine::press_button() {
  const std::lock_guard lock(mutex_);
  plant_.button = true;
  core_.step(now_us_);
  advance_locked(now_us_ + 100'000);
  plant_.button = false;
  core_.step(now_us_);
  advance_locked(now_us_ + 100'000);
  changed = true;
}

void FakeMachine::with_plant(const std::function<void(test::TestPlant&)>& change) {
  const std::lock_guard lock(mutex_);
  change(plant_);
  core_.step(now_us_);
}

int FakeMachine::set_exposure(std::int64_t asked_us) {
  const std::lock_guard lock(mutex_);
  if (exposure_refusal != 0) return exposure_refusal;
  if (exposure_takes-- == 0) return EIO;
  if (exposure_fixed) return 0;
  const std::int64_t unit_us = exposure_unit_us;
  exposure_us = std::clamp((asked_us + unit_us / 2) / unit_us * unit_us, unit_us, kPeriod_us - 100);
  exposure_follows_in_ = exposure_late;
  if (exposure_follows_in_ == 0) exposing_us_ = exposure_us;
  return 0;
}

std::vector<std::int64_t> FakeMachine::exposures_us() {
  const std::lock_guard lock(mutex_);
  return exposures_us_;
}

std::uint16_t FakeMachine::lasers() {
  const std::lock_guard lock(mutex_);
  return plant_.lasers;
}

LampPattern FakeMachine::lamp() {
  const std::lock_guard lock(mutex_);
  return plant_.lamp;
}

double FakeMachine::speed() {
  const std::lock_guard lock(mutex_);
  double fastest = 0;
  for (int axis = 0; axis < (axes_ ? 3 : 1); ++axis)
    fastest = std::max(fastest, std::abs(plant_.speed_udeg(now_us_, axis)));
  return fastest;
}

int FakeMachine::lit_while_axes_moved() {
  const std::lock_guard lock(mutex_);
  return lit_moves_;
}

Calibration FakeMachine::calibration(int lasers) const {
  Calibration c;
  c.machine = "Celadon test table 0001";
  c.camera = kCameraName;
  c.date = "2026-01-01T00:00:00Z";
  c.simulated = true;
  c.camera_model = {kWidth, kHeight, exact(kFocal_px), exact(kFocal_px), exact(kCx), exact(kCy), {}};
  for (int k = 0; k < lasers; ++k) {
    LaserPlane laser;
    laser.laser = k;
    laser.normal_C = {std::cos(aside_rad(k)), 0, std::sin(aside_rad(k))};
    laser.distance_mm = std::sin(aside_rad(k)) * kDistance_mm;
    c.lasers.push_back(laser);
  }
  c.axis.X_CW.linear() << 1, 0, 0, 0, 0, -1, 0, 1, 0;
  c.axis.X_CW.translation() << 0, kHeight_mm, kDistance_mm;
  c.systematic_mm = 0.01;
  c.time = {exact(0), exact(-0.5), exact(0)};
  if (axes_) {
    c.elevation = ElevationAxis{kHeadOrigin_mm, kHeadDirection, 0, 0, exact(kHeadScale)};
    c.lift = LiftAxis{kLiftDirection, 0, exact(kLiftScale)};
  }
  return camera_on_side ? turned(c) : c;
}

tl::expected<ScannerConnection, ConnectError> FakeMachine::connect(const Calibration& calibration) {
  if (link_down) return tl::make_unexpected(ConnectError{"The machine does not answer: cable cut.", false});
  ScannerConnection connection;
  connection.clock = std::make_unique<FakeClock>(*this);
  auto device = ScannerDevice::open(std::make_unique<FakeTransport>(*this), *connection.clock);
  if (!device) return tl::make_unexpected(ConnectError{device.error().message(), false});
  connection.device = std::move(*device);
  if (camera_unplugged) return tl::make_unexpected(ConnectError{"There is no camera.", false});
  connection.camera = std::make_unique<FakeCamera>(*this);
  auto checked = check_calibration(calibration, connection.device->identity().machine, kCameraName,
                                   connection.camera->mode().width_px, connection.camera->mode().height_px);
  if (!checked) return tl::make_unexpected(ConnectError{checked.error().message, true});
  return connection;
}

std::int64_t FakeMachine::now_ns() {
  const std::lock_guard lock(mutex_);
  return kHostOffset_ns + static_cast<std::int64_t>(now_us_) * 1000;
}

void FakeMachine::advance_to_us(std::uint64_t time_us) {
  const std::lock_guard lock(mutex_);
  advance_locked(time_us);
}

void FakeMachine::advance_locked(std::uint64_t time_us) {
  while (now_us_ < time_us) {
    std::uint64_t next = std::min(time_us, now_us_ + 10'000);
    if (core_.next_deadline_us() > now_us_) next = std::min(next, core_.next_deadline_us());
    if (streaming_) next = std::min(next, next_middle_us_);
    now_us_ = next;
    core_.step(now_us_);
    if (!streaming_ || now_us_ < next_middle_us_) continue;
    if (axes_ && plant_.lasers != 0 && (plant_.speed_udeg(now_us_, 1) != 0 || plant_.speed_udeg(now_us_, 2) != 0))
      ++lit_moves_;
    const std::uint64_t sequence = sequence_++;
    const bool exposure_sure = exposure_follows_in_ == 0;
    if (!exposure_sure && --exposure_follows_in_ == 0) exposing_us_ = exposure_us;
    exposures_us_.push_back(exposing_us_);
    next_middle_us_ += kPeriod_us;
    if (all_late || sequence % 2 == 1) next_middle_us_ += static_cast<std::uint64_t>(late_us.load());
    if (shots_.size() >= buffers || camera_silent) {
      ++dropped_;
      continue;
    }
    Shot shot;
    shot.sequence = sequence;
    shot.exposure_us = exposing_us_;
    shot.exposure_sure = exposure_sure;
    shot.claimed_us = exposure_us;  // drivers know no more than what was asked
    shot.stamp_us = static_cast<std::int64_t>(now_us_) + shot.exposure_us / 2;
    last_stamp_us_ = shot.stamp_us = std::max(stamped_us(shot.stamp_us), last_stamp_us_ + 1);
    const double turned_deg = static_cast<double>(plant_.axis(0, now_us_).position_udeg) * 1e-6;
    // A slip: the object lags behind the encoder, more with every turn.
    shot.angle_rad = turned_deg * (1 - slip_per_turn_deg / 360) * std::numbers::pi / 180;
    if (axes_) {
      shot.elevation_rad = static_cast<double>(plant_.axis(1, now_us_).position_udeg) * 1e-6 * std::numbers::pi / 180;
      shot.lift_mm = static_cast<double>(plant_.axis(2, now_us_).position_udeg) * 1e-3;
    }
    shot.lasers = static_cast<std::uint16_t>(plant_.lasers | (laser_hidden ? 1 : 0));
    shot.lost_before = std::exchange(dropped_, 0);
    shots_.push_back(shot);
  }
}

protocol::Exception FakeMachine::read(protocol::Area area, std::uint16_t address, std::span<std::uint16_t> words) {
  const std::lock_guard lock(mutex_);
  advance_locked(now_us_ + kRequest_us);
  const auto count = static_cast<std::uint16_t>(words.size());
  return area == protocol::Area::input ? core_.read_input(now_us_, address, count, words.data())
                                       : core_.read_holding(now_us_, address, count, words.data());
}

protocol::Exception FakeMachine::write(std::uint16_t address, std::span<const std::uint16_t> words) {
  const std::lock_guard lock(mutex_);
  advance_locked(now_us_ + kRequest_us);
  return core_.write_holding(now_us_, address, static_cast<std::uint16_t>(words.size()), words.data());
}

void FakeMachine::stream(bool on) {
  const std::lock_guard lock(mutex_);
  if (on && !streaming_) next_middle_us_ = now_us_ + kPeriod_us;
  streaming_ = on;
  shots_.clear();
  dropped_ = 0;
}

std::optional<FakeMachine::Shot> FakeMachine::take_shot(std::int64_t timeout_us) {
  const std::lock_guard lock(mutex_);
  const std::uint64_t end_us = now_us_ + static_cast<std::uint64_t>(timeout_us);
  while (shots_.empty() || shots_.front().stamp_us > static_cast<std::int64_t>(now_us_)) {
    if (now_us_ >= end_us) return std::nullopt;
    const std::uint64_t wanted = shots_.empty() ? next_middle_us_ : static_cast<std::uint64_t>(shots_.front().stamp_us);
    advance_locked(std::min(end_us, std::max(wanted, now_us_ + 1)));
  }
  const Shot shot = shots_.front();
  shots_.pop_front();
  return shot;
}

/// Column of a laser's line in a row, where its plane meets the object, -1 without one; and how bright it is there.
FakeMachine::Line FakeMachine::line_in(int laser, const Shot& shot, int row) const {
  if ((shot.lasers >> laser & 1) == 0 || camera_dark) return {};
  if (axes_) return {line_px_with_axes(laser, shot, row), 1};
  const double aside = aside_rad(laser);
  const double world = -std::numbers::pi / 2 + aside;  // direction of the laser's half plane
  const double down = (row - kCy) / kFocal_px;
  double r = 30, z = 0;
  for (int i = 0; i < 40; ++i) {  // the row's ray meets the surface where z and r agree; a contraction
    z = kHeight_mm - (kDistance_mm - r * std::cos(aside)) * down;
    r = shape(world - shot.angle_rad, z);
    if (r <= 0) return {};
  }
  return {kCx + kFocal_px * r * std::sin(aside) / (kDistance_mm - r * std::cos(aside)),
          reflectance(world - shot.angle_rad, z)};
}

/// The same with the head turned and the table raised: the laser's plane meets the plane of the row in a line, and the
/// object where that first enters it.
double FakeMachine::line_px_with_axes(int laser, const Shot& shot, int row) const {
  const double aside = aside_rad(laser), down = (row - kCy) / kFocal_px;
  // In the camera: x cos + z sin = D sin of the angle aside, y = down z.
  const auto point_C = [&](double z) { return Eigen::Vector3d((kDistance_mm - z) * std::tan(aside), down * z, z); };
  const Eigen::AngleAxisd raised(kHeadScale * shot.elevation_rad, kHeadDirection),
      back(-shot.angle_rad, Eigen::Vector3d::UnitZ());
  const auto inside = [&](double z) {
    const Eigen::Vector3d c = point_C(z);
    const Eigen::Vector3d low(c.x(), c.z() - kDistance_mm, kHeight_mm - c.y());  // of the head at 0
    const Eigen::Vector3d world = kHeadOrigin_mm + raised * (low - kHeadOrigin_mm);
    const Eigen::Vector3d p = back * (world - kLiftScale * shot.lift_mm * kLiftDirection);
    return std::hypot(p.x(), p.y()) < shape(std::atan2(p.y(), p.x()), p.z());
  };
  constexpr double kFirst_mm = 160, kLast_mm = 440, kStep_mm = 3;
  for (double z = kFirst_mm; z < kLast_mm; z += kStep_mm) {
    if (!inside(z)) continue;
    double outer = z - kStep_mm, inner = z;
    for (int i = 0; i < 30; ++i) (inside((outer + inner) / 2) ? inner : outer) = (outer + inner) / 2;
    return kCx + kFocal_px * point_C(inner).x() / inner;
  }
  return -1;
}

/// The lines of the lasers, one Gaussian a row, on a background with fixed texture.
void FakeMachine::draw(const Shot& shot, std::uint8_t* pixels) const {
  std::uint32_t random = static_cast<std::uint32_t>(shot.sequence) * 2654435761u + 12345u;
  const auto noise = [&] {
    random = random * 1664525u + 1013904223u;
    return static_cast<double>(random >> 24) / 256 * 4 - 2;
  };
  for (int row = 0; row < kHeight; ++row) {
    const Line lines[] = {line_in(0, shot, row), line_in(1, shot, row)};
    for (int column = 0; column < kWidth; ++column) {
      double light = 8 + column % 7;
      for (const Line& line : lines) {
        const double off = (column - line.x_px) / 1.6;
        if (line.x_px >= 0) light += 150 * line.reflectance * std::exp(-off * off / 2);
      }
      const double level = kBlackLevel + light * static_cast<double>(shot.exposure_us) / kExposure_us + noise();
      pixels[row * kWidth + column] = static_cast<std::uint8_t>(std::clamp(level, 0., 255.));
    }
  }
}

}  // namespace celadon::testing
