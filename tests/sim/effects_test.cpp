// Effects beyond the calibrated model, and the second laser: noiseless pictures against formulas written out again
// here.
#include "sim/effects.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "sim/device_model.h"
#include "sim/renderer.h"
#include "sim/turntable.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;
constexpr int kWide = 1280, kHigh = 1024;
constexpr double kTurned = 0.7;  // the table in every picture

OpticsConfig quiet_optics(double sigma_mm) {
  OpticsConfig c = default_optics(kWide, kHigh, 0.7, 0.01);
  c.sheet.sigma_mm = sigma_mm;
  c.blur_px = 1;
  c.reflection = 0;
  c.platter_albedo = 0;
  return c;
}

std::vector<float> line_of(const Scene& scene, const OpticsConfig& c, double first_power = 1, double second_power = 0) {
  Renderer renderer(scene, c);
  Exposure e;
  e.exposure_ns = 4'000'000;
  for (int i = 0; i < 10; ++i) e.motion.samples.push_back({kTurned, 0, first_power, second_power});
  std::vector<float> image;
  renderer.render_line(e, image);
  return image;
}

struct Row {
  double light = 0, x_px = 0;
};
Row row_of(const std::vector<float>& image, int y) {
  Row row;
  for (int x = 0; x < kWide; ++x) {
    const double v = static_cast<double>(image[static_cast<std::size_t>(y * kWide + x)]);
    row.light += v;
    row.x_px += v * x;
  }
  row.x_px /= row.light;
  return row;
}

/// Where the pixel's ray meets the plane normal . p = distance.
Vector3d on_plane(const VirtualCamera& camera, double x, double y, const Vector3d& normal, double distance) {
  const Vector3d d = camera.ray_W(x, y), c = camera.centre_W();
  return c + (distance - normal.dot(c)) / normal.dot(d) * d;
}

TEST(Effects, TheSpindlesErrorsMoveTheObject) {
  const Scene scene = *Scene::make("vase-squeezed");
  OpticsConfig c = quiet_optics(0.01);
  c.spindle = {0.2, 0.15, 0.002};
  const std::vector<float> image = line_of(scene, c), true_image = line_of(scene, quiet_optics(0.01));
  const VirtualCamera camera(c.camera, c.X_CW);
  const double a = kTurned, tx = 0.002 * std::cos(2 * a + 1.9), ty = 0.002 * std::sin(2 * a + 1.9);
  Eigen::Matrix3d about_x, about_y;
  about_x << 1, 0, 0, 0, std::cos(tx), -std::sin(tx), 0, std::sin(tx), std::cos(tx);
  about_y << std::cos(ty), 0, std::sin(ty), 0, 1, 0, -std::sin(ty), 0, std::cos(ty);
  const Vector3d shift(0.2 * std::cos(2 * a + 0.3), 0.2 * std::sin(3 * a + 1.1), 0.15 * std::cos(2 * a + 0.7));
  int rows = 0;
  double largest = 0;
  for (int y = 200; y < 850; y += 10) {
    const Row row = row_of(image, y);
    if (!(row.light > 1)) continue;
    const Vector3d p_W = on_plane(camera, row.x_px, y, c.sheet.normal_W, c.sheet.distance_mm);
    const Vector3d p = (about_y * about_x).transpose() * (p_W - shift);
    const double r = scene.truth_r_mm(std::atan2(p.y(), p.x()) - a, p.z());
    EXPECT_NEAR(std::hypot(p.x(), p.y()), r, 5e-4) << y;
    largest = std::max(largest, std::abs(row.x_px - row_of(true_image, y).x_px));
    ++rows;
  }
  EXPECT_GT(rows, 50);
  EXPECT_GT(largest, 0.5);
}

TEST(Effects, ABowedSheetIsAParabolaAcrossItsHeight) {
  const Scene scene = *Scene::make("cylinder-off");
  OpticsConfig c = quiet_optics(0.01);
  c.sheet.bow_mm = 0.4;
  const std::vector<float> image = line_of(scene, c);
  const VirtualCamera camera(c.camera, c.X_CW);
  int rows = 0;
  for (int y = 150; y < 900; y += 10) {
    const Row row = row_of(image, y);
    if (!(row.light > 1)) continue;
    const double turn = -kTurned;
    const Eigen::AngleAxisd back(turn, Vector3d::UnitZ());
    const auto hit = scene.intersect({back * camera.centre_W(), back * camera.ray_W(row.x_px, y)});
    if (!hit || hit->p.z() < 2 || hit->p.z() > 98) continue;
    const Vector3d p = back.inverse() * hit->p, e = c.sheet.emitter_W;
    const Vector3d aimed = e + (p - e) * ((e.x() - 30) / (e.x() - p.x()));  // 30 mm in front of the axis
    const double off = c.sheet.normal_W.dot(aimed) - c.sheet.distance_mm, height = (aimed.z() - e.z()) / 50;
    EXPECT_NEAR(off, 0.4 * height * height, 1e-3) << y;
    ++rows;
  }
  EXPECT_GT(rows, 50);
}

