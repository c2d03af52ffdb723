#include "sim/renderer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sim/shapes.h"
#include "tests/sim/closed_form_line.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;
constexpr int kWidth = 1280, kHeight = 1024;

/// Nothing but the line.
OpticsConfig clean(double sigma_mm, double blur_px, double offset_mm = 0.7, double tilt_rad = 0.01) {
  OpticsConfig c = default_optics(kWidth, kHeight, offset_mm, tilt_rad);
  c.sheet.sigma_mm = sigma_mm;
  c.blur_px = blur_px;
  c.reflection = 0;
  c.speckle_contrast = 0;
  c.ambient_low = c.ambient_high = c.object_ambient = 0;
  c.noise = {10, 1e9F, 0.001F};
  return c;
}

Exposure still(double angle_rad) {
  Exposure e;
  e.seed = 1;
  e.exposure_ns = 4'000'000;
  e.first_row_end_ns = 50'000'000;
  for (int i = 0; i < 100; ++i) e.motion.samples.push_back({angle_rad, 0, 1});
  return e;
}

Exposure turning(double angle_rad, double speed, std::int64_t line_time_ns) {
  Exposure e = still(angle_rad);
  e.line_time_ns = line_time_ns;
  for (int i = 0; i < 100; ++i)
    e.motion.samples[static_cast<std::size_t>(i)] = {angle_rad + speed * 1e-3 * i, speed, 1};
  return e;
}

double centroid(const std::vector<float>& image, int row) {
  double sum = 0, moment = 0;
  for (int x = 0; x < kWidth; ++x) {
    const double v = static_cast<double>(image[static_cast<std::size_t>(row * kWidth + x)]);
    sum += v;
    moment += v * x;
  }
  return sum > 1 ? moment / sum : NAN;
}

struct Case {
  const char* scene;
  double angle, speed;
  std::int64_t line_time_ns;
};
class ThinSheet : public testing::TestWithParam<Case> {};

// A noiseless thin sheet's line lies where the closed form says; with a rolling shutter each row at its own instant.
TEST_P(ThinSheet, LineLiesWhereTheClosedFormSays) {
  const Case& p = GetParam();
  const Scene scene = *Scene::make(p.scene);
  const OpticsConfig c = clean(0.01, 1.0);
  Renderer renderer(scene, c);
  const Exposure e = turning(p.angle, p.speed, p.line_time_ns);
  std::vector<float> image;
  renderer.render_line(e, image);
  int rows = 0;
  double worst = 0, z = 60;
  for (int y = 40; y < 1000; y += 1) {
    const double measured = centroid(image, y);
    const double middle_ns =
        static_cast<double>(e.first_row_end_ns + y * e.line_time_ns) - 0.5 * static_cast<double>(e.exposure_ns);
    const double angle = p.angle + p.speed * middle_ns * 1e-9;
    const Crossing truth = closed_form(scene, c, angle, y, z);
    if (std::isnan(truth.x_px) || std::isnan(measured)) continue;
    if (truth.z_mm < 1 || truth.z_mm > scene.z_max_mm() - 1) continue;
    z = truth.z_mm;
    ++rows;
    worst = std::max(worst, std::abs(measured - truth.x_px));
  }
  EXPECT_GT(rows, 650);
  // Motion over the exposure bends a line that does not move evenly by a second-order term.
  EXPECT_LT(worst, p.speed == 0 ? 1e-3 : 2e-3);
}
INSTANTIATE_TEST_SUITE_P(Scenes, ThinSheet,
                         testing::Values(Case{"vase", 0, 0, 0}, Case{"vase-squeezed", 0.6, 0, 0},
                                         Case{"humidifier", 1.3, 0, 0}, Case{"humidifier", 4.1, 0, 0},
                                         Case{"cylinder", 0, 0, 0}, Case{"cylinder-off", 2.2, 0, 0},
                                         Case{"humidifier", 0.3, 1.5, 13'671}, Case{"cylinder-off", 0.3, -1.5, 13'671},
                                         Case{"vase-squeezed", 1, 0.6, 0}));

