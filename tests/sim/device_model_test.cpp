#include "sim/device_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sim/render_worker.h"

namespace celadon::sim {
namespace {

using protocol::Exception;
constexpr std::int64_t kMs = 1'000'000, kSecond = 1'000'000'000;

/// A small machine with its pictures, driven through its registers.
struct Rig {
  explicit Rig(const std::string& scene = "humidifier", std::uint64_t seed = 1, Shutter shutter = Shutter::global)
      : model([&] {
          CameraConfig camera;
          camera.width_px = 160;
          camera.height_px = 128;
          camera.shutter = shutter;
          DeviceConfig c = default_device(camera);
          c.scene = scene;
          c.seed = seed;
          c.date = "2026-01-02T03:04:05Z";
          return c;
        }()),
        slots(4 * 160 * 128),
        painter(model.scene(), model.config().optics, model.config().camera, slots, 160 * 128) {
    model.set_render([this](const DeviceModel::RenderOrder& order) {
      painter.paint(order);
      return true;
    });
  }

  Exception write(const protocol::Register& r, std::vector<std::uint16_t> words) {
    return model.write_holding(r.address(), static_cast<std::uint16_t>(words.size()), words.data());
  }
  Exception lease(std::uint16_t ms) { return write(protocol::reg::control::laser_lease, {ms}); }
  Exception command(std::uint16_t code, double angle_rad = 0, double speed_rad_per_s = 1) {
    const std::int64_t target = std::llround(angle_rad * 180e6 / std::numbers::pi);
    std::uint16_t block[10] = {};
    const protocol::SplitAngle split = protocol::split_turns(target);
    protocol::put_s32(block, split.angle_udeg);
    protocol::put_s32(block + 2, split.turns);
    protocol::put_u32(block + 4, static_cast<std::uint32_t>(std::llround(speed_rad_per_s * 180e6 / std::numbers::pi)));
    block[8] = ++sequence;
    block[9] = code;
    return model.write_holding(protocol::groups::axis_command.address(), 10, block);
  }
  std::uint16_t status(const protocol::Register& r) {
    std::uint16_t word = 0;
    EXPECT_EQ(model.read_input(r.address(), 1, &word), Exception::none);
    return word;
  }
  /// Polls every 20 ms, as a host does: reading heartbeat_left is the sign of life.
  void live(std::int64_t duration_ns) {
    for (const std::int64_t end = model.now_ns() + duration_ns; model.now_ns() < end;) {
      status(protocol::reg::status::heartbeat_left);
      model.advance_to(std::min(end, model.now_ns() + 20 * kMs));
    }
  }
  void stand() {
    for (int i = 0; i < 2000 && model.state().motion != MotionState::standstill; ++i) live(10 * kMs);
    ASSERT_EQ(model.state().motion, MotionState::standstill);
  }
  void home() {
    ASSERT_EQ(command(protocol::kHome), Exception::none);
    live(20 * kMs);
    stand();
  }
  void inject(const std::string& name, const std::vector<std::string>& arguments = {}) {
    model.inject(*make_fault(name, arguments));
  }
  std::span<const std::uint8_t> picture(const FrameTicket& t) const {
    return std::span(slots).subspan(t.slot * 160 * 128, 160 * 128);
  }
  int brightest(const FrameTicket& t) const {
    const auto p = picture(t);
    return *std::max_element(p.begin(), p.end());
  }