TEST(Effects, SubsurfaceLightComesBackFromFurtherInAndLosesNothing) {
  const Scene scene = *Scene::make("cylinder-off");
  OpticsConfig c = quiet_optics(0.1);
  const std::vector<float> plain = line_of(scene, c);
  c.subsurface = {0.4, 0.8};
  const std::vector<float> milky = line_of(scene, c);
  const VirtualCamera camera(c.camera, c.X_CW);
  for (int y = 300; y < 800; y += 50) {
    const Row before = row_of(plain, y), after = row_of(milky, y);
    EXPECT_NEAR(after.light / before.light, 1, 0.005);
    const Vector3d p = on_plane(camera, before.x_px, y, c.sheet.normal_W, c.sheet.distance_mm);
    const Vector3d inside = p + 0.8 * (p - c.sheet.emitter_W).normalized();
    EXPECT_NEAR(after.x_px - before.x_px, 0.4 * (camera.project(inside).x() - before.x_px), 0.03) << y;
  }
}

TEST(Effects, FieldsOfReflectanceStandStillOnTheObject) {
  const Scene scene = *Scene::make("cylinder-off");
  OpticsConfig c = quiet_optics(0.4);
  const std::vector<float> plain = line_of(scene, c);
  c.fields = {4, 7};
  const std::vector<float> printed = line_of(scene, c);
  const VirtualCamera camera(c.camera, c.X_CW);
  const Eigen::AngleAxisd back(-kTurned, Vector3d::UnitZ());
  int bright = 0, dark = 0;
  for (int y = 200; y < 850; ++y) {
    for (int x = 0; x < kWide; ++x) {
      const auto at = static_cast<std::size_t>(y * kWide + x);
      if (plain[at] < 20) continue;
      const auto hit = scene.intersect({back * camera.centre_W(), back * camera.ray_W(x, y)});
      ASSERT_TRUE(hit);
      const double turn = std::atan2(hit->p.y(), hit->p.x()) / (2 * std::numbers::pi);
      const double around = 24 * (turn - std::floor(turn)), up = hit->p.z() / 7;
      // More than 4 pixels from every edge: 0.6 mm of 7 mm and of 6.5 mm.
      if (std::abs(around - std::round(around)) < 0.15 || std::abs(up - std::round(up)) < 0.1) continue;
      const bool is_bright = (static_cast<int>(around) + static_cast<int>(up)) % 2 == 0;
      (is_bright ? bright : dark) += 1;
      EXPECT_NEAR(printed[at] / plain[at], is_bright ? 1 : 0.25, 0.02) << x << " " << y;
    }
  }
  EXPECT_GT(bright, 300);
  EXPECT_GT(dark, 300);
}

TEST(Effects, AnEccentricEncoderErrsOnceATurn) {
  TurntableConfig config;
  config.encoder_eccentricity_rad = 0.002;
  config.start_angle_rad = 0;
  Turntable table(config);
  table.home(0);
  std::int64_t now = 20'000'000'000;
  ASSERT_TRUE(table.index_found(now));
  EXPECT_NEAR(std::remainder(table.table_angle_rad(now), 2 * std::numbers::pi), 0, 1e-9);
  for (const double target : {1.0, 2.5, 4.0, 6.0}) {
    table.move(target, 1, 5, now);
    now += 20'000'000'000;
    const double said = table.encoder_rad(now);
    EXPECT_NEAR(said, target, 5e-5);
    const double error = std::remainder(table.table_angle_rad(now) - target, 2 * std::numbers::pi);
    EXPECT_NEAR(error, 0.002 * (std::sin(target + 0.8) - std::sin(0.8)), 1e-6);
  }
}

DeviceConfig small_device() {
  CameraConfig camera;
  camera.width_px = 160;
  camera.height_px = 128;
  DeviceConfig config = default_device(camera);
  config.scene = "cylinder-off";
  config.date = "2026-01-02T03:04:05Z";
  return config;
}