// A sheet of real thickness: each pixel looks at its own place of it. The other way round here: from the pixel into the
// scene, and there the irradiance of a Gaussian sheet at that incidence.
TEST(Optics, ThickSheetIsIntegratedPixelByPixel) {
  const Scene scene("moved", make_humidifier(), 1, {3, 2, 0.4});
  OpticsConfig c = clean(0.8, 0.05);
  Renderer renderer(scene, c);
  std::vector<float> image;
  renderer.render_line(still(0), image);
  const VirtualCamera& camera = renderer.camera();
  const double reach = std::hypot(c.sheet.emitter_W.x(), c.sheet.emitter_W.y());
  int compared = 0;
  for (int y = 200; y < 800; y += 25) {
    for (int x = 0; x < kWidth; ++x) {
      const double rendered = static_cast<double>(image[static_cast<std::size_t>(y * kWidth + x)]);
      if (rendered < 1) continue;
      const auto hit = scene.intersect({camera.centre_W(), camera.ray_W(x, y)});
      ASSERT_TRUE(hit);
      const double s = c.sheet.normal_W.dot(hit->p) - c.sheet.distance_mm;
      const Vector3d from = c.sheet.emitter_W + s * c.sheet.normal_W, beam = hit->p - from;
      const double expected = c.line_levels * 0.25 / 0.8 * std::exp(-s * s / (2 * 0.8 * 0.8)) *
                              -hit->normal.dot(beam.normalized()) * reach / beam.norm();
      EXPECT_NEAR(rendered, expected, 0.004 * c.line_levels * 0.25 / 0.8) << x << " " << y;
      ++compared;
    }
  }
  EXPECT_GT(compared, 400);
}

// Whatever is lit is seen by the camera and by the laser.
TEST(Optics, NothingHiddenIsLit) {
  const Scene scene("moved", make_humidifier(), 1, {6, -5, 0.4});
  OpticsConfig c = clean(0.2, 0.3, 14);
  c.platter_albedo = 1;
  Renderer renderer(scene, c);
  std::vector<float> image;
  renderer.render_line(still(0), image);
  int lit = 0, on_platter = 0;
  for (int y = 0; y < kHeight; y += 3) {
    for (int x = 0; x < kWidth; ++x) {
      if (image[static_cast<std::size_t>(y * kWidth + x)] < 5) continue;
      ++lit;
      const auto hit = scene.intersect({renderer.camera().centre_W(), renderer.camera().ray_W(x, y)});
      ASSERT_TRUE(hit);
      on_platter += hit->material == Material::platter ? 1 : 0;
      const double s = c.sheet.normal_W.dot(hit->p) - c.sheet.distance_mm;
      EXPECT_LT(std::abs(s), 5 * 0.2 + 0.3);
      const Vector3d from = c.sheet.emitter_W + s * c.sheet.normal_W;
      const auto first = scene.intersect({from, hit->p - from});
      ASSERT_TRUE(first);
      EXPECT_NEAR(first->t, 1, 0.01) << "in the laser's shadow at " << x << " " << y;
    }
  }
  EXPECT_GT(lit, 500);
  EXPECT_GT(on_platter, 10);
}

TEST(Optics, TheLineIsHiddenFromBehind) {
  OpticsConfig c = clean(0.2, 0.5);
  c.platter_albedo = 0;
  const Vector3d centre(-290, 20, 100), view = (Vector3d(0, 0, 58) - centre).normalized();
  const Vector3d right = view.cross(Vector3d::UnitZ()).normalized();
  c.X_CW.linear().row(0) = right;
  c.X_CW.linear().row(1) = view.cross(right);
  c.X_CW.linear().row(2) = view;
  c.X_CW.translation() = -c.X_CW.linear() * centre;
  Renderer renderer(*Scene::make("vase"), c);
  std::vector<float> image;
  renderer.render_line(still(0), image);
  EXPECT_EQ(*std::max_element(image.begin(), image.end()), 0.F);
}

