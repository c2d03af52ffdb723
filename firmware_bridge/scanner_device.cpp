#include "firmware_bridge/scanner_device.h"

#include <array>
#include <span>
#include <utility>

#include "firmware_bridge/device_motion.h"
#include "firmware_bridge/device_poll.h"

namespace celadon {
namespace {

using Kind = DeviceError::Kind;
namespace reg = protocol::reg;

constexpr std::int64_t kDarkLimit_ns = 500 * kMillisecond_ns;

std::string degrees(double rad) {
  return position_text(AxisKind::turntable, rad);
}

}  // namespace

struct ScannerDevice::Impl {
  Impl(std::unique_ptr<Transport> transport, Clock& clock) : machine(std::move(transport), clock) {}

  DevicePoll machine;
  DeviceMotion motion{machine};
  SafeReport found;

  // By the newest poll; stopped or broken axes forbid light.
  Refusal laser_refusal() const {
    bool fault = false, stopped = false;
    for (const MotionState state : machine.last->motion) {
      fault = fault || state == MotionState::fault;
      stopped = stopped || state == MotionState::stopped;
    }
    if (fault) return Refusal::fault;
    if (const Refusal reason = safety_refusal(machine.last->status); reason != Refusal::none) return reason;
    return stopped ? Refusal::stopped : Refusal::none;
  }
};

ScannerDevice::ScannerDevice(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

ScannerDevice::~ScannerDevice() {
  make_safe();
  DevicePoll& m = impl_->machine;
  if (m.link_is_up && m.link.token() != 0) (void)m.write(reg::control::session_end, m.link.token());
}

tl::expected<std::unique_ptr<ScannerDevice>, DeviceError> ScannerDevice::open(std::unique_ptr<Transport> transport,
                                                                              Clock& clock) {
  const std::string operation = "open";
  auto impl = std::make_unique<Impl>(std::move(transport), clock);
  DevicePoll& m = impl->machine;
  auto identity = m.link.read_identity();
  if (!identity) {
    DeviceError error = m.failure(operation, std::move(identity.error()));
    if (error.kind == Kind::wrong_protocol) {
      error.left = "its state unknown and untouched";
      error.remedy = "check the address, or update the older of controller and program";
    }
    return tl::unexpected(std::move(error));
  }
  m.identity = std::move(*identity);
  // Which axes there are has to be known to see them stand; whatever else it says is judged when the machine is safe.
  auto capabilities = m.link.read_capabilities();
  if (capabilities) m.capabilities = *capabilities;
  if (auto first = m.refresh(); !first) return tl::unexpected(m.failure(operation, std::move(first.error())));
  impl->found = impl->motion.make_safe();
  if (!capabilities) return tl::unexpected(m.failure(operation, std::move(capabilities.error())));
  if (capabilities->laser_class < protocol::kClass1 || capabilities->laser_class > protocol::kClass3R) {
    const bool is_3b = capabilities->laser_class == protocol::kClass3B;
    return tl::unexpected(m.error(
        Kind::refused, operation,
        is_3b ? "the controller declares laser class 3B"
              : "the controller declares the unknown laser class code " + std::to_string(capabilities->laser_class),
        "use a machine whose laser class is 1, 2 or 3R"));
  }
  if (!m.link_is_up || !impl->found.lasers_off || !impl->found.motor_stopped)
    return tl::unexpected(m.error(Kind::fault, operation, "it could not be made safe: " + impl->found.text,
                                  "cut the power at the machine"));
  if (auto taken = m.take_machine(operation); !taken) return tl::unexpected(std::move(taken.error()));
  m.begin_anew();
  return std::unique_ptr<ScannerDevice>(new ScannerDevice(std::move(impl)));
}

const DeviceIdentity& ScannerDevice::identity() const {
  return impl_->machine.identity;
}
const DeviceCapabilities& ScannerDevice::capabilities() const {
  return impl_->machine.capabilities;
}
const SafeReport& ScannerDevice::found_at_open() const {
  return impl_->found;
}
const LinkQuality& ScannerDevice::link_quality() const {
  return impl_->machine.link.quality();
}

tl::expected<DeviceStatus, DeviceError> ScannerDevice::poll() {
  if (auto polled = impl_->machine.poll("poll"); !polled) return tl::unexpected(std::move(polled.error()));
  return impl_->machine.last->status;
}

std::uint16_t ScannerDevice::take_button_presses() {
  return std::exchange(impl_->machine.presses, std::uint16_t{0});
}

bool ScannerDevice::tells_changes() const {
  return impl_->machine.link.tells_changes();
}

bool ScannerDevice::changed() {
  return impl_->machine.link.changed();
}

std::size_t ScannerDevice::take_trace(std::span<TraceSample> samples) {
  return impl_->machine.link.take_trace(samples);
}

tl::expected<void, DeviceError> ScannerDevice::set_motion_limits(const MotionLimits& limits) {
  return impl_->motion.set_limits(limits);
}

double ScannerDevice::run_up_rad(double speed_rad_per_s) const {
  return impl_->motion.run_up_rad(speed_rad_per_s);
}

void ScannerDevice::set_interrupt(std::function<std::optional<std::string>()> interrupted) {
  impl_->motion.interrupted = std::move(interrupted);
}

tl::expected<void, DeviceError> ScannerDevice::home() {
  return home_axis(AxisKind::turntable);
}

tl::expected<DeviceStatus, DeviceError> ScannerDevice::rotate_to(double angle_rad, double speed_rad_per_s) {
  auto turned = impl_->motion.rotate_to("rotate to " + degrees(angle_rad), angle_rad, speed_rad_per_s);
  if (!turned) return tl::unexpected(std::move(turned.error()));
  return impl_->machine.last->status;
}

tl::expected<void, DeviceError> ScannerDevice::start_sweep(double angle_rad, double speed_rad_per_s) {
  return impl_->motion.start_sweep("sweep to " + degrees(angle_rad), angle_rad, speed_rad_per_s);
}

bool ScannerDevice::has_axis(AxisKind kind) const {
  return impl_->motion.has(kind);
}

AxisLimits ScannerDevice::limits(AxisKind kind) const {
  return impl_->motion.limits_of(kind);
}

tl::expected<void, DeviceError> ScannerDevice::home_axis(AxisKind kind) {
  return impl_->motion.home(kind == AxisKind::turntable ? "home" : std::string("home the ") + axis_name(kind), kind);
}

tl::expected<void, DeviceError> ScannerDevice::move_axis(AxisKind kind, double position) {
  const std::string to = " to " + position_text(kind, position);
  if (kind == AxisKind::turntable)
    return impl_->motion.rotate_to("rotate" + to, position, capabilities().max_speed_rad_per_s);
  return impl_->motion.move_axis(std::string("move the ") + axis_name(kind) + to, kind, position);
}

tl::expected<void, DeviceError> ScannerDevice::clear_fault() {
  DevicePoll& d = impl_->machine;
  const std::string operation = "clear fault";
  if (auto polled = d.poll(operation); !polled) return polled;
  auto written = d.write(reg::control::clear_fault, 1);
  if (!written) return tl::unexpected(d.failure(operation, std::move(written.error())));
  return d.poll(operation);
}

tl::expected<void, DeviceError> ScannerDevice::stop() {
  return impl_->motion.stop("stop");
}

tl::expected<void, DeviceError> ScannerDevice::renew_laser(int laser, std::int64_t lease_ms) {
  const std::string operation = "turn laser " + std::to_string(laser) + " on";
  DevicePoll& d = impl_->machine;
  if (laser < 0 || laser >= d.capabilities.lasers)
    return tl::unexpected(
        d.error(Kind::refused, operation, "the machine has lasers 0 to " + std::to_string(d.capabilities.lasers - 1)));
  if (lease_ms < 1 || lease_ms > d.capabilities.lease_ms)
    return tl::unexpected(d.error(Kind::refused, operation,
                                  "a lease of " + std::to_string(lease_ms) + " ms is not granted",
                                  "ask for 1 to " + std::to_string(d.capabilities.lease_ms) + " ms"));
  // Where the newest poll forbids it, a fresh one decides; the controller itself judges whatever is sent.
  if (impl_->laser_refusal() != Refusal::none) {
    if (auto polled = d.poll(operation); !polled) return polled;
    if (const Refusal reason = impl_->laser_refusal(); reason != Refusal::none)
      return tl::unexpected(d.refusal(operation, reason));
  }
  auto written = d.link.write_lease(laser, lease_ms);
  if (!written) return tl::unexpected(d.failure(operation, std::move(written.error())));
  return {};
}

tl::expected<void, DeviceError> ScannerDevice::laser_off() {
  const std::string operation = "turn the lasers off";
  DevicePoll& d = impl_->machine;
  const std::array<std::uint16_t, protocol::kMaxLasers> off{};
  auto written =
      d.link.write(reg::control::laser_lease, 0, std::span(off).first(static_cast<std::size_t>(d.capabilities.lasers)));
  if (!written) return tl::unexpected(d.failure(operation, std::move(written.error())));
  auto dark = d.wait_until(operation, kDarkLimit_ns, [&] { return is_dark(*d.last); });
  if (!dark && dark.error().kind == Kind::timed_out && d.link_is_up)
    dark.error().remedy = "cut the power at the machine: a laser emits although it is switched off";
  return dark;
}

tl::expected<void, DeviceError> ScannerDevice::set_lamp(LampPattern pattern) {
  DevicePoll& d = impl_->machine;
  auto written = d.write(reg::control::lamp_pattern, static_cast<std::uint16_t>(pattern));
  if (!written) return tl::unexpected(d.failure("set lamp", std::move(written.error())));
  return {};
}

SafeReport ScannerDevice::make_safe() noexcept {
  try {
    return impl_->motion.make_safe();
  } catch (...) {
    // Out of memory, or a clock that gave up: the controller's lease and watchdog remain.
    return {};
  }
}

}  // namespace celadon
