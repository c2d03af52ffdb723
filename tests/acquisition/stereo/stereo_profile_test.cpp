// Pictures of the virtual scanner, whose textured objects are closed forms, to samples: bias, scatter, and what gives
// none.

#include "acquisition/stereo/stereo_profile.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "sim/device_model.h"
#include "sim/renderer.h"

namespace celadon {
namespace {

using sim::DeviceConfig;

constexpr int kWide = 640, kHigh = 512;
constexpr std::int64_t kExposure_ns = 4'000'000;

class Table {
 public:
  explicit Table(const std::string& scene, std::optional<std::uint64_t> texture, double ambient)
      : device_(config(scene, texture, ambient)),
        model_(device_),
        calibration_(model_.calibration()),
        renderer_(model_.scene(), device_.optics) {
    mode_.width_px = kWide;
    mode_.height_px = kHigh;
    mode_.stride_bytes = kWide;
  }

  std::vector<std::uint8_t> picture(double angle_rad) {
    sim::Exposure e;
    e.seed = 11;
    e.frame = ++frame_;
    e.exposure_ns = kExposure_ns;
    e.first_row_end_ns = 50'000'000;
    for (int i = 0; i < 100; ++i) e.motion.samples.push_back({angle_rad, 0, 0});
    std::vector<std::uint8_t> bytes(mode_.stride_bytes * kHigh);
    renderer_.render(e, bytes, mode_.stride_bytes);
    return bytes;
  }
  StereoPair matched(double first_rad, double second_rad) {
    const auto first = picture(first_rad), second = picture(second_rad);
    return matched({first, first_rad, kAngle_rad}, {second, second_rad, kAngle_rad}, noise_at(first_rad));
  }
  PictureNoise noise_at(double angle_rad) {
    std::vector<std::vector<std::uint8_t>> standing;
    for (int i = 0; i < 4; ++i) standing.push_back(picture(angle_rad));
    return noise_of(mode_, standing);
  }
  StereoPair matched(const TablePicture& first, const TablePicture& second, const PictureNoise& noise) const {
    auto pair = StereoPair::begin(calibration_, {}, mode_, noise, first, second);
    EXPECT_TRUE(pair) << pair.error();
    for (int band = 0; band < pair->bands(); ++band) pair->match(band);
    return std::move(*pair);
  }
  double truth_r_mm(double theta_rad, double z_mm) const { return model_.scene().truth_r_mm(theta_rad, z_mm); }
  const Calibration& calibration() const { return calibration_; }
  const CameraMode& mode() const { return mode_; }

 private:
  static constexpr double kAngle_rad = 1e-7;  // these are exact
  static DeviceConfig config(const std::string& scene, std::optional<std::uint64_t> texture, double ambient) {
    sim::CameraConfig camera;
    camera.width_px = kWide;
    camera.height_px = kHigh;
    DeviceConfig device = sim::default_device(camera);
    device.scene = scene;
    device.texture = texture;
    device.optics.object_ambient *= ambient;
    return device;
  }

