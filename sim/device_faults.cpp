// What the faults of fault_plan.cpp do to the machine. Everything that varies is a function of seed and device time.
#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/device_model.h"

namespace celadon::sim {
namespace {

constexpr double kRad_per_deg = std::numbers::pi / 180;
constexpr std::uint64_t kBouncePurpose = 13;
constexpr double kWobble_hz = 3, kVibration_hz = 31;
constexpr double kFallen_mm = 1e3;

double swing(double hertz, std::int64_t time_ns) {
  return std::sin(2 * std::numbers::pi * hertz * static_cast<double>(time_ns) * 1e-9);
}

}  // namespace

void DeviceModel::strike(const std::vector<FaultOrder>& orders) {
  for (FaultOrder order : orders) {
    order.when = FaultOrder::When::time;
    order.at_ns = now_ns_;
    inject(order);
  }
}

std::int64_t DeviceModel::bounce_ns() const {
  return faults_.armed("button-chatter") ? static_cast<std::int64_t>(faults_.value("button-chatter") * 1e6) : 0;
}

bool DeviceModel::button_down() const {
  if (faults_.armed("button-stuck")) return true;
  const std::int64_t bounce = bounce_ns();
  return std::any_of(presses_.begin(), presses_.end(), [&](const Press& p) {
    const bool bounces =
        (now_ns_ >= p.from_ns && now_ns_ < p.from_ns + bounce) || (now_ns_ >= p.to_ns && now_ns_ < p.to_ns + bounce);
    if (bounces) {
      const auto millisecond = static_cast<std::uint32_t>(now_ns_ / 1'000'000);
      return random_uniform(make_key(config_.seed, kBouncePurpose, 0), millisecond) < 0.5;
    }
    return now_ns_ >= p.from_ns && now_ns_ < p.to_ns;
  });
}

std::uint32_t DeviceModel::press(std::int64_t held_ns) {
  constexpr std::int64_t kPause_ns = 100'000'000;
  const std::int64_t from = presses_.empty() ? now_ns_ : std::max(now_ns_, presses_.back().to_ns + kPause_ns);
  presses_.push_back({from, from + held_ns});
  return ++press_count_;
}

ObjectPose DeviceModel::pose_at(const Scene& scene, std::int64_t time_ns) const {
  ObjectPose pose = scene.pose();
  if (faults_.armed("object-wobble")) pose.x_mm += faults_.value("object-wobble") * swing(kWobble_hz, time_ns);
  if (faults_.armed("object-fall")) pose.x_mm += kFallen_mm;
  return pose;
}

double DeviceModel::camera_turn_at(std::int64_t time_ns) const {
  const double shake = faults_.armed("vibration") ? faults_.value("vibration") * swing(kVibration_hz, time_ns) : 0;
  const ThermalDrift& thermal = config_.thermal;
  const double warm = 1 - std::exp(-static_cast<double>(time_ns - config_.start_ns) * 1e-9 / thermal.time_constant_s);
  // In steps of a microradian, 0.002 px: a picture of the same view is made from what is known of the one before.
  const double drift = std::round(thermal.camera_turn_rad * warm * 1e6) * 1e-6;
  return camera_turn_rad_ + shake * kRad_per_deg + drift;
}

// Of a machine that has it.
DeviceModel::OtherAxis* DeviceModel::struck_axis(const std::string& name) {
  if (name.starts_with("elevation-")) return other_of(protocol::kElevation);
  return name.starts_with("lift-") ? other_of(protocol::kLift) : nullptr;
}

void DeviceModel::inject(const FaultOrder& order) {
  if (order.when != FaultOrder::When::time || order.at_ns > now_ns_) {
    faults_.schedule(order);
    return;
  }
  struck_ns_ = now_ns_;
  const std::string name = order.kind->name;
  const auto nanoseconds = static_cast<std::int64_t>(order.value * 1e6);  // of milliseconds
  if (order.kind->lasts != FaultKind::Lasts::once) faults_.arm(order, now_ns_);
  if (name == "drop-frame") camera_.lose_next(static_cast<int>(order.value));
  if (name == "encoder-slip") table_.slip_encoder(order.value * kRad_per_deg);
  if (name == "motor-slip") table_.slip_table(order.value * kRad_per_deg);
  if (name == "modbus-disconnect") disconnect_ = true;
  if (name == "clock-step") boot_ns_ -= nanoseconds;
  if (name == "stamp-step") camera_.set_stamp_step(nanoseconds);
  if (name == "controller-reset") {
    for (Laser& laser : lasers_) laser.enable(false, now_ns_);
    table_.stop(now_ns_);
    for (OtherAxis& axis : others_) axis.plant.stop(now_ns_);
    boot();
  }
  if (name == "object-slip") {
    Scene slipped = scene();
    ObjectPose pose = slipped.pose();
    const double c = std::cos(order.value * kRad_per_deg), s = std::sin(order.value * kRad_per_deg);
    pose = {c * pose.x_mm - s * pose.y_mm, s * pose.x_mm + c * pose.y_mm, pose.turn_rad + order.value * kRad_per_deg};
    slipped.set_pose(pose);
    replace_scene(std::move(slipped));
  }
  if (name == "camera-nudge") camera_turn_rad_ += order.value * kRad_per_deg;
  if (name == "delay-frames") camera_.set_extra_delay(nanoseconds);
  if (name == "laser-stuck-on" || name == "laser-hidden") lasers_[0].set_stuck_on(true, now_ns_);
  if (name == "laser-dead") lasers_[0].set_dead(true);
  if (name == "laser-flicker") lasers_[0].set_flicker(order.value);
  if (name == "motor-stall") table_.block(true, now_ns_);
  if (OtherAxis* axis = struck_axis(name)) {
    if (name.ends_with("-stall")) axis->plant.block(true, now_ns_);
    if (name == "lift-sink") axis->plant.shift(-order.value, now_ns_);
    if (name == "lift-slip") axis->plant.slip_encoder(order.value);
  }
  if (name == "steps-wrong") table_.set_gear_error(order.value, now_ns_);
  if (name == "backlash") table_.set_backlash(order.value * kRad_per_deg);
  if (name == "lights-on") ambient_ = order.value;
  if (name == "button-chatter") press(100'000'000);
  if (name == "camera-unplug") camera_.stop();
}

void DeviceModel::clear_fault(const std::string& name) {
  faults_.clear(name);
  if (name == "drop-frame") camera_.lose_next(0);
  if (name == "delay-frames") camera_.set_extra_delay(0);
  if (name == "stamp-step") camera_.set_stamp_step(0);
  if (name == "laser-stuck-on" || name == "laser-hidden") lasers_[0].set_stuck_on(false, now_ns_);
  if (name == "laser-dead") lasers_[0].set_dead(false);
  if (name == "laser-flicker") lasers_[0].set_flicker(0);
  if (name == "motor-stall") {
    table_.block(false, now_ns_);
    table_.clear_stall();
  }
  if (OtherAxis* axis = struck_axis(name); axis != nullptr && name.ends_with("-stall")) {
    axis->plant.block(false, now_ns_);
    axis->plant.clear_stall();
  }
  if (name == "steps-wrong") table_.set_gear_error(1, now_ns_);
  if (name == "backlash") table_.set_backlash(config_.turntable.backlash_rad);
  if (name == "lights-on") ambient_ = 1;
}

}  // namespace celadon::sim
