// Elevation axis and lift of the virtual machine, against formulas that are written out here.

#include "sim/machine_axes.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <string>
#include <utility>
#include <vector>

#include "sim/device_truth.h"
#include "sim/renderer.h"
#include "sim/scene.h"
#include "tests/sim/device_rig.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;
using protocol::Exception;
constexpr double kDegrees = std::numbers::pi / 180;
constexpr int kColumns = 1280, kRows = 1024;

/// Rodrigues' formula: p turned about the line (origin, unit direction).
Vector3d about(const Vector3d& origin, const Vector3d& direction, double angle, const Vector3d& p) {
  const Vector3d v = p - origin;
  return origin + v * std::cos(angle) + direction.cross(v) * std::sin(angle) +
         direction * direction.dot(v) * (1 - std::cos(angle));
}

/// A point of the table in the scanner frame, and how the head sees it: as if it had been turned back.
Vector3d stands_at(const MachineAxes& axes, const Posture& at, const Vector3d& p_T) {
  const double c = std::cos(at.table_rad), s = std::sin(at.table_rad);
  return Vector3d(c * p_T.x() - s * p_T.y(), s * p_T.x() + c * p_T.y(), p_T.z()) + at.lift_mm * axes.lift->direction_S;
}
Vector3d seen_at(const MachineAxes& axes, const Posture& at, const Vector3d& p_T) {
  return about(axes.elevation->origin_S, axes.elevation->direction_S, -at.elevation_rad, stands_at(axes, at, p_T));
}

OpticsConfig plain_optics() {
  OpticsConfig c = default_optics(kColumns, kRows, 0.7, 0.01);
  c.sheet.sigma_mm = 0.01;
  c.blur_px = 1;
  c.reflection = 0;
  c.speckle_contrast = 0;
  c.ambient_low = c.ambient_high = c.object_ambient = 0;
  c.noise = {10, 1e9F, 0.001F};
  c.axes = draw_axes(5, c.X_CW, true, true);
  return c;
}

DeviceConfig machine_with_axes(std::uint64_t seed, bool elevation = true, bool lift = true) {
  CameraConfig camera;
  camera.width_px = 160;
  camera.height_px = 128;
  DeviceConfig c = default_device(camera);
  c.seed = seed;
  c.date = "2026-01-02T03:04:05Z";
  c.optics.axes = draw_axes(seed, c.optics.X_CW, elevation, lift);
  return c;
}

TEST(MachineAxes, AreNominalButForSmallErrorsOfTheSeed) {
  const OpticsConfig c = default_optics(kColumns, kRows, 0, 0);
  const Vector3d view = c.X_CW.linear().row(2);
  double spread = 0;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    const MachineAxes axes = draw_axes(seed, c.X_CW, true, true);
    EXPECT_NEAR(axes.elevation->direction_S.norm(), 1, 1e-12);
    EXPECT_LT(std::abs(axes.elevation->direction_S.z()), 0.0031);
    EXPECT_LT(std::abs(axes.elevation->direction_S.dot(view)), 0.0045);
    EXPECT_NEAR(axes.elevation->origin_S.z(), 60, 0.51);
    EXPECT_LT(axes.elevation->origin_S.head<2>().norm(), 0.41);
    EXPECT_NEAR(axes.elevation->scale, 1, 1.01e-3);
    EXPECT_LT(axes.lift->direction_S.head<2>().norm(), 0.003);
    EXPECT_NEAR(axes.lift->scale, 1, 5.1e-4);
    spread = std::max(spread, std::abs(axes.elevation->scale - 1));
    // Positive raises the head: the camera comes to lie higher.
    const Vector3d camera = c.X_CW.inverse(Eigen::Isometry) * Vector3d::Zero();
    const Vector3d raised = about(axes.elevation->origin_S, axes.elevation->direction_S, 0.3, camera);
    EXPECT_GT(raised.z(), camera.z() + 50);
  }
  EXPECT_GT(spread, 5e-4) << "they are errors";
  EXPECT_FALSE(draw_axes(1, c.X_CW, false, false).any());
}