TEST(Effects, TheCameraTurnsAsItWarmsUp) {
  DeviceConfig config = small_device();
  config.thermal = {3e-3, 10};
  DeviceModel model(config);
  std::vector<std::pair<double, double>> turns;  // at a time after the start
  model.set_render([&](const DeviceModel::RenderOrder& order) {
    const auto middle = order.exposure.first_row_end_ns - order.exposure.exposure_ns / 2;
    turns.emplace_back(static_cast<double>(middle - config.start_ns) * 1e-9, order.camera_turn_rad);
    return true;
  });
  model.camera().start(model.now_ns());
  for (int i = 0; i < 200; ++i) {
    if (const auto frame = model.advance_to_frame(model.now_ns() + 1'000'000'000))
      model.camera().give_back(frame->slot);
    model.advance_to(model.now_ns() + 100'000'000);
  }
  ASSERT_GT(turns.size(), 100u);
  for (const auto& [t, turn] : turns) EXPECT_NEAR(turn, 3e-3 * (1 - std::exp(-t / 10)), 1e-6);
  EXPECT_GT(turns.back().second, 2e-3);
}

// The second sheet is the mirror image of the first in the camera's plane; the calibration tells both.
TEST(SecondLaser, ItsLineLiesInItsPlane) {
  const Scene scene = *Scene::make("vase-squeezed");
  OpticsConfig c = quiet_optics(0.01);
  c.second_sheet = mirrored_sheet(c.sheet);
  DeviceConfig device = small_device();
  device.optics = c;
  device.camera.width_px = kWide;
  device.camera.height_px = kHigh;
  const Calibration calibration = DeviceModel(device).calibration();
  ASSERT_EQ(calibration.lasers.size(), 2u);
  EXPECT_EQ(calibration.lasers[1].laser, 1);
  const std::vector<float> second = line_of(scene, c, 0, 1), first = line_of(scene, c, 1, 0),
                           both = line_of(scene, c, 1, 1);
  const VirtualCamera camera(c.camera, c.X_CW);
  for (const auto* image : {&first, &second}) {
    const LaserPlane& plane = calibration.lasers[image == &first ? 0 : 1];
    const Vector3d normal_W = c.X_CW.linear().transpose() * plane.normal_C;
    const double distance = plane.distance_mm - plane.normal_C.dot(c.X_CW.translation());
    int rows = 0;
    for (int y = 200; y < 850; y += 10) {
      const Row row = row_of(*image, y);
      if (!(row.light > 1)) continue;
      const Vector3d p = on_plane(camera, row.x_px, y, normal_W, distance);
      EXPECT_NEAR(p.head<2>().norm(), scene.truth_r_mm(std::atan2(p.y(), p.x()) - kTurned, p.z()), 5e-4) << y;
      EXPECT_GT(p.x() * (image == &first ? 1 : 0.5) + p.y() * (image == &first ? 0 : 0.866), 0);  // facing its laser
      ++rows;
    }
    EXPECT_GT(rows, 50);
  }
  for (std::size_t i = 0; i < both.size(); ++i) ASSERT_NEAR(both[i], first[i] + second[i], 1e-3F);
}

TEST(SecondLaser, HasItsLeaseAndItsLight) {
  DeviceConfig config = small_device();
  config.optics.second_sheet = mirrored_sheet(config.optics.sheet);
  DeviceModel model(config);
  const auto lease = [&](std::uint16_t first, std::uint16_t second) {
    const std::uint16_t words[] = {first, second};
    return model.write_holding(protocol::reg::control::laser_lease.address(), 2, words);
  };
  model.advance_to(model.now_ns() + 10'000'000);
  ASSERT_EQ(lease(0, 500), protocol::Exception::none);
  model.advance_to(model.now_ns() + 10'000'000);
  EXPECT_EQ(model.state().lasers_on, 2);
  ASSERT_EQ(lease(500, 500), protocol::Exception::none);
  model.advance_to(model.now_ns() + 10'000'000);
  EXPECT_EQ(model.state().lasers_on, 3);
  ASSERT_EQ(lease(500, 0), protocol::Exception::none);
  model.advance_to(model.now_ns() + 10'000'000);
  EXPECT_EQ(model.state().lasers_on, 1);
  model.advance_to(model.now_ns() + 2'000'000'000);  // nobody lives: the lease runs out
  EXPECT_EQ(model.state().lasers_on, 0);
  DeviceModel one(small_device());
  const std::uint16_t words[] = {0, 500};
  EXPECT_NE(one.write_holding(protocol::reg::control::laser_lease.address(), 2, words), protocol::Exception::none);
}

}  // namespace
}  // namespace celadon::sim
