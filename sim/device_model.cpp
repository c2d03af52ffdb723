#include "sim/device_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <numbers>
#include <stdexcept>
#include <utility>

namespace celadon::sim {
namespace {

constexpr std::int64_t kTick_ns = 1'000'000;
constexpr std::size_t kHistory = 512;  // ticks: exposure, read-out and a late renderer
constexpr double kDegree = std::numbers::pi / 180;
constexpr std::uint64_t kStartAnglePurpose = 3, kStartAxesPurpose = 22;
constexpr double kUdeg_per_rad = 1e6 / kDegree, kUm_per_mm = 1e3;
constexpr const char* kVendor = "Celadon";
constexpr const char* kModel = "Virtual Scanner";

std::int64_t to_udeg(double rad) {
  return std::llround(rad / kDegree * 1e6);
}
double from_udeg(std::int64_t udeg) {
  return static_cast<double>(udeg) * 1e-6 * kDegree;
}

/// Errors as Scene::make.
tl::expected<Scene, std::string> scene_of(const std::string& name, const DeviceConfig& config) {
  auto scene = Scene::make(name, config.print);
  if (!scene) return scene;
  scene->set_rim_tags(config.rim_tags);
  if (config.texture) scene->set_texture(*config.texture);
  scene->set_paint(config.paint);
  return scene;
}

Scene checked_scene(const DeviceConfig& config) {
  auto scene = scene_of(config.scene, config);
  if (!scene) throw std::invalid_argument(scene.error());
  return *std::move(scene);
}

}  // namespace

std::string utc_date(std::int64_t unix_seconds) {
  const auto t = static_cast<std::time_t>(unix_seconds);
  std::tm parts{};
  gmtime_r(&t, &parts);
  std::array<char, 32> text{};
  (void)std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text.data();
}

DeviceConfig default_device(const CameraConfig& camera, double sheet_offset_mm, double sheet_tilt_rad) {
  DeviceConfig config;
  config.camera = camera;
  config.optics = default_optics(camera.width_px, camera.height_px, sheet_offset_mm, sheet_tilt_rad);
  config.optics.format = camera.format;
  return config;
}

DeviceModel::DeviceModel(const DeviceConfig& config)
    : config_(config),
      placed_{{INT64_MIN, std::make_shared<const Scene>(checked_scene(config))}},
      table_([&] {
        TurntableConfig t = config.turntable;
        t.start_angle_rad = 2 * std::numbers::pi * random_uniform(make_key(config.seed, kStartAnglePurpose, 0), 0);
        return t;
      }()),
      lasers_{Laser(config.laser, config.seed), Laser(config.laser, config.seed + 1)},
      camera_(config.camera, config.start_ns),
      now_ns_(config.start_ns),
      boot_ns_(config.start_ns),
      next_tick_ns_(config.start_ns) {
  if (config_.date.empty()) config_.date = utc_date(std::time(nullptr));
  // At power-on they stand somewhere in the middle half of their travel.
  const auto started = [&](TravelAxisConfig drive, std::uint32_t number) {
    const double share = 0.25 + 0.5 * random_uniform(make_key(config_.seed, kStartAxesPurpose, 0), number);
    drive.start = drive.lowest + share * (drive.highest - drive.lowest);
    return drive;
  };
  if (config_.optics.axes.elevation)
    others_.emplace_back(protocol::kElevation, kUdeg_per_rad, started(config_.elevation, 0));
  if (config_.optics.axes.lift) others_.emplace_back(protocol::kLift, kUm_per_mm, started(config_.lift, 1));
  tick();
  boot();
}

void DeviceModel::boot() {
  boot_ns_ = now_ns_;
  sample_ = {};
  for (OtherAxis& axis : others_) axis.sample = {};
  ControllerConfig c;
  c.vendor = kVendor;
  c.model = kModel;
  c.serial = config_.serial.c_str();
  c.simulated = true;
  c.lasers = static_cast<std::uint16_t>(laser_count());
  c.locked_at_start = config_.locked_at_start;
  c.safety_hardware |= protocol::kHasRemoteEnable;
  c.axis[0].encoder_resolution_ndeg =
      static_cast<std::uint32_t>(std::llround(table_.encoder_quantum_rad() / kDegree * 1e9));
  c.axis[0].max_speed_udeg_per_s = static_cast<std::uint32_t>(to_udeg(config_.turntable.max_speed_rad_per_s));
  c.axis[0].max_acceleration_udeg_per_s2 =
      static_cast<std::uint32_t>(to_udeg(config_.turntable.max_acceleration_rad_per_s2));
  c.axis[0].features |= protocol::kTakesJerk;
  for (const OtherAxis& axis : others_) {
    ControllerConfig::Axis& a = c.axis[c.axes++];
    const TravelAxisConfig& drive = axis.plant.config();
    const auto units = [&](double value) { return std::llround(value * axis.microunits); };
    a.kind = axis.kind;
    a.features = protocol::kHasIndex | protocol::kClosedLoop;
    a.travel_min_udeg = static_cast<std::int32_t>(units(drive.lowest));
    a.travel_max_udeg = static_cast<std::int32_t>(units(drive.highest));
    a.encoder_resolution_ndeg = static_cast<std::uint32_t>(units(1e3 * drive.quantum));
    a.max_speed_udeg_per_s = static_cast<std::uint32_t>(units(drive.max_speed));
    a.max_acceleration_udeg_per_s2 = static_cast<std::uint32_t>(units(drive.max_acceleration));
  }
  core_.emplace(c, static_cast<Plant&>(*this), ++boots_, std::uint64_t{0});
}

void DeviceModel::tick() {
  history_.push_back(motion_now());
  if (history_.size() > kHistory) history_.pop_front();
  while (!presses_.empty() && presses_.front().to_ns + bounce_ns() <= now_ns_) presses_.pop_front();
  next_tick_ns_ += kTick_ns;
  if (!core_) return;
  if (table_.index_found(now_ns_)) strike(faults_.due_at_angle(table_.encoder_rad(now_ns_) / kDegree));
  core_->step(controller_us());
  if (lasers_that_emit() != 0) {
    dark_since_ns_ = 0;
  } else if (dark_since_ns_ == 0) {
    dark_since_ns_ = now_ns_;
  }
  if (core_->fault() == FaultCode::none) {
    fault_since_ns_ = 0;
  } else if (fault_since_ns_ == 0) {
    fault_since_ns_ = now_ns_;
  }
  if (sampled_) sampled_();
}

MotionRecord::Sample DeviceModel::motion_now() {
  MotionRecord::Sample s{table_.table_angle_rad(now_ns_), table_.table_speed_rad_per_s(now_ns_),
                         lasers_[0].power(now_ns_), lasers_[1].power(now_ns_)};
  const MachineAxes& axes = config_.optics.axes;
  if (OtherAxis* e = other_of(protocol::kElevation)) {
    s.elevation_rad = axes.elevation->scale * e->plant.position(now_ns_);
    s.elevation_rad_per_s = axes.elevation->scale * e->plant.speed(now_ns_);
  }
  if (OtherAxis* l = other_of(protocol::kLift)) {
    s.lift_mm = axes.lift->scale * l->plant.position(now_ns_);
    s.lift_mm_per_s = axes.lift->scale * l->plant.speed(now_ns_);
  }
  return s;
}

DeviceModel::OtherAxis* DeviceModel::other_of(std::uint16_t kind) {
  const auto found =
      std::find_if(others_.begin(), others_.end(), [kind](const OtherAxis& a) { return a.kind == kind; });
  return found == others_.end() ? nullptr : &*found;
}

void DeviceModel::advance_to(std::int64_t time_ns) {
  while (now_ns_ < time_ns) {
    now_ns_ = std::min({time_ns, next_tick_ns_, std::max(now_ns_ + 1, faults_.next_ns())});
    for (const std::string& name : faults_.over(now_ns_)) clear_fault(name);
    strike(faults_.due(now_ns_));
    if (now_ns_ >= next_tick_ns_) tick();
    camera_.advance(now_ns_);
    render_frames();
  }
}

std::int64_t DeviceModel::next_event_ns() const {
  return std::min(camera_.next_event_ns(), faults_.next_ns());
}

protocol::Exception DeviceModel::read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  return core_->read_input(controller_us(), address, count, words);
}
protocol::Exception DeviceModel::read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  return core_->read_holding(controller_us(), address, count, words);
}
protocol::Exception DeviceModel::write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) {
  return core_->write_holding(controller_us(), address, count, words);
}