  DeviceModel model;
  std::vector<std::uint8_t> slots;
  SlotPainter painter;
  std::uint16_t sequence = 0;
};

TEST(DeviceModel, HomesAndMovesToTheTarget) {
  Rig rig;
  rig.home();
  EXPECT_NEAR(std::remainder(rig.model.state().angle_rad, 2 * std::numbers::pi), 0, 5e-5);
  ASSERT_EQ(rig.command(protocol::kMove, 1.25), Exception::none);
  rig.live(20 * kMs);
  EXPECT_EQ(rig.model.state().motion, MotionState::moving);
  rig.stand();
  EXPECT_NEAR(std::remainder(rig.model.state().angle_rad - 1.25, 2 * std::numbers::pi), 0, 5e-5);
  std::uint16_t words[4] = {};
  ASSERT_EQ(rig.model.read_input(protocol::reg::axis_status::angle.address(), 4, words), Exception::none);
  EXPECT_NEAR(protocol::get_s32(words) * 1e-6, 1.25 * 180 / std::numbers::pi, 0.003);
}

// The host falls silent with the laser on: the lease ends in device time, nobody has to ask.
TEST(DeviceModel, LeaseEndsAfterTheHostIsGone) {
  Rig rig;
  ASSERT_EQ(rig.lease(500), Exception::none);
  const std::int64_t granted = rig.model.now_ns();
  rig.model.advance_to(granted + 499 * kMs);
  EXPECT_EQ(rig.model.state().lasers_on, 1);
  rig.model.advance_to(granted + 502 * kMs);
  EXPECT_EQ(rig.model.state().lasers_on, 0);
  // Looking at the state is no sign of life.
  ASSERT_EQ(rig.lease(500), Exception::none);
  for (int i = 0; i < 502; ++i) {
    rig.model.advance_to(rig.model.now_ns() + kMs);
    rig.model.state();
  }
  EXPECT_EQ(rig.model.state().lasers_on, 0);
}

TEST(DeviceModel, FramesAfterAMoveAreStaleFirst) {
  Rig rig;
  rig.home();
  rig.model.camera().start(rig.model.now_ns());
  rig.live(kSecond);  // nobody takes frames: four of them wait
  ASSERT_EQ(rig.command(protocol::kMove, 2.0), Exception::none);
  const std::int64_t moved = rig.model.now_ns();
  rig.live(20 * kMs);
  rig.stand();
  for (int i = 0; i < 4; ++i) {
    const auto frame = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->sequence, static_cast<std::uint64_t>(i));
    EXPECT_LT(frame->stamp_ns, moved);
    rig.model.camera().give_back(frame->slot);
  }
  const auto fresh = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
  ASSERT_TRUE(fresh);
  EXPECT_GT(fresh->sequence, 60U);  // a gap of the frames that found no slot
  EXPECT_GT(fresh->stamp_ns, moved);
}

TEST(DeviceModel, FramesArriveLateByTheDelay) {
  Rig rig;
  rig.model.camera().start(rig.model.now_ns());
  const auto frame = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
  ASSERT_TRUE(frame);
  const CameraConfig& c = rig.model.config().camera;
  EXPECT_EQ(rig.model.now_ns(), frame->stamp_ns - c.stamp_latency_ns + c.readout_ns + c.delay_ns);
  rig.inject("delay-frames", {"250"});
  const auto next = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
  EXPECT_TRUE(next);
  const auto later = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
  ASSERT_TRUE(later);
  EXPECT_EQ(rig.model.now_ns(), later->stamp_ns - c.stamp_latency_ns + c.readout_ns + c.delay_ns + 250 * kMs);
}

std::vector<std::uint8_t> scripted_run(std::uint64_t seed, Shutter shutter) {
  Rig rig("humidifier", seed, shutter);
  rig.home();
  rig.lease(500);
  rig.model.camera().start(rig.model.now_ns());
  rig.command(protocol::kMove, 3, 0.5);
  std::vector<std::uint8_t> all;
  for (int i = 0; i < 25; ++i) {
    rig.lease(500);
    const auto frame = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
    EXPECT_TRUE(frame);
    if (!frame) break;
    const auto p = rig.picture(*frame);
    all.insert(all.end(), p.begin(), p.end());
    for (int b = 0; b < 8; ++b) all.push_back(static_cast<std::uint8_t>(frame->stamp_ns >> (8 * b)));
    rig.model.camera().give_back(frame->slot);
  }
  const DeviceState s = rig.model.state();
  all.push_back(static_cast<std::uint8_t>(std::llround(s.angle_rad * 1e12) & 0xff));
  return all;
}

TEST(DeviceModel, SameSeedSameBytes) {
  for (const Shutter shutter : {Shutter::global, Shutter::rolling}) {
    const auto first = scripted_run(5, shutter);
    EXPECT_EQ(first, scripted_run(5, shutter));
    EXPECT_NE(first, scripted_run(6, shutter));
  }
}

// The calibration's time model names the middle of each row's exposure.
TEST(DeviceModel, TimeModelIsTrue) {
  for (const Shutter shutter : {Shutter::global, Shutter::rolling}) {
    Rig rig("cylinder", 1, shutter);
    const TimeModel t = rig.model.calibration().time;
    std::vector<DeviceModel::RenderOrder> orders;
    rig.model.set_render([&](const DeviceModel::RenderOrder& o) {
      orders.push_back(o);
      return true;
    });
    rig.model.camera().start(rig.model.now_ns());
    const auto frame = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
    ASSERT_TRUE(frame && !orders.empty());
    const Exposure& e = orders.front().exposure;
    for (const int row : {0, 64, 127}) {
      const double by_model = static_cast<double>(frame->stamp_ns) + t.stamp_offset_ns.value +
                              t.exposure_factor.value * static_cast<double>(frame->exposure_ns) +
                              row * t.line_time_ns.value;
      const double middle =
          static_cast<double>(e.first_row_end_ns + row * e.line_time_ns) - static_cast<double>(e.exposure_ns) / 2;
      EXPECT_NEAR(by_model, middle, 1);
    }
    EXPECT_EQ(t.line_time_ns.value > 0, shutter == Shutter::rolling);
  }
}

TEST(DeviceModel, CalibrationIsReadBackAndBelongsToTheMachine) {
  Rig rig;
  const Calibration c = rig.model.calibration();
  const auto read = parse_calibration(format_calibration(c), "truth");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_TRUE(read->simulated);
  EXPECT_EQ(read->date, "2026-01-02T03:04:05Z");
  EXPECT_TRUE(check_calibration(*read, rig.model.machine(), rig.model.camera_identity(), 160, 128));
  EXPECT_EQ(rig.model.machine(), "Celadon Virtual Scanner SIM-0001");
  // The plane holds the sheet: a point of it in the camera's frame.
  const LaserSheet& sheet = rig.model.config().optics.sheet;
  const Eigen::Vector3d p_W =
      sheet.emitter_W + Eigen::Vector3d(-300, 0, 0) + 100 * sheet.normal_W.cross(Eigen::Vector3d::UnitX());
  EXPECT_NEAR(read->lasers[0].normal_C.dot(read->axis.X_CW * p_W) - read->lasers[0].distance_mm,
              sheet.normal_W.dot(p_W) - sheet.distance_mm, 1e-9);
  EXPECT_GT(c.camera_model.fx_px.u, 0);
  EXPECT_GT(c.time.stamp_offset_ns.u, 0);
}

TEST(DeviceModel, PressesAreCountedAndDebounced) {
  Rig rig;
  EXPECT_EQ(rig.model.press(100 * kMs), 1U);
  EXPECT_EQ(rig.model.press(100 * kMs), 2U);  // after the first
  rig.live(kSecond);
  EXPECT_EQ(rig.status(protocol::reg::status::button_presses), 2);
  rig.inject("button-stuck");
  rig.live(kSecond);
  EXPECT_EQ(rig.status(protocol::reg::status::button_presses), 3);
  rig.live(kSecond);
  EXPECT_EQ(rig.status(protocol::reg::status::button_presses), 3);
}

TEST(DeviceModel, FaultsOfTheCamera) {
  Rig rig;
  CameraTimeline& camera = rig.model.camera();
  camera.start(rig.model.now_ns());
  const auto next = [&] {
    auto t = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
    EXPECT_TRUE(t);
    if (t) camera.give_back(t->slot);
    return t.value_or(FrameTicket{});
  };
  const std::uint64_t first = next().sequence;
  rig.inject("drop-frame", {"3"});
  std::uint64_t last = first, widest = 0;
  for (int i = 0; i < 5; ++i) {
    const std::uint64_t s = next().sequence;
    widest = std::max(widest, s - last);
    last = s;
  }
  EXPECT_EQ(widest, 4U);

  rig.inject("corrupt-frame", {"2"});
  int corrupt = 0;
  for (int i = 0; i < 6; ++i) corrupt += next().corrupt ? 1 : 0;
  EXPECT_EQ(corrupt, 2);
  rig.inject("short-frame");
  int halves = 0;
  for (int i = 0; i < 6; ++i) halves += next().bytes_used == 160 * 128 / 2 ? 1 : 0;
  EXPECT_EQ(halves, 1);

  const auto last_picture = rig.picture(next());
  std::vector<std::uint8_t> before(last_picture.begin(), last_picture.end());
  rig.inject("stale-frame");
  int same = 0;
  for (int i = 0; i < 6; ++i) {
    const FrameTicket t = next();
    const auto p = rig.picture(t);
    const std::vector<std::uint8_t> now(p.begin(), p.end());
    same += now == before ? 1 : 0;
    before = now;
  }
  EXPECT_EQ(same, 1);

  rig.inject("camera-unplug");
  EXPECT_TRUE(rig.model.camera_unplugged());
  EXPECT_FALSE(rig.model.advance_to_frame(rig.model.now_ns() + kSecond));
  rig.model.clear_fault("camera-unplug");
  camera.start(rig.model.now_ns());
  EXPECT_EQ(next().sequence, 0U);
}

TEST(DeviceModel, FaultsOfTheMachine) {
  {
    Rig rig;
    rig.home();
    rig.lease(400);
    rig.live(100 * kMs);
    rig.inject("interlock-open");
    rig.live(20 * kMs);
    EXPECT_EQ(rig.model.state().lasers_on, 0);
    EXPECT_EQ(rig.model.state().fault, FaultCode::interlock_opened);
    EXPECT_EQ(rig.lease(400), Exception::refused);
  }
  {
    Rig rig;
    rig.inject("laser-stuck-on");
    rig.live(500 * kMs);
    EXPECT_EQ(rig.model.state().lasers_on, 1);
    EXPECT_EQ(rig.model.state().fault, FaultCode::laser_stuck_on);
  }
  {
    Rig rig;
    rig.inject("laser-dead");
    rig.lease(400);
    rig.live(100 * kMs);
    EXPECT_EQ(rig.model.state().lasers_on, 0);
  }
  {
    Rig rig;
    rig.home();
    rig.command(protocol::kMove, 3);
    rig.live(300 * kMs);
    rig.inject("motor-stall");
    rig.live(100 * kMs);
    EXPECT_EQ(rig.model.state().fault, FaultCode::motor_stalled);
    rig.model.clear_fault("motor-stall");
    rig.live(100 * kMs);
    EXPECT_EQ(rig.write(protocol::reg::control::clear_fault, {1}), Exception::none);
  }
  {
    Rig rig;
    rig.home();
    rig.inject("emergency-stop");
    rig.live(20 * kMs);
    EXPECT_EQ(rig.model.state().fault, FaultCode::emergency_stop);
  }
  {
    Rig rig;
    rig.home();
    rig.lease(500);
    const std::uint16_t before = rig.status(protocol::reg::status::boot_id);
    rig.inject("controller-reset");
    rig.live(10 * kMs);
    EXPECT_NE(rig.status(protocol::reg::status::boot_id), before);
    EXPECT_EQ(rig.model.state().motion, MotionState::unhomed);
    EXPECT_EQ(rig.model.state().lasers_on, 0);
  }
}

// Faults that only a measurement reveals: the encoder says one thing, the table does another.
TEST(DeviceModel, FaultsThatTheControllerCanNotSee) {
  Rig rig;
  rig.home();
  rig.inject("encoder-slip", {"2"});
  ASSERT_EQ(rig.command(protocol::kMove, 0), Exception::none);
  rig.live(20 * kMs);
  rig.stand();
  EXPECT_NEAR(std::remainder(rig.model.state().angle_rad, 2 * std::numbers::pi), -2 * std::numbers::pi / 180, 1e-4);
  rig.inject("object-slip", {"10"});
  const Scene plain = *Scene::make("humidifier");
  EXPECT_NEAR(rig.model.scene().truth_r_mm(1, 40), plain.truth_r_mm(1 - 10 * std::numbers::pi / 180, 40), 1e-12);
  rig.inject("steps-wrong", {"1.1"});
  const double from = rig.model.state().angle_rad;
  ASSERT_EQ(rig.command(protocol::kMove, 1), Exception::none);
  rig.live(20 * kMs);
  rig.stand();
  EXPECT_NEAR(rig.model.state().angle_rad - from, 1.1, 1e-3);
}

TEST(DeviceModel, FaultsOfTheLight) {
  Rig rig("cylinder");
  CameraTimeline& camera = rig.model.camera();
  camera.start(rig.model.now_ns());
  const auto brightest = [&] {
    int level = 0;
    for (int i = 0; i < 6; ++i) {
      const auto t = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
      EXPECT_TRUE(t);
      if (!t) return 0;
      level = rig.brightest(*t);
      camera.give_back(t->slot);
    }
    return level;
  };
  const int dark = brightest();
  rig.inject("lights-on");
  EXPECT_GT(brightest(), 2 * dark);
  rig.model.clear_fault("lights-on");
  EXPECT_LT(brightest(), dark + 10);
  rig.lease(500);
  EXPECT_GT(brightest(), dark + 30);
}

TEST(DeviceModel, ScheduledFaultsStrikeAtTheirTime) {
  Rig rig;
  rig.model.inject(*parse_fault_option("interlock-open@0.5", rig.model.now_ns()));
  const std::int64_t start = rig.model.now_ns();
  rig.model.advance_to(start + 499 * kMs);
  EXPECT_TRUE(rig.model.state().interlock_closed);
  rig.model.advance_to(start + 501 * kMs);
  EXPECT_FALSE(rig.model.state().interlock_closed);
}

}  // namespace
}  // namespace celadon::sim
