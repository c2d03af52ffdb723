#pragma once
// A virtual scanner in process, for tests.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "sim/device_model.h"
#include "sim/render_worker.h"

namespace celadon::sim {

inline constexpr std::int64_t kMs = 1'000'000, kSecond = 1'000'000'000;

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

  protocol::Exception write(const protocol::Register& r, std::vector<std::uint16_t> words) {
    return model.write_holding(r.address(), static_cast<std::uint16_t>(words.size()), words.data());
  }
  protocol::Exception lease(std::uint16_t ms) { return write(protocol::reg::control::laser_lease, {ms}); }
  protocol::Exception command(std::uint16_t code, double angle_rad = 0, double speed_rad_per_s = 1) {
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
    EXPECT_EQ(model.read_input(r.address(), 1, &word), protocol::Exception::none);
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
    ASSERT_EQ(command(protocol::kHome), protocol::Exception::none);
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

}  // namespace celadon::sim