std::uint16_t DeviceModel::lasers_that_emit() const {
  return static_cast<std::uint16_t>((lasers_[0].emits(now_ns_) ? 1 : 0) | (lasers_[1].emits(now_ns_) ? 2 : 0));
}

PlantInputs DeviceModel::inputs(std::uint64_t /*now_us*/) {
  PlantInputs in;
  in.interlock_closed = !faults_.armed("interlock-open");
  in.emergency_stop = faults_.armed("emergency-stop");
  in.button = button_down();
  in.remote_enabled = !faults_.armed("remote-off");
  in.lasers_measured = lasers_that_emit();
  if (faults_.armed("laser-hidden") && !lasers_[0].enabled()) in.lasers_measured &= 0xfffe;
  return in;
}

// Drives sample their encoders once a millisecond.
AxisSample DeviceModel::axis(int axis, std::uint64_t now_us) {
  OtherAxis* const one = other(axis);
  return one != nullptr ? other_sample(*one, now_us) : table_sample(now_us);
}

AxisSample DeviceModel::other_sample(OtherAxis& axis, std::uint64_t now_us) {
  AxisSample& s = axis.sample;
  const std::uint64_t at_us = now_us / 1000 * 1000;
  if (s.counter == 0 || at_us != s.time_us) {
    const std::int64_t at_ns = std::min(boot_ns_ + static_cast<std::int64_t>(at_us) * 1000, now_ns_);
    s.time_us = at_us;
    s.counter = ++axis.samples_taken;
    s.position_udeg = std::llround(axis.plant.encoder(at_ns) * axis.microunits);
    s.speed_udeg_per_s = static_cast<std::int32_t>(std::llround(axis.plant.speed(at_ns) * axis.microunits));
  }
  const TravelAxis::Phase phase = axis.plant.phase(now_ns_);
  s.index_found = axis.plant.index_found(now_ns_);
  s.fault = axis.plant.stalled()  ? FaultCode::motor_stalled
            : axis.plant.at_end() ? FaultCode::travel_limit
                                  : FaultCode::none;
  s.phase = phase == TravelAxis::Phase::standing ? AxisPhase::standing
            : phase == TravelAxis::Phase::moving ? AxisPhase::moving
                                                 : AxisPhase::settling;
  if (s.phase == AxisPhase::standing) s.speed_udeg_per_s = 0;
  return s;
}