// The camera's own picture of known points at any posture, by OpenCV's projection.
TEST(MachineAxes, PointsAreSeenWhereTheKinematicsSay) {
  DeviceConfig device = machine_with_axes(3);
  const Scene scene = *Scene::make("board:tags:6x5x9@3,-4,55,5,-12,20");
  const OpticsConfig& o = device.optics;
  const CameraIntrinsics& in = o.camera;
  int compared = 0;
  for (const Posture& at :
       {Posture{0.1, 0, 0}, Posture{-0.3, 0.6, 0}, Posture{0.4, -0.15, 12}, Posture{0.2, 0.9, -20}}) {
    const auto corners = corners_of(device, scene, at);
    for (const auto& corner : corners) {
      const auto printed = scene.corners();
      const auto p_T = std::find_if(printed.begin(), printed.end(), [&](const PrintedCorner& c) {
                         return c.id == corner["id"] && c.corner == corner["corner"];
                       })->p;
      const Vector3d p_S = stands_at(o.axes, at, p_T);
      for (int i = 0; i < 3; ++i) EXPECT_NEAR(corner["p_mm"][static_cast<std::size_t>(i)].get<double>(), p_S[i], 1e-9);
      // X_CS(e) = X_CS(0) R_E(e)^-1.
      const Vector3d p_C =
          o.X_CW * about(o.axes.elevation->origin_S, o.axes.elevation->direction_S, -at.elevation_rad, p_S);
      std::vector<cv::Point2d> pixel;
      cv::projectPoints(std::vector<cv::Point3d>{{p_C.x(), p_C.y(), p_C.z()}}, cv::Vec3d(0, 0, 0), cv::Vec3d(0, 0, 0),
                        cv::Matx33d(in.fx_px, 0, in.cx_px, 0, in.fy_px, in.cy_px, 0, 0, 1),
                        cv::Vec<double, 5>(in.k1, in.k2, in.p1, in.p2, in.k3), pixel);
      EXPECT_NEAR(corner["x_px"].get<double>(), pixel[0].x, 1e-8);
      EXPECT_NEAR(corner["y_px"].get<double>(), pixel[0].y, 1e-8);
      ++compared;
    }
  }
  EXPECT_GT(compared, 40);
}

struct MovingCase {
  Posture at, speed;  ///< speed: a second
  std::int64_t line_time_ns;
};
std::ostream& operator<<(std::ostream& out, const MovingCase& c) {
  return out << c.at.elevation_rad / kDegrees << " degrees, " << c.at.lift_mm << " mm";
}
class ThinSheetWithAxes : public testing::TestWithParam<MovingCase> {};