TEST(Optics, SpeckleHasItsContrastAndReach) {
  OpticsConfig c = clean(0.25, 0.6);
  c.speckle_contrast = 0.25;
  c.line_levels = 100;
  c.noise.pedestal = 0;
  Renderer renderer(*Scene::make("vase"), c);
  std::vector<float> mean;
  double n = 0, sum = 0, square = 0, neighbour = 0, pairs = 0, cube = 0;
  for (int frame = 0; frame < 12; ++frame) {
    const Exposure e = still(0.01 * frame);
    std::vector<std::uint8_t> bytes(kWidth * kHeight);
    renderer.render(e, bytes, kWidth);
    renderer.render_line(e, mean);
    const auto ratio = [&](std::size_t at) {
      return static_cast<double>(bytes[at]) / static_cast<double>(mean[at]) - 1;
    };
    for (std::size_t at = 0; at + 1 < mean.size(); ++at) {
      if (mean[at] < 60 || mean[at + 1] < 60) continue;
      const double v = ratio(at);
      n += 1;
      sum += v;
      square += v * v;
      cube += v * v * v;
      neighbour += v * ratio(at + 1);
      pairs += 1;
    }
  }
  ASSERT_GT(n, 20'000);
  EXPECT_NEAR(sum / n, 0, 0.01);
  const double contrast = std::sqrt(square / n);
  EXPECT_NEAR(contrast, 0.25, 0.01);
  EXPECT_NEAR(neighbour / pairs / (square / n), 2 * 0.2 * 0.6 / 0.44, 0.04);
  EXPECT_NEAR(cube / n / std::pow(contrast, 3), 2 * 0.25, 0.12);  // a gamma's skewness is twice its contrast
}

// Motion smear: the mean of pictures over the exposure.
TEST(Optics, SmearIsTheMeanOverTheExposure) {
  const OpticsConfig c = clean(0.2, 0.6);
  Renderer renderer(*Scene::make("humidifier"), c);
  Exposure e = turning(0.7, 3, 0);
  e.exposure_ns = 10'000'000;
  std::vector<float> smeared, one;
  renderer.render_line(e, smeared);
  std::vector<double> mean(smeared.size(), 0);
  constexpr int kParts = 20;
  for (int k = 0; k < kParts; ++k) {
    Exposure part =
        still(e.motion.angle_rad(e.first_row_end_ns - e.exposure_ns + (2 * k + 1) * e.exposure_ns / (2 * kParts)));
    part.exposure_ns = e.exposure_ns;
    renderer.render_line(part, one);
    for (std::size_t i = 0; i < one.size(); ++i) mean[i] += static_cast<double>(one[i]) / kParts;
  }
  double worst = 0, most = 0;
  for (std::size_t i = 220 * kWidth; i < 880 * kWidth; ++i) {  // away from the ends of the line
    worst = std::max(worst, std::abs(mean[i] - static_cast<double>(smeared[i])));
    most = std::max(most, mean[i]);
  }
  EXPECT_LT(worst, 0.02 * most);
}

TEST(Optics, PicturesAreAFunctionOfSeedAndFrame) {
  Renderer a(*Scene::make("humidifier"), default_optics(320, 256, 0.3, 0)),
      b(*Scene::make("humidifier"), default_optics(320, 256, 0.3, 0));
  std::vector<std::uint8_t> first(320 * 256), second(first.size());
  Exposure e = turning(1, 1, 40'000);
  a.render(e, first, 320);
  b.render(still(2), second, 320);  // what was rendered before does not matter
  b.render(e, second, 320);
  EXPECT_EQ(first, second);
  e.frame = 1;
  b.render(e, second, 320);
  EXPECT_NE(first, second);
  e.frame = 0;
  e.seed = 2;
  b.render(e, second, 320);
  EXPECT_NE(first, second);
}

TEST(Optics, LaserAndRoomLightFollowExposureAndPower) {
  OpticsConfig c = default_optics(320, 256, 0.3, 0);
  c.noise = {10, 1e9F, 0.001F};
  c.speckle_contrast = 0;
  c.line_levels = 60;
  Renderer renderer(*Scene::make("cylinder"), c);
  const auto mean_of = [&](const Exposure& e) {
    std::vector<std::uint8_t> bytes(320 * 256);
    renderer.render(e, bytes, 320);
    double sum = 0, peak = 0;
    for (const std::uint8_t v : bytes) {
      sum += v - 10;
      peak = std::max<double>(peak, v);
    }
    return std::pair(sum, peak);
  };
  Exposure dark = still(0), bright = still(0), half = still(0);
  for (auto& s : dark.motion.samples) s.laser_power = 0;
  for (auto& s : half.motion.samples) s.laser_power = 0.5;
  Exposure doubled = dark;
  doubled.exposure_ns *= 2;
  EXPECT_NEAR(mean_of(doubled).first / mean_of(dark).first, 2, 0.05);
  EXPECT_NEAR((mean_of(bright).first - mean_of(dark).first) / (mean_of(half).first - mean_of(dark).first), 2, 0.05);
  bright.exposure_ns *= 20;
  EXPECT_EQ(mean_of(bright).second, 255);
  EXPECT_LT(mean_of(dark).second, 60);
}

// YUYV, full-range BT.601: red = Y + 1.402 (V - 128) shows the line that luma shows weakly.
TEST(Optics, YuyvCarriesARedLine) {
  OpticsConfig c = clean(0.25, 0.6, 0.3, 0);
  c.format = PixelFormat::yuyv;
  c.noise.pedestal = 0;
  Renderer renderer(*Scene::make("cylinder"), c);
  std::vector<float> line;
  renderer.render_line(still(0), line);
  std::vector<std::uint8_t> bytes(2 * kWidth * kHeight);
  renderer.render(still(0), bytes, 2 * kWidth);
  const std::size_t row = 500 * kWidth;
  for (std::size_t x = 0; x + 1 < kWidth; x += 2) {
    const double red = 0.5 * static_cast<double>(line[row + x] + line[row + x + 1]);
    const std::uint8_t* p = &bytes[2 * (row + x)];
    const double luma = 0.5 * (p[0] + p[2]), u = p[1], v = p[3];
    EXPECT_NEAR(luma + 1.402 * (v - 128), red, 2.5);
    EXPECT_NEAR(luma, (0.299 + 0.587 * 0.15 + 0.114 * 0.04) * red, 1.2);
    EXPECT_NEAR(luma + 1.772 * (u - 128), 0.04 * red, 2.5);
  }
}

TEST(Optics, MotionRecordInterpolates) {
  MotionRecord m;
  m.first_ns = 1'000'000;
  // A parabola is met exactly by Hermite's cubic.
  for (int i = 0; i < 5; ++i) m.samples.push_back({0.5 * 7 * i * 1e-3 * i * 1e-3, 7 * i * 1e-3, i < 2 ? 0.0 : 1.0});
  EXPECT_NEAR(m.angle_rad(1'000'000 + 2'300'000), 0.5 * 7 * 2.3e-3 * 2.3e-3, 1e-15);
  EXPECT_NEAR(m.angle_rad(0), 0, 1e-15);
  EXPECT_NEAR(m.mean_power(1'000'000, 3'000'000), 0.25, 1e-12);
  EXPECT_NEAR(m.mean_power(3'000'000, 5'000'000), 1, 1e-12);
  EXPECT_NEAR(m.mean_power(2'500'000, 3'500'000), 0.5 * (0.5 + 1) / 2 + 0.5, 1e-12);
}

}  // namespace
}  // namespace celadon::sim