AxisSample DeviceModel::table_sample(std::uint64_t now_us) {
  const std::uint64_t at_us = now_us / 1000 * 1000;
  if (samples_taken_ == 0 || at_us != sample_.time_us || sample_.counter == 0) {
    const std::int64_t at_ns = std::min(boot_ns_ + static_cast<std::int64_t>(at_us) * 1000, now_ns_);
    sample_.time_us = at_us;
    sample_.counter = ++samples_taken_;
    sample_.position_udeg = to_udeg(table_.encoder_rad(at_ns));
    sample_.speed_udeg_per_s = static_cast<std::int32_t>(to_udeg(table_.encoder_speed_rad_per_s(at_ns)));
  }
  sample_.index_found = table_.index_found(now_ns_);
  sample_.fault = table_.stalled() ? FaultCode::motor_stalled : FaultCode::none;
  switch (table_.phase(now_ns_)) {
    case Turntable::Phase::standing:
      sample_.phase = AxisPhase::standing;
      break;
    case Turntable::Phase::moving:
      sample_.phase = AxisPhase::moving;
      break;
    case Turntable::Phase::settling:
      sample_.phase = AxisPhase::settling;
      break;
  }
  if (sample_.phase == AxisPhase::standing) sample_.speed_udeg_per_s = 0;
  return sample_;
}

void DeviceModel::home(int axis, std::uint64_t /*now_us*/) {
  if (OtherAxis* one = other(axis)) return one->plant.home(now_ns_);
  table_.home(now_ns_);
}
void DeviceModel::move(int axis, std::int64_t target_udeg, std::uint32_t speed_udeg_per_s,
                       std::uint32_t acceleration_udeg_per_s2, std::uint32_t jerk_mdeg_per_s3,
                       std::uint64_t /*now_us*/) {
  if (OtherAxis* one = other(axis)) {
    const double unit = 1 / one->microunits;
    return one->plant.move(static_cast<double>(target_udeg) * unit, speed_udeg_per_s * unit,
                           acceleration_udeg_per_s2 * unit, now_ns_);
  }
  table_.move(from_udeg(target_udeg), from_udeg(speed_udeg_per_s), from_udeg(acceleration_udeg_per_s2), now_ns_,
              from_udeg(std::int64_t{jerk_mdeg_per_s3} * 1000));
}
void DeviceModel::stop(int axis, std::uint64_t /*now_us*/) {
  if (OtherAxis* one = other(axis)) return one->plant.stop(now_ns_);
  table_.stop(now_ns_);
}
void DeviceModel::release(int axis, std::uint64_t /*now_us*/) {
  if (OtherAxis* one = other(axis)) return one->plant.release(now_ns_);
  table_.release(now_ns_);
}
void DeviceModel::set_lasers(std::uint16_t mask, std::uint64_t /*now_us*/) {
  lasers_[0].enable((mask & 1) != 0, now_ns_);
  lasers_[1].enable((mask & 2) != 0, now_ns_);
}
void DeviceModel::set_lamp(LampPattern /*pattern*/, std::uint64_t /*now_us*/) {}  // the core knows what it shows