// The line of a thin sheet lies where surface, sheet and row meet, in closed form; each row at its own instant.
TEST_P(ThinSheetWithAxes, LineLiesWhereTheKinematicsSay) {
  const MovingCase& p = GetParam();
  const OpticsConfig c = plain_optics();
  const Scene scene = *Scene::make("vase-squeezed");
  Renderer renderer(scene, c);
  Exposure e;
  e.seed = 1;
  e.exposure_ns = 4'000'000;
  e.first_row_end_ns = 50'000'000;
  e.line_time_ns = p.line_time_ns;
  const auto posture = [&](double seconds) {
    return Posture{p.at.table_rad + p.speed.table_rad * seconds, p.at.elevation_rad + p.speed.elevation_rad * seconds,
                   p.at.lift_mm + p.speed.lift_mm * seconds};
  };
  for (int i = 0; i < 100; ++i) {
    const Posture now = posture(1e-3 * i);
    e.motion.samples.push_back({now.table_rad, p.speed.table_rad, 1, 0, now.elevation_rad, p.speed.elevation_rad,
                                now.lift_mm, p.speed.lift_mm});
  }
  std::vector<float> image;
  renderer.render_line(e, image);
  int rows = 0;
  double worst = 0, theta = -p.at.table_rad, z = 60 - p.at.lift_mm;
  const VirtualCamera camera(c.camera, c.X_CW);
  for (int y = kRows - 60; y > 40; --y) {
    double sum = 0, moment = 0;
    for (int x = 0; x < kColumns; ++x) {
      const auto v = static_cast<double>(image[static_cast<std::size_t>(y * kColumns + x)]);
      sum += v;
      moment += v * x;
    }
    const double middle_ns =
        static_cast<double>(e.first_row_end_ns + y * e.line_time_ns) - 0.5 * static_cast<double>(e.exposure_ns);
    const Posture now = posture(middle_ns * 1e-9);
    const auto point = [&](double t, double h) {
      const double r = scene.truth_r_mm(t, h);
      return seen_at(c.axes, now, {r * std::cos(t), r * std::sin(t), h});
    };
    const auto off = [&](double t, double h) {
      const Vector3d q = point(t, h);
      return Eigen::Vector2d(c.sheet.normal_W.dot(q) - c.sheet.distance_mm, camera.project(q).y() - y);
    };
    double t = theta, h = std::clamp(z, 5.0, 110.0);
    bool found = false;
    for (int i = 0; i < 40 && !found; ++i) {
      constexpr double kStep = 1e-6;
      const Eigen::Vector2d f = off(t, h);
      Eigen::Matrix2d j;
      j.col(0) = (off(t + kStep, h) - f) / kStep;
      j.col(1) = (off(t, h + kStep) - f) / kStep;
      const Eigen::Vector2d step = j.partialPivLu().solve(f);
      t -= std::clamp(step[0], -0.2, 0.2);
      h = std::clamp(h - std::clamp(step[1], -5.0, 5.0), 0.5, scene.z_max_mm() - 0.5);
      found = step.norm() < 1e-10;
    }
    if (!found || h < 3 || h > scene.z_max_mm() - 3 || sum < 1) continue;
    theta = t;
    z = h;
    ++rows;
    worst = std::max(worst, std::abs(moment / sum - camera.project(point(t, h)).x()));
  }
  EXPECT_GT(rows, 250);
  EXPECT_LT(worst, p.speed == Posture{} ? 1e-3 : 2e-3);
}
INSTANTIATE_TEST_SUITE_P(Postures, ThinSheetWithAxes,
                         testing::Values(MovingCase{{0.6, 0, 0}, {}, 0}, MovingCase{{0.6, 0.44, 0}, {}, 0},
                                         MovingCase{{0.6, -0.15, 0}, {}, 0}, MovingCase{{1.1, 0.3, -25}, {}, 0},
                                         MovingCase{{1.1, 0, 30}, {}, 0},
                                         MovingCase{{0.3, 0.35, 5}, {0, 0.4, 0}, 13'671},
                                         MovingCase{{0.3, 0.2, 5}, {0.6, 0, 30}, 13'671}));

// From each pixel into the scene, and from there to the laser: tops that only a raised head sees, shadows, the platter.
TEST(MachineAxes, EveryPixelShowsWhatHeadAndLiftSay) {
  OpticsConfig c = plain_optics();
  c.sheet.sigma_mm = 0.3;
  c.blur_px = 0.05;
  c.platter_albedo = 0.8;
  const Scene scene = *Scene::make("stepped-shaft");
  const Posture at{0, 0.6, -8};
  Exposure e;
  e.exposure_ns = 4'000'000;
  for (int i = 0; i < 20; ++i) e.motion.samples.push_back({0, 0, 1, 0, at.elevation_rad, 0, at.lift_mm, 0});
  Renderer renderer(scene, c);
  std::vector<float> image;
  renderer.render_line(e, image);
  const VirtualCamera camera(c.camera, c.X_CW);
  // Of the head's frame in the table's, by three points.
  const MachineAxes& axes = c.axes;
  const auto to_table = [&](const Vector3d& p_H) -> Vector3d {
    return about(axes.elevation->origin_S, axes.elevation->direction_S, at.elevation_rad, p_H) -
           at.lift_mm * axes.lift->direction_S;
  };
  const auto ray_to_table = [&](const Vector3d& from_H, const Vector3d& d_H) {
    const Vector3d p = to_table(from_H);
    return Ray{p, to_table(from_H + d_H) - p};
  };
  int lit = 0, dark = 0, wrong = 0, on_tops = 0;
  for (int y = 5; y < kRows; y += 5) {
    for (int x = 300; x < kColumns; ++x) {
      const double rendered = static_cast<double>(image[static_cast<std::size_t>(y * kColumns + x)]);
      const auto hit = scene.intersect(ray_to_table(camera.centre_W(), camera.ray_W(x, y)));
      double expected = 0;
      if (hit) {
        const Vector3d p_H = seen_at(axes, at, hit->p);
        const double s = c.sheet.normal_W.dot(p_H) - c.sheet.distance_mm;
        const Vector3d from_H = c.sheet.emitter_W + s * c.sheet.normal_W;
        const Ray beam = ray_to_table(from_H, p_H - from_H);
        const double facing = -hit->normal.dot(beam.d.normalized());
        const bool shadow = scene.intersect(beam, 0, 1 - 1e-4).has_value();
        const double albedo = hit->material == Material::platter ? c.platter_albedo : 1;
        if (facing > 0 && !shadow && std::abs(s) < 1.5) {
          expected = c.line_levels * 0.25 / 0.3 * std::exp(-s * s / (2 * 0.3 * 0.3)) * facing * albedo *
                     std::hypot(c.sheet.emitter_W.x(), c.sheet.emitter_W.y()) / beam.d.norm();
          if (hit->material == Material::object && hit->normal.z() > 0.99) ++on_tops;
        }
      }
      const bool agree = std::abs(rendered - expected) < 0.03 * c.line_levels;
      ++(expected > 5 ? lit : dark);
      if (!agree) ++wrong;
    }
  }
  EXPECT_GT(lit, 1200);
  EXPECT_GT(on_tops, 200) << "shoulders that a level head does not see";
  EXPECT_LT(wrong, lit / 25) << "of " << lit << " lit and " << dark << " dark ones; six edges run through some";
}

// ---- the machine behind its registers ----

struct AxesBench {
  explicit AxesBench(const DeviceConfig& config) : model(config) {}

  Exception command(int block, std::uint16_t code, std::int64_t target = 0, std::uint32_t speed = 0) {
    std::uint16_t words[10] = {};
    const protocol::SplitAngle split = protocol::split_turns(target);
    protocol::put_s32(words, split.angle_udeg);
    protocol::put_s32(words + 2, split.turns);
    protocol::put_u32(words + 4, speed);
    words[9] = code;
    return model.write_holding(protocol::groups::axis_command.address(block), 10, words);
  }
  std::vector<std::uint16_t> poll() {
    std::vector<std::uint16_t> words(protocol::status_words(3));
    EXPECT_EQ(model.read_input(0, static_cast<std::uint16_t>(words.size()), words.data()), Exception::none);
    return words;
  }
  void live(int ms) {
    for (int i = 0; i < ms; i += 20) {
      poll();
      model.advance_to(model.now_ns() + 20'000'000);
    }
  }
  std::int64_t position(int block) {
    const auto words = poll();
    return protocol::join_turns(protocol::get_s32(&words[protocol::reg::axis_status::angle.address(block)]),
                                protocol::get_s32(&words[protocol::reg::axis_status::turns.address(block)]));
  }
  void home(int block) {
    ASSERT_EQ(command(block, protocol::kHome), Exception::none);
    live(20'000);
    ASSERT_EQ(state(block), MotionState::standstill);
  }
  MotionState state(int block) {
    return static_cast<MotionState>(poll()[protocol::reg::axis_status::motion_state.address(block)]);
  }
  DeviceModel model;
};

TEST(MachineWithAxes, HomesMovesAndStandsWhereItsScalesSay) {
  const DeviceConfig config = machine_with_axes(9);
  AxesBench b(config);
  const DeviceState begun = b.model.state();
  EXPECT_NE(begun.elevation->position, 0) << "at power-on it stands somewhere";
  b.home(1);
  b.home(2);
  EXPECT_EQ(b.model.state().elevation->position, 0);
  EXPECT_EQ(b.model.state().lift->position, 0);
  ASSERT_EQ(b.command(1, protocol::kMove, 40'000'000, 30'000'000), Exception::none);
  ASSERT_EQ(b.command(2, protocol::kMove, -80'000, 40'000), Exception::none);
  b.live(200);
  EXPECT_EQ(b.state(1), MotionState::moving);
  EXPECT_EQ(b.state(2), MotionState::moving);
  EXPECT_EQ(b.state(0), MotionState::unhomed);
  b.live(4000);
  EXPECT_EQ(b.position(1), 40'000'000);
  EXPECT_EQ(b.position(2), -80'000);
  const DeviceState s = b.model.state();
  EXPECT_NEAR(s.elevation->position, config.optics.axes.elevation->scale * 40 * kDegrees, 1e-9);
  EXPECT_NEAR(s.lift->position, config.optics.axes.lift->scale * -80, 1e-9);
  EXPECT_EQ(b.command(1, protocol::kMove, 70'000'001, 1'000'000), Exception::refused);
  EXPECT_EQ(b.command(2, protocol::kMove, -150'001, 1'000), Exception::refused);
}

TEST(MachineWithAxes, ThePictureHasTheHeadsPostureOfItsInstant) {
  AxesBench b(machine_with_axes(4));
  b.home(1);
  b.model.camera().start(b.model.now_ns());
  std::vector<std::pair<std::int64_t, MotionRecord>> seen;
  b.model.set_render([&](const DeviceModel::RenderOrder& order) {
    seen.emplace_back(order.exposure.first_row_end_ns, order.exposure.motion);
    return true;
  });
  ASSERT_EQ(b.command(1, protocol::kMove, 60'000'000, 20'000'000), Exception::none);
  const std::int64_t begun = b.model.now_ns();
  while (b.model.now_ns() < begun + 1'500'000'000) {
    b.poll();
    if (const auto frame = b.model.advance_to_frame(b.model.now_ns() + 20'000'000))
      b.model.camera().give_back(frame->slot);
  }
  int moving = 0;
  const double scale = b.model.config().optics.axes.elevation->scale;
  for (const auto& [at_ns, motion] : seen) {
    const double t = static_cast<double>(at_ns - begun) * 1e-9;
    if (t < 0.4) continue;  // the ramp: a third of a second at 60 degrees/s2
    ++moving;
    EXPECT_NEAR(motion.posture(at_ns).elevation_rad, scale * kDegrees * (20 * t - 20.0 * 20 / 120), 1e-6);
  }
  EXPECT_GT(moving, 30);
}

TEST(MachineWithAxes, TheTrueCalibrationHoldsThemAndIsReadAgain) {
  const DeviceConfig config = machine_with_axes(6);
  const auto read = parse_calibration(format_calibration(DeviceModel(config).calibration()), "truth");
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_TRUE(read->elevation && read->lift);
  EXPECT_LT((read->elevation->direction - config.optics.axes.elevation->direction_S).norm(), 1e-9);
  EXPECT_NEAR(read->elevation->scale.value, config.optics.axes.elevation->scale, 1e-12);
  EXPECT_LT((read->lift->direction - config.optics.axes.lift->direction_S).norm(), 1e-9);
  EXPECT_NEAR(read->lift->scale.value, config.optics.axes.lift->scale, 1e-12);
  // The line is what counts of the origin.
  const Vector3d off = read->elevation->origin_mm - config.optics.axes.elevation->origin_S;
  EXPECT_LT(off.cross(config.optics.axes.elevation->direction_S).norm(), 1e-8);
  const auto none = DeviceModel(machine_with_axes(6, false, false)).calibration();
  EXPECT_FALSE(none.elevation || none.lift);
  EXPECT_TRUE(DeviceModel(machine_with_axes(6, false, true)).calibration().lift.has_value());
}

TEST(MachineWithAxes, ALiftAloneIsInTheFirstBlock) {
  AxesBench b(machine_with_axes(2, false, true));
  std::uint16_t kind = 0;
  ASSERT_EQ(b.model.read_input(protocol::reg::axis_capabilities::kind.address(1), 1, &kind), Exception::none);
  EXPECT_EQ(kind, protocol::kLift);
  EXPECT_EQ(b.model.read_input(protocol::reg::axis_capabilities::kind.address(2), 1, &kind),
            Exception::illegal_address);
}

TEST(MachineWithAxes, FaultsOfAnAxisAreToldWithIt) {
  AxesBench b(machine_with_axes(7));
  b.home(1);
  b.home(2);
  const auto fault = [&] {
    const auto words = b.poll();
    return std::pair(words[protocol::reg::status::fault_code.address()],
                     words[protocol::reg::status::fault_axis.address()]);
  };
  b.model.inject(*make_fault("lift-stall", std::vector<std::string>{}));
  ASSERT_EQ(b.command(2, protocol::kMove, 20'000, 40'000), Exception::none);
  b.live(40);
  EXPECT_EQ(fault(), std::pair(std::uint16_t{16}, std::uint16_t{2}));
  b.model.clear_fault("lift-stall");
  b.live(200);  // it settles
  std::uint16_t one = 1;
  ASSERT_EQ(b.model.write_holding(protocol::reg::control::clear_fault.address(), 1, &one), Exception::none);
  b.home(2);
  // Its encoder loses count, and it runs into the hard end.
  b.model.inject(*make_fault("lift-slip", std::vector<std::string>{"-20"}));
  ASSERT_EQ(b.command(2, protocol::kMove, 150'000, 40'000), Exception::none);
  b.live(6000);
  EXPECT_EQ(fault(), std::pair(std::uint16_t{19}, std::uint16_t{2}));
  ASSERT_EQ(b.model.write_holding(protocol::reg::control::clear_fault.address(), 1, &one), Exception::none);
  b.home(2);
  b.model.inject(*make_fault("lift-sink", std::vector<std::string>{"2"}));
  EXPECT_EQ(b.position(2), 0) << "the drive looks once a millisecond";
  b.live(20);
  EXPECT_EQ(b.position(2), -2'000);
}

}  // namespace
}  // namespace celadon::sim
