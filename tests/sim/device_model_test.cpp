#include "sim/device_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "tests/sim/device_rig.h"

namespace celadon::sim {
namespace {

using protocol::Exception;
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

}  // namespace
}  // namespace celadon::sim