MotionRecord DeviceModel::record(std::int64_t from_ns, std::int64_t to_ns) const {
  const std::int64_t newest = next_tick_ns_ - kTick_ns;
  const std::int64_t oldest = newest - static_cast<std::int64_t>(history_.size() - 1) * kTick_ns;
  const auto index = [&](std::int64_t t) {
    return std::clamp<std::int64_t>((t - oldest) / kTick_ns, 0, static_cast<std::int64_t>(history_.size()) - 1);
  };
  const std::int64_t first = index(from_ns),
                     last = std::min<std::int64_t>(index(to_ns) + 1, static_cast<std::int64_t>(history_.size()) - 1);
  MotionRecord out;
  out.first_ns = oldest + first * kTick_ns;
  out.step_ns = kTick_ns;
  out.samples.assign(history_.begin() + first, history_.begin() + last + 1);
  return out;
}

void DeviceModel::render_frames() {
  // Of frames read out before the last tick, so that the motion over the whole exposure is on record.
  while (FrameTicket* ticket = camera_.take_to_render(next_tick_ns_ - kTick_ns)) {
    strike(faults_.due_at_frame(ticket->sequence));
    if (camera_unplugged()) return;  // with all its frames
    ticket->corrupt = faults_.strikes("corrupt-frame");
    if (faults_.strikes("short-frame")) ticket->bytes_used /= 2;
    RenderOrder order;
    order.number = ticket->number;
    order.slot = ticket->slot;
    order.corrupt = ticket->corrupt;
    order.stale = faults_.strikes("stale-frame");
    if (faults_.strikes("duplicate-frame") && last_stamp_ns_ != INT64_MIN) {
      order.stale = true;
      ticket->stamp_ns = last_stamp_ns_;
    }
    last_stamp_ns_ = ticket->stamp_ns;
    const std::int64_t middle_ns = ticket->first_row_end_ns - ticket->exposure_ns / 2;
    order.scene = scene_at(middle_ns);
    order.pose = pose_at(*order.scene, middle_ns);
    order.camera_turn_rad = camera_turn_at(middle_ns);
    Exposure& e = order.exposure;
    e.seed = config_.seed;
    e.frame = ticket->number;
    e.first_row_end_ns = ticket->first_row_end_ns;
    e.exposure_ns = ticket->exposure_ns;
    e.line_time_ns = config_.camera.line_time_ns();
    e.motion = record(ticket->first_row_end_ns - ticket->exposure_ns, ticket->complete_ns);
    e.ambient_factor = ambient_;
    if (!render_ || render_(order)) camera_.mark_rendered(order.number);
  }
}

tl::expected<void, std::string> DeviceModel::put(const std::string& name) {
  auto scene = scene_of(name, config_);
  if (!scene) return tl::unexpected(scene.error());
  replace_scene(*std::move(scene));
  return {};
}

void DeviceModel::replace_scene(Scene scene) {
  constexpr std::int64_t kOldest_ns = static_cast<std::int64_t>(kHistory) * kTick_ns;
  while (placed_.size() > 1 && placed_[1].from_ns < now_ns_ - kOldest_ns) placed_.pop_front();
  placed_.push_back({now_ns_, std::make_shared<const Scene>(std::move(scene))});
}

std::shared_ptr<const Scene> DeviceModel::scene_at(std::int64_t time_ns) const {
  const auto later = std::find_if(placed_.begin() + 1, placed_.end(),
                                  [time_ns](const Placed& placed) { return placed.from_ns > time_ns; });
  return std::prev(later)->scene;
}

std::optional<FrameTicket> DeviceModel::advance_to_frame(std::int64_t until_ns) {
  while (true) {
    if (auto ticket = camera_.take(now_ns_)) return ticket;
    if (now_ns_ >= until_ns || camera_unplugged()) return std::nullopt;
    const std::int64_t event = next_event_ns();
    advance_to(std::min(until_ns, event > now_ns_ ? event : next_tick_ns_));
  }
}

