// Paint: where it is, that laser and room light are both so much weaker there, and that a colour camera sees its
// colours.
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
  EXPECT_EQ(to_string(*Paint::parse("sectors")), "sectors");
  for (const char* text :
       {"", "third", "third:", "bands:0", "bands:1.5", "third:0.1x", "stripes:0.1", "third:nan", "sectors:1"}) {
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

// What sectors throw back of red, green and blue light, as README.md has it.
constexpr double kRed[] = {0.9, 0.3, 0.25}, kGreen[] = {0.5, 0.85, 0.35}, kBlue[] = {0.45, 0.5, 0.95};

const double* sector_at(double psi_deg) {
  const double turned = psi_deg < 0 ? psi_deg + 360 : psi_deg;
  return turned < 120 ? kRed : turned < 240 ? kGreen : kBlue;
}

TEST(Paint, SectorsHaveThreeColours) {
  const Paint sectors{Paint::Where::sectors, 1};
  for (const double psi : {3., 60., 117., 123., 200., 237., 243., 300., -3.}) {
    for (int c = 0; c < 3; ++c) {
      EXPECT_DOUBLE_EQ(Paint::reflectance_at(at(psi, 5))[c], sector_at(psi)[c]) << psi;
    }
    EXPECT_DOUBLE_EQ(sectors.albedo_at(at(psi, 5)), sector_at(psi)[0]) << "the laser is red";
  }
  for (int c = 0; c < 3; ++c) {
    EXPECT_NEAR(Paint::reflectance_at(at(120, 5))[c], (kRed[c] + kGreen[c]) / 2, 1e-9) << "the middle of the edge";
    EXPECT_NEAR(Paint::reflectance_at(at(0, 5))[c], (kRed[c] + kBlue[c]) / 2, 1e-9);
    EXPECT_NEAR(Paint::reflectance_at(at(-1e-9, 5))[c], Paint::reflectance_at(at(1e-9, 5))[c], 1e-6) << "no step";
  }
  Scene scene = cylinder(sectors);
  EXPECT_FALSE(scene.turns_invisibly());
  EXPECT_TRUE(scene.coloured());
  scene.set_pose({4, -2, 0.3});
  const double r = scene.truth_r_mm(1, 50), x = r * std::cos(1) - 4, y = r * std::sin(1) + 2;
  const double psi_deg = (std::atan2(y, x) - 0.3) * 180 / std::numbers::pi;
  for (int c = 0; c < 3; ++c) EXPECT_DOUBLE_EQ(scene.truth_reflectance(1, 50)[c], sector_at(psi_deg)[c]);
}

// Of each pixel the ray that it looks along tells the colour; red, green and blue are decoded by the definition of
// YUYV.
TEST(Paint, AColourCameraSeesTheColoursUnderTheRoomsLight) {
  OpticsConfig c = quiet();
  c.format = PixelFormat::yuyv;
  c.object_ambient = 160;
  const VirtualCamera camera(c.camera, c.X_CW);
  const Scene scene = cylinder({Paint::Where::sectors, 1});
  for (const double table_deg : {0., 75., 200.}) {
    const double table = table_deg * std::numbers::pi / 180;
    std::vector<std::uint8_t> yuyv(2 * kWide * kHigh), grey(kWide * kHigh);
    Renderer(scene, c).render(still(table, 0), yuyv, 2 * kWide);
    OpticsConfig grey_camera = c;
    grey_camera.format = PixelFormat::grey8;
    Renderer(scene, grey_camera).render(still(table, 0), grey, kWide);
    int seen = 0;
    for (int y = 100; y < 400; y += 3) {
      for (int x = 0; x < kWide; x += 4) {
        const auto hit = scene.intersect({camera.centre_W(), camera.ray_W(x + 0.5, y)});
        if (!hit || hit->material != Material::object || hit->p.z() > 90 || hit->p.z() < 10) continue;
        if (hit->normal.dot((camera.centre_W() - hit->p).normalized()) < 0.3) continue;  // the silhouette is soft
        const double psi_deg = (std::atan2(hit->p.y(), hit->p.x()) - table) * 180 / std::numbers::pi;
        const double psi = psi_deg - 360 * std::floor(psi_deg / 360), from_edge = std::abs(std::remainder(psi, 120.));
        if (from_edge < 4) continue;
        const std::uint8_t* const at = &yuyv[static_cast<std::size_t>(2 * (y * kWide + x))];
        const double luma = 0.5 * (at[0] + at[2]), u = at[1] - 128., v = at[3] - 128.;
        const double rgb[] = {luma + 1.402 * v, luma - 0.344136 * u - 0.714136 * v, luma + 1.772 * u};
        constexpr double kBlack = 4;
        const double room[] = {1, 0.9, 0.8};
        const double* const paint = sector_at(psi);
        // Brightness by red, then the others by it.
        const double light = (rgb[0] - kBlack) / (paint[0] * room[0]);
        EXPECT_GT(light, 40);
        EXPECT_LT(light, 170);
        for (int k = 1; k < 3; ++k)
          EXPECT_NEAR(rgb[k] - kBlack, light * paint[k] * room[k], 4) << x << ", " << y << ", " << psi;
        const double of_grey = grey[static_cast<std::size_t>(y * kWide + x)] - kBlack;
        EXPECT_NEAR(of_grey, light * (0.299 * paint[0] + 0.587 * paint[1] + 0.114 * paint[2]), 4);
        ++seen;
      }
    }
    EXPECT_GT(seen, 1000);
  }
}

TEST(Paint, WhatIsPaintedAroundStillTurnsInvisibly) {
  EXPECT_TRUE(cylinder({Paint::Where::bands, 0.1}).turns_invisibly());
  EXPECT_FALSE(cylinder({Paint::Where::third, 0.1}).turns_invisibly());
}

}  // namespace
}  // namespace celadon::sim