  DeviceConfig device_;
  sim::DeviceModel model_;
  Calibration calibration_;
  sim::Renderer renderer_;
  CameraMode mode_;
  std::uint64_t frame_ = 0;
};

struct Spread {
  double bias_mm = 0, chi2 = 0, sigma_mm = 0;
  int samples = 0;
};

/// Radius less the closed form's at the sample's angle and height.
Spread against_truth(Table& table, int pairs) {
  Spread out;
  for (int k = 0; k < pairs; ++k) {
    const double first = 0.37 * k;
    Profile profile;
    table.matched(first, first + kPairTurn_rad).fill(profile);
    EXPECT_EQ(profile.order, ProfileOrder::scattered);
    EXPECT_EQ(profile.covariance.size(), profile.size());
    for (std::size_t i = 0; i < profile.size(); ++i) {
      const double theta = profile.theta_rad[i], z = profile.z_mm[i];
      const auto truth = [&](double t, double h) { return table.truth_r_mm(t, h); };
      constexpr double kStep = 1e-4;
      const double off = profile.r_mm[i] - truth(theta, z);
      if (std::isnan(off)) continue;  // a rim
      // r - R(theta, z): what the covariance says of it.
      const double by_theta = -(truth(theta + kStep, z) - truth(theta - kStep, z)) / (2 * kStep),
                   by_z = -(truth(theta, z + kStep) - truth(theta, z - kStep)) / (2 * kStep);
      if (std::isnan(by_z)) continue;
      const SampleCovariance& c = profile.covariance[i];
      const double variance = c.rr + by_theta * by_theta * c.tt + by_z * by_z * c.zz +
                              2 * (by_theta * c.rt + by_z * c.rz + by_theta * by_z * c.tz);
      out.bias_mm += off;
      out.chi2 += off * off / variance;
      out.sigma_mm += std::sqrt(variance);
      ++out.samples;
    }
  }
  out.bias_mm /= out.samples;
  out.chi2 /= out.samples;
  out.sigma_mm /= out.samples;
  return out;
}

TEST(StereoProfile, SamplesScatterAboutTheClosedFormAsTheirCovarianceSays) {
  for (const std::string scene : {"cylinder", "vase", "humidifier"}) {
    Table table(scene, 3, 6);
    const Spread spread = against_truth(table, 8);
    std::printf("%s: %d samples, bias %.4f mm, stated sigma %.4f mm, chi2 %.3f\n", scene.c_str(), spread.samples,
                spread.bias_mm, spread.sigma_mm, spread.chi2);
    EXPECT_GT(spread.samples, 500) << scene;
    EXPECT_LT(std::abs(spread.bias_mm), 0.015) << scene;
    EXPECT_NEAR(spread.chi2, 1, 0.3) << scene;
  }
}

// Both angles wrong by the same turn the sample, and change nothing else of it.
TEST(StereoProfile, CovariancesKnowTheAnglesOfBothPictures) {
  Table table("vase", 3, 6);
  const double at = 0.2;
  const auto first = table.picture(at), second = table.picture(at + kPairTurn_rad);
  const PictureNoise noise = table.noise_at(at);
  constexpr double kSigma_rad = 1;  // beside it matching is exact
  const auto profile = [&](double sigma_first, double sigma_second) {
    Profile out;
    table.matched({first, at, sigma_first}, {second, at + kPairTurn_rad, sigma_second}, noise).fill(out);
    return out;
  };
  const Profile by_first = profile(kSigma_rad, 0), by_second = profile(0, kSigma_rad), by_none = profile(0, 0);
  ASSERT_GT(by_first.size(), 50u);
  ASSERT_EQ(by_first.size(), by_second.size());
  for (std::size_t i = 0; i < by_first.size(); ++i) {
    const SampleCovariance &a = by_first.covariance[i], &b = by_second.covariance[i], &none = by_none.covariance[i];
    EXPECT_GT(a.rr, 100 * none.rr);
    EXPECT_NEAR(b.rr / a.rr, 1, 0.02) << "one moves the sample outwards as far as the other moves it inwards";
    EXPECT_NEAR(b.rz / a.rz, 1, 0.05);
    const double turned_by_first = a.rt / std::sqrt(a.rr) / kSigma_rad,
                 turned_by_second = -b.rt / std::sqrt(b.rr) / kSigma_rad;
    EXPECT_NEAR(std::abs(turned_by_first + turned_by_second), 1, 0.02);
  }
}

// A wall behind the table, or dirt on the lens: both pictures show it at the same place, whatever the table did.
TEST(StereoProfile, WhatStandsStillIsNoSample) {
  Table table("cylinder", 3, 6);
  const auto picture = table.picture(0.2);
  Profile profile;
  const MatchCounts counts =
      table.matched({picture, 0.2, 0}, {picture, 0.2 + kPairTurn_rad, 0}, {1, 0.01}).fill(profile);
  EXPECT_GT(counts.standing, 20);
  EXPECT_EQ(profile.size(), 0u);
}

TEST(StereoProfile, ObjectsWithoutTextureGiveNoSamples) {
  Table table("vase", std::nullopt, 6);
  Profile profile;
  const MatchCounts counts = table.matched(0.2, 0.2 + kPairTurn_rad).fill(profile);
  EXPECT_EQ(profile.size(), 0u);
  EXPECT_EQ(counts.samples(), 0);
  EXPECT_GT(counts.plain, 0.5 * counts.windows);
}

TEST(StereoProfile, OverexposedObjectsGiveNoSamples) {
  Table table("cylinder", 3, 300);
  Profile profile;
  const MatchCounts counts = table.matched(0.2, 0.2 + kPairTurn_rad).fill(profile);
  EXPECT_EQ(profile.size(), 0u);
  EXPECT_GT(counts.unknown, 200);
}

TEST(StereoProfile, EqualAnglesAreRefused) {
  Table table("cylinder", 3, 6);
  const auto picture = table.picture(0.5);
  const auto pair = StereoPair::begin(table.calibration(), {}, table.mode(), {}, {picture, 0.5, 0}, {picture, 0.5, 0});
  ASSERT_FALSE(pair);
  EXPECT_NE(pair.error().find("turned by 0.000 degrees"), std::string::npos) << pair.error();
}

}  // namespace
}  // namespace celadon