DeviceState DeviceModel::state() {
  DeviceState s;
  s.angle_rad = table_.table_angle_rad(now_ns_);
  s.speed_rad_per_s = table_.table_speed_rad_per_s(now_ns_);
  s.motor_speed_rad_per_s = table_.motor_speed_rad_per_s(now_ns_);
  s.motion = core_->motion(0);
  const MotionRecord::Sample motion = motion_now();
  for (std::size_t i = 0; i < others_.size(); ++i) {
    const bool elevation = others_[i].kind == protocol::kElevation;
    (elevation ? s.elevation : s.lift) = {elevation ? motion.elevation_rad : motion.lift_mm,
                                          core_->motion(static_cast<int>(i) + 1)};
  }
  s.lasers_on = lasers_that_emit();
  s.lease_left_ms = core_->lease_left_ms(0);
  s.lamp = core_->lamp();
  s.fault = core_->fault();
  s.interlock_closed = !faults_.armed("interlock-open");
  s.local_action_needed = core_->local_action_needed();
  s.time_ns = now_ns_;
  s.dark_since_ns = dark_since_ns_;
  s.fault_since_ns = fault_since_ns_;
  s.struck_ns = struck_ns_;
  s.faults = faults_.names_armed();
  return s;
}

std::string DeviceModel::machine() const {
  return std::string(kVendor) + " " + kModel + " " + config_.serial;
}
std::string DeviceModel::camera_identity() const {
  return "Celadon Virtual Camera " + config_.serial;
}

Calibration DeviceModel::calibration() const {
  // The parameters are exact; their uncertainties are those of doubles. What the model of a thin sheet can not express
  // is in systematic_mm.
  const OpticsConfig& o = config_.optics;
  const CameraIntrinsics& in = o.camera;
  Calibration c;
  c.machine = machine();
  c.camera = camera_identity();
  c.date = config_.date;
  c.simulated = true;
  c.camera_model.width_px = in.width_px;
  c.camera_model.height_px = in.height_px;
  c.camera_model.fx_px = {in.fx_px, 1e-6};
  c.camera_model.fy_px = {in.fy_px, 1e-6};
  c.camera_model.cx_px = {in.cx_px, 1e-6};
  c.camera_model.cy_px = {in.cy_px, 1e-6};
  c.camera_model.distortion = {Measured{in.k1, 1e-9}, Measured{in.k2, 1e-9}, Measured{in.p1, 1e-9},
                               Measured{in.p2, 1e-9}, Measured{in.k3, 1e-9}};
  for (int laser = 0; laser < laser_count(); ++laser) {
    const LaserSheet& sheet = laser == 0 ? o.sheet : *o.second_sheet;
    LaserPlane plane;
    plane.laser = laser;
    plane.normal_C = o.X_CW.linear() * sheet.normal_W;
    plane.normal_C.normalize();
    plane.distance_mm = sheet.distance_mm + plane.normal_C.dot(o.X_CW.translation());
    plane.u_normal_rad = 1e-9;
    plane.u_distance_mm = 1e-6;
    c.lasers.push_back(plane);
  }
  c.axis.X_CW = o.X_CW;
  c.axis.u_direction_rad = 1e-9;
  c.axis.u_position_mm = 1e-6;
  if (o.axes.elevation) {
    ElevationAxis& e = c.elevation.emplace();
    e.origin_mm = o.axes.elevation->origin_S;
    e.direction = o.axes.elevation->direction_S;
    e.u_direction_rad = 1e-9;
    e.u_origin_mm = 1e-6;
    e.scale = {o.axes.elevation->scale, 1e-9};
  }
  if (o.axes.lift) {
    LiftAxis& l = c.lift.emplace();
    l.direction = o.axes.lift->direction_S;
    l.u_direction_rad = 1e-9;
    l.scale = {o.axes.lift->scale, 1e-9};
  }
  // e (sin(b + phase) - sin(phase)), as turntable.h has it.
  const double e = config_.turntable.encoder_eccentricity_rad;
  c.encoder = {{1, 1e-9}, {e * std::sin(kEccentricPhase_rad), 1e-9}, {e * std::cos(kEccentricPhase_rad), 1e-9}, 1};
  c.scale = {1, 1e-9};
  c.systematic_mm = 2.5 * o.sheet.sigma_mm * o.sheet.sigma_mm / 30;  // README.md, "What a line really shows"
  c.time.stamp_offset_ns = {-static_cast<double>(config_.camera.stamp_latency_ns), 1};
  c.time.exposure_factor = {-0.5, 1e-9};
  c.time.line_time_ns = {static_cast<double>(config_.camera.line_time_ns()), 1e-3};
  const std::vector<PrintedCorner> corners = RimTags(config_.rim_tags).corners();
  for (std::size_t k = 0; k + 3 < corners.size(); k += 4) {  // from the lower left on, against the clock
    c.rim_tags.push_back({corners[k].id, {corners[k + 3].p, corners[k + 2].p, corners[k + 1].p, corners[k].p}, 1e-6});
  }
  return c;
}

}  // namespace celadon::sim
