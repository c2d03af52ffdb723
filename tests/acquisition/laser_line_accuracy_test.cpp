// How well: spread against the Cramer-Rao bound and the stated bars, bias apart from spread, stated sigma against real.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <vector>

#include "acquisition/laser_line.h"
#include "tests/acquisition/synthetic_line.h"

namespace celadon {
namespace {

using synthetic::Score;

LaserLineOptions options_for(const synthetic::Scene& scene) {
  LaserLineOptions options;
  options.read_noise = static_cast<float>(scene.read_noise);
  options.electrons_per_level = static_cast<float>(scene.electrons_per_level);
  options.speckle_contrast = static_cast<float>(scene.speckle_contrast);
  options.speckle_extent_px = scene.correlated_speckle ? static_cast<float>(synthetic::kSpeckleExtentPx) : 1.f;
  return options;
}

struct Scores {
  Score rows, smoothed;
};

void score(const synthetic::Picture& picture, bool subtract, const LaserLineOptions& options, Scores& scores) {
  std::vector<LineRow> rows(static_cast<std::size_t>(picture.height));
  std::vector<float> smoothed(rows.size());
  LaserLineExtractor(options).extract(
      synthetic::mode_of(picture.width, picture.height), picture.on,
      subtract ? std::span<const std::uint8_t>(picture.off) : std::span<const std::uint8_t>(), rows);
  smooth_line(rows, smoothed);
  for (std::size_t y = 0; y < rows.size(); ++y) {
    scores.rows.add(picture.truth, y, static_cast<double>(rows[y].x_px),
                    static_cast<double>(std::max(rows[y].sigma_px, 1e-3f)));
    scores.smoothed.add(picture.truth, y, static_cast<double>(smoothed[y]));
  }
}

TEST(LaserLineAccuracy, NominalSceneMeetsItsBar) {
  Scores alone, difference;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    const auto picture = synthetic::scan_frame(1280, 1024, synthetic::nominal_scene(), seed);
    score(picture, false, options_for(synthetic::nominal_scene()), alone);
    score(picture, true, options_for(synthetic::nominal_scene()), difference);
  }
  for (const auto* scores : {&alone, &difference}) {
    std::printf("nominal %-10s rms %.3f px, smoothed %.3f px, outliers %.3f %%, missed %.3f %%, spread/stated %.3f\n",
                scores == &alone ? "laser on" : "difference", scores->rows.rms(), scores->smoothed.rms(),
                scores->rows.outlier_percent(), scores->rows.miss_percent(), scores->rows.pull());
    EXPECT_LE(scores->rows.rms(), scores == &alone ? 0.26 : 0.27);
    EXPECT_LE(scores->smoothed.rms(), 0.15);
    EXPECT_LE(scores->rows.outlier_percent(), 0.05);
    EXPECT_LE(scores->rows.miss_percent(), 0.1);
    EXPECT_NEAR(scores->rows.pull(), 1, 0.1);
    EXPECT_LE(std::abs(scores->rows.mean()), 0.02);
  }
}

TEST(LaserLineAccuracy, DefaultsServeTheNominalSceneToo) {
  Scores scores;
  for (unsigned seed = 7; seed <= 10; ++seed) {
    score(synthetic::scan_frame(1280, 1024, synthetic::nominal_scene(), seed), true, {}, scores);
  }
  EXPECT_LE(scores.rows.rms(), 0.27);
  EXPECT_LE(scores.rows.outlier_percent(), 0.05);
  EXPECT_LE(scores.rows.miss_percent(), 0.1);
  EXPECT_NEAR(scores.rows.pull(), 1, 0.2);
}

// sigma_x = (1 / SNR) sqrt(2 sigma / sqrt(pi)): the Cramer-Rao bound for additive noise.
TEST(LaserLineAccuracy, AdditiveNoiseStaysNearTheCramerRaoBound) {
  for (const auto refinement : {LineRefinement::quasi_maximum_likelihood, LineRefinement::zero_crossing}) {
    for (const double snr : {10.0, 14.0, 20.0, 80.0}) {
      synthetic::Scene scene{.amplitude = 1.5 * snr,
                             .ambient_low = 25,
                             .speckle_contrast = 0,
                             .read_noise = 1.5,
                             .electrons_per_level = 1e9};
      LaserLineOptions options = options_for(scene);
      options.minimum_contrast = 4;
      options.refinement = refinement;
      Scores scores;
      for (unsigned seed = 1; seed <= 4; ++seed) {
        score(synthetic::straight_line(640, 600, 200 + 7.3 * seed, 0.137, 3, scene, seed), false, options, scores);
      }
      const double bound = 1 / snr * std::sqrt(2 * 3 / std::sqrt(M_PI));
      std::printf("SNR %4.0f: rms %.4f px, bound %.4f, ratio %.3f, spread/stated %.3f\n", snr, scores.rows.rms(), bound,
                  scores.rows.rms() / bound, scores.rows.pull());
      EXPECT_LE(scores.rows.rms(), 1.25 * bound);
      EXPECT_GE(scores.rows.rms(), 0.93 * bound) << "better than possible: the test is wrong";
      EXPECT_NEAR(scores.rows.pull(), 1, 0.1);
      EXPECT_EQ(scores.rows.outliers + scores.rows.missed, 0);
    }
  }
}

// Mean error over seeds. The standard error of each mean is a quarter of the bar or less.
TEST(LaserLineAccuracy, NoBiasBySlopeWidthOrBrightness) {
  struct Case {
    double slope, width, amplitude;
  };
  for (const Case c : {Case{0, 1.2, 110},
                       {0, 3, 110},
                       {0, 5, 110},
                       {0.5, 3, 110},
                       {-0.5, 3, 110},
                       {1.5, 2, 110},
                       {-1.5, 2, 110},
                       {0.1, 3, 40},
                       {0.1, 3, 200},
                       {0.1, 3, 400}}) {
    auto scene = synthetic::nominal_scene();
    scene.amplitude = c.amplitude;
    Scores alone, difference;
    for (unsigned seed = 1; seed <= 12; ++seed) {
      const double start = c.slope < 0 ? 450 : 60;
      const auto picture = synthetic::straight_line(512, 250, start + 0.83 * seed, c.slope, c.width, scene, seed);
      score(picture, false, options_for(scene), alone);
      score(picture, true, options_for(scene), difference);
    }
    std::printf(
        "slope %4.1f width %.1f amplitude %3.0f: bias %+.4f %+.4f px, spread %.3f %.3f px, spread/stated %.2f %.2f\n",
        c.slope, c.width, c.amplitude, alone.rows.mean(), difference.rows.mean(), alone.rows.rms(),
        difference.rows.rms(), alone.rows.pull(), difference.rows.pull());
    EXPECT_LE(std::abs(alone.rows.mean()), 0.02);
    EXPECT_LE(std::abs(difference.rows.mean()), 0.02);
    EXPECT_LE(alone.rows.outlier_percent() + alone.rows.miss_percent(), 0.1);
  }
}

// Where the reflectance changes across the line, every row method is drawn to the bright side; this bounds by how much.
TEST(LaserLineAccuracy, ReflectanceEdgeDrawsTheLineByLessThanItsWidth) {
  auto scene = synthetic::nominal_scene();
  scene.speckle_contrast = 0;
  for (const double contrast : {1.5, 3.0}) {
    for (const double edge_offset : {-12.0, -4.0, 0.0, 4.0, 12.0}) {
      Scores scores;
      for (unsigned seed = 1; seed <= 4; ++seed) {
        const double center = 200.3 + 0.27 * seed;
        const auto reflectance = [&](int x, int) { return x < center + edge_offset ? 1.0 : 1 / contrast; };
        score(synthetic::straight_line(512, 100, center, 0, 3, scene, seed, reflectance), false, options_for(scene),
              scores);
      }
      std::printf("reflectance %.1f : 1 at %+5.1f px: bias %+.3f px\n", contrast, edge_offset, scores.rows.mean());
      const double limit = std::abs(edge_offset) > 10 ? 0.02 : contrast > 2 ? 1.2 : 0.5;
      EXPECT_LE(std::abs(scores.rows.mean()), limit);
    }
  }
}

}  // namespace
}  // namespace celadon
