#include "daemon/calibration/board_passes.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

namespace celadon {
namespace {

using Stop = tl::unexpected<ScanStop>;

constexpr double kFast_rad_per_s = 36 * std::numbers::pi / 180;
constexpr double kSlow = 0.4;             // of the fast speed
constexpr double kShorter = 0.4;          // of the usual exposure
constexpr int kMostViews = 16;            // of a pass: corners take longer to find than frames to come
constexpr int kFewestViews = 6;           // frames within the way of the fastest pass
constexpr int kFramesAtRest = 20;         // after which the table has stopped short
constexpr double kSpeedMayDiffer = 0.02;  // from what was ordered: the run-up is no part of a pass
constexpr double kNarrowest_rad = 0.05;   // half of a way that is worth a pass
constexpr std::int64_t kShorterSettles_ns = 200'000'000;

struct Taken {
  FrameInfo info;
  std::vector<std::uint8_t> bytes;
};

/// At most kMostViews frames, evenly, whose stamps lie within the way from one angle to the other.
tl::expected<std::vector<Taken>, ScanStop> frames_between(const PassTools& tools, double from_rad, double to_rad,
                                                          double speed_rad_per_s) {
  ScannerDevice& device = *tools.equipment.device;
  const double sense = to_rad > from_rad ? 1 : -1;
  const double period_s = 1e-9 * static_cast<double>(tools.equipment.camera.mode().frame_period_ns);
  const double frames = std::abs(to_rad - from_rad) / (speed_rad_per_s * period_s);
  const auto every = std::max(1, static_cast<int>(std::ceil(frames / kMostViews)));
  const double run_up_rad = sense * (device.run_up_rad(speed_rad_per_s) + 4 * speed_rad_per_s * period_s);
  // From further back, so that a gear's play is taken up before the sweep.
  for (const double start_rad : {from_rad - 2 * run_up_rad, from_rad - run_up_rad}) {
    auto settled = device.rotate_to(start_rad, device.capabilities().max_speed_rad_per_s);
    if (!settled) return Stop(stop_of(settled.error()));
  }
  if (auto fresh = tools.feed.next_after(tools.equipment.clock.now_ns()); !fresh) return Stop(fresh.error());
  if (auto moving = device.start_sweep(to_rad + run_up_rad, speed_rad_per_s); !moving) {
    return Stop(stop_of(moving.error()));
  }
  std::vector<Taken> taken;
  int within = 0;
  for (int at_rest = 0; at_rest <= kFramesAtRest;) {
    auto frame = tools.feed.next();
    if (!frame) return Stop(frame.error());
    at_rest = tools.feed.status().motion == MotionState::moving ? 0 : at_rest + 1;
    const auto angle = tools.feed.timeline().at(frame->info.stamp_ns);
    if (!angle || sense * (angle->angle_rad - from_rad) < 0) continue;
    if (sense * (angle->angle_rad - to_rad) > 0) break;
    if (within++ % every == every / 2) taken.push_back({frame->info, {frame->bytes().begin(), frame->bytes().end()}});
  }
  if (auto rested = tools.feed.come_to_rest(); !rested) return Stop(rested.error());
  return taken;
}

tl::expected<BoardSweep, ScanStop> take_pass(const PassTools& tools, int placement, double from_rad, double to_rad,
                                             double speed_rad_per_s) {
  auto frames = frames_between(tools, from_rad, to_rad, speed_rad_per_s);
  if (!frames) return Stop(frames.error());
  BoardSweep sweep{.placement = placement, .views = {}};
  for (const Taken& frame : *frames) {
    // Now that position samples lie on both sides of the stamp.
    const auto angle = tools.feed.timeline().at(frame.info.stamp_ns);
    const bool steady =
        angle && std::abs(std::abs(angle->speed_rad_per_s) - speed_rad_per_s) < kSpeedMayDiffer * speed_rad_per_s;
    if (steady) sweep.views.push_back({*angle, frame.info.exposure_ns, tools.find(frame.bytes)});
    if (auto polled = tools.feed.poll(); !polled) return Stop(polled.error());
  }
  return sweep;
}

/// @return nullopt where the table cannot turn that far
std::optional<double> clipped_half_width(const ScannerDevice& device, double middle_rad, double half_width_rad,
                                         double speed_rad_per_s, double period_s) {
  const AxisLimits travel = device.limits(AxisKind::turntable);
  const double beyond_rad = 2 * (device.run_up_rad(speed_rad_per_s) + 4 * speed_rad_per_s * period_s);
  const double half_rad =
      std::min({half_width_rad, middle_rad - travel.lowest - beyond_rad, travel.highest - beyond_rad - middle_rad});
  if (half_rad < kNarrowest_rad) return std::nullopt;
  return half_rad;
}

}  // namespace

tl::expected<std::vector<BoardSweep>, ScanStop> take_passes(const PassTools& tools, int placement, double middle_rad,
                                                            double half_width_rad) {
  FrameSource& camera = tools.equipment.camera;
  const double period_s = static_cast<double>(camera.mode().frame_period_ns) * 1e-9;
  const ScannerDevice& device = *tools.equipment.device;
  const double fast = std::min(
      {kFast_rad_per_s, device.capabilities().max_speed_rad_per_s, 2 * half_width_rad / (kFewestViews * period_s)});
  const auto half = clipped_half_width(device, middle_rad, half_width_rad, fast, period_s);
  if (!half) return std::vector<BoardSweep>{{.placement = placement, .views = {}}};
  std::vector<BoardSweep> sweeps;
  const auto to_and_fro = [&](double speed) -> tl::expected<void, ScanStop> {
    for (const double side : {1., -1.}) {
      auto pass = take_pass(tools, placement, middle_rad - side * *half, middle_rad + side * *half, speed);
      if (!pass) return Stop(pass.error());
      sweeps.push_back(std::move(*pass));
    }
    return {};
  };
  for (const double speed : {fast, kSlow * fast}) {
    if (auto passed = to_and_fro(speed); !passed) return Stop(passed.error());
  }
  const std::int64_t usual_ns = camera.mode().exposure_ns;
  // A camera that takes no other exposure leaves its share in the stamp to what is assumed.
  if (const auto set = camera.set_exposure(std::llround(kShorter * static_cast<double>(usual_ns))); !set) {
    return sweeps;
  }
  const auto settled = [&]() -> tl::expected<void, ScanStop> {
    auto frame = tools.feed.next_after(tools.equipment.clock.now_ns() + kShorterSettles_ns);
    if (!frame) return Stop(frame.error());
    return {};
  };
  const auto passed = settled().and_then([&] { return to_and_fro(fast); });
  if (auto back = camera.set_exposure(usual_ns); passed && !back) return Stop(stop_of(back.error()));
  if (!passed) return Stop(passed.error());
  return sweeps;
}

}  // namespace celadon
