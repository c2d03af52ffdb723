// Dark paint: where it is, and that laser and room light are both so much weaker there.
#include "sim/paint.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sim/renderer.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;
constexpr int kWide = 640, kHigh = 512;

Vector3d at(double psi_deg, double z_mm) {
  const double psi = psi_deg * std::numbers::pi / 180;
  return {30 * std::cos(psi), 30 * std::sin(psi), z_mm};
}

TEST(Paint, IsReadAndRefusedByItsText) {
  EXPECT_EQ(to_string(*Paint::parse("none")), "none");
  EXPECT_EQ(to_string(*Paint::parse("third:0.03")), "third:0.03");
  EXPECT_EQ(to_string(*Paint::parse("bands:0.5")), "bands:0.5");
  for (const char* text : {"", "third", "third:", "bands:0", "bands:1.5", "third:0.1x", "stripes:0.1", "third:nan"}) {
    EXPECT_FALSE(Paint::parse(text)) << text;
  }
}

TEST(Paint, LiesOnAThirdOfTheTurnOrOnEveryOtherBand) {
  const Paint none, third{Paint::Where::third, 0.1}, bands{Paint::Where::bands, 0.1};
  EXPECT_EQ(none.albedo_at(at(60, 18)), 1);
  for (const double psi : {3., 60., 117.}) EXPECT_DOUBLE_EQ(third.albedo_at(at(psi, 5)), 0.1) << psi;
  for (const double psi : {123., 200., 300., 357., -3.}) EXPECT_EQ(third.albedo_at(at(psi, 5)), 1) << psi;
  for (const double z : {13., 18., 23., 37., 47.}) EXPECT_DOUBLE_EQ(bands.albedo_at(at(50, z)), 0.1) << z;
  for (const double z : {1., 11., 25., 35., 49.}) EXPECT_EQ(bands.albedo_at(at(50, z)), 1) << z;
  EXPECT_NEAR(bands.albedo_at(at(0, 12)), 0.55, 1e-12) << "the middle of the edge";
  EXPECT_NEAR(third.albedo_at(at(120, 0)), 0.55, 1e-12);
}

OpticsConfig quiet() {
  OpticsConfig c = default_optics(kWide, kHigh, 0.3, 0.002);
  c.noise = {4, 1e9F, 0};
  c.speckle_contrast = 0;
  c.reflection = 0;
  return c;
}

Exposure still(double angle_rad, double power) {
  Exposure e;
  e.exposure_ns = 4'000'000;
  for (int i = 0; i < 10; ++i) e.motion.samples.push_back({angle_rad, 0, power, 0});
  return e;
}

Scene cylinder(const Paint& paint) {
  Scene scene = *Scene::make("cylinder");
  scene.set_paint(paint);
  return scene;
}

TEST(Paint, WeakensTheLaserByItsAlbedo) {
  // The laser shines on the table's psi = -angle: at 300 degrees on the paint's middle, at 60 on the bare surface.
  const Paint third{Paint::Where::third, 0.2};
  for (const bool dark : {true, false}) {
    const Exposure e = still((dark ? 300 : 60) * std::numbers::pi / 180, 1);
    std::vector<float> painted, plain;
    Renderer(cylinder(third), quiet()).render_line(e, painted);
    Renderer(cylinder({}), quiet()).render_line(e, plain);
    int lit = 0;
    for (int y = 120; y < 400; ++y) {  // off the platter
      for (int x = 0; x < kWide; ++x) {
        const auto i = static_cast<std::size_t>(y * kWide + x);
        if (plain[i] < 1) continue;
        ++lit;
        ASSERT_NEAR(painted[i] / plain[i], dark ? 0.2 : 1, 1e-3) << x << ", " << y;
      }
    }
    EXPECT_GT(lit, 200);
  }
}

TEST(Paint, WeakensTheRoomsLightByItsAlbedo) {
  OpticsConfig c = quiet();
  c.object_ambient = 200;  // for grey levels that tell
  const Exposure e = still(0.4, 0);
  std::vector<std::uint8_t> painted(kWide * kHigh), plain(kWide * kHigh);
  Renderer(cylinder({Paint::Where::bands, 0.25}), c).render(e, painted, kWide);
  Renderer(cylinder({}), c).render(e, plain, kWide);
  const VirtualCamera camera(c.camera, c.X_CW);
  const Scene bare = cylinder({});
  int dark = 0, bright = 0;
  for (int y = 0; y < kHigh; y += 2) {
    for (int x = kWide / 2 - 30; x < kWide / 2 + 30; x += 2) {
      const auto hit = bare.intersect({camera.centre_W(), camera.ray_W(x, y)});
      if (!hit || hit->material != Material::object || hit->p.z() > 90) continue;
      const double along = std::fmod(hit->p.z(), 24), off = std::abs(std::fmod(hit->p.z(), 12) - 6);
      if (off > 1) continue;  // room light is drawn on every eighth pixel: the middle of a band, 48 rows high
      const auto i = static_cast<std::size_t>(y * kWide + x);
      const double share = (painted[i] - 4.) / (plain[i] - 4.);
      if (along > 12) {
        EXPECT_NEAR(share, 0.25, 0.12) << x << ", " << y;
        ++dark;
      } else {
        EXPECT_NEAR(share, 1, 0.12) << x << ", " << y;
        ++bright;
      }
    }
  }
  EXPECT_GT(dark, 20);
  EXPECT_GT(bright, 20);
}

TEST(Paint, WhatIsPaintedAroundStillTurnsInvisibly) {
  EXPECT_TRUE(cylinder({Paint::Where::bands, 0.1}).turns_invisibly());
  EXPECT_FALSE(cylinder({Paint::Where::third, 0.1}).turns_invisibly());
}

}  // namespace
}  // namespace celadon::sim
