// Faces that end a body, against closed forms; and what only looks like one.
#include "fitting/flat_ends.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "fitting/even_points.h"
#include "fitting/point_stream.h"
#include "fitting/range_fit.h"

namespace celadon {
namespace {

using std::numbers::pi;

class Cloud {
 public:
  explicit Cloud(double sigma) : normal_(0, sigma) {}
  void wall(int n, double low, double high, double (*radius)(double t, double z)) {
    for (int k = 0; k < n; ++k) {
      const double t = turn(), z = low + (high - low) * share_(random_), r = radius(t, z) + normal_(random_);
      points_.emplace_back(r * std::cos(t), r * std::sin(t), z);
    }
  }
  void face(int n, double inner, double outer, double height, double slope = 0) {
    for (int k = 0; k < n; ++k) {
      const double t = turn(), r = std::sqrt(inner * inner + (outer * outer - inner * inner) * share_(random_));
      const double x = r * std::cos(t), y = r * std::sin(t);
      points_.emplace_back(x, y, height + slope * x + normal_(random_));
    }
  }
  Eigen::Matrix3Xd points() const {
    Eigen::Matrix3Xd all(3, static_cast<Eigen::Index>(points_.size()));
    for (std::size_t k = 0; k < points_.size(); ++k) all.col(static_cast<Eigen::Index>(k)) = points_[k];
    return all;
  }

 private:
  double turn() { return 2 * pi * share_(random_); }
  std::mt19937_64 random_{3};
  std::normal_distribution<double> normal_;
  std::uniform_real_distribution<double> share_{0, 1};
  std::vector<Eigen::Vector3d> points_;
};

double cylinder_30mm(double, double) {
  return 30;
}
double lobed(double t, double z) {
  return 30 + 2 * std::cos(3 * t) + 3 * std::sin(z / 20);
}

TEST(FlatEnds, AreFoundWithTheirHeights) {
  for (const double sigma : {0.0, 0.02, 0.2}) {
    Cloud cloud(sigma);
    cloud.wall(20000, 0, 80, lobed);
    cloud.face(4000, 0, 27, 80, 0.02);
    cloud.face(8000, 36, 80, 0);
    const FlatEnds ends = find_flat_ends(cloud.points());
    ASSERT_TRUE(ends.upper && ends.lower) << sigma;
    // Scatter over the root of the face's share of the sample.
    const double tolerance = 4 * sigma / std::sqrt(1000) + 1e-6;
    EXPECT_NEAR(ends.upper->height_mm, 80, tolerance) << sigma;
    EXPECT_NEAR(ends.upper->slope.x(), 0.02, tolerance / 13) << sigma;
    EXPECT_NEAR(ends.upper->tilt_rad(), std::atan(0.02), tolerance / 10) << sigma;
    EXPECT_NEAR(ends.lower->height_mm, 0, tolerance) << sigma;
    EXPECT_NEAR(ends.upper->half_width_mm, std::max(5 * sigma, 3e-4), 0.15 * 5 * sigma + 1e-4) << sigma;
    EXPECT_TRUE(ends.hide(10, 0, 80.2));
    EXPECT_TRUE(ends.hide(10, 0, 95));
    EXPECT_FALSE(ends.hide(30, 0, 79));
    EXPECT_TRUE(ends.hide(50, 0, -3));
  }
}

TEST(FlatEnds, WhatIsNoFlatEndIsLeftAlone) {
  const auto none = [](const Cloud& cloud, const char* what) {
    const FlatEnds ends = find_flat_ends(cloud.points());
    EXPECT_FALSE(ends.any()) << what << (ends.upper ? " upper " : " lower ")
                             << (ends.upper ? *ends.upper : *ends.lower).height_mm;
  };
  for (const double sigma : {0.0, 0.02, 0.3}) {
    Cloud open(sigma);
    open.wall(20000, 0, 80, lobed);
    none(open, "open ends");
    Cloud dome(sigma);
    dome.wall(20000, 0, 80, cylinder_30mm);
    dome.wall(8000, 80, 109.99, [](double, double z) { return std::sqrt(900 - (z - 80) * (z - 80)); });
    none(dome, "a dome");
    Cloud ball(sigma);
    ball.wall(20000, -29.999, 29.999, [](double, double z) { return std::sqrt(900 - z * z); });
    none(ball, "a ball");
    Cloud step(sigma);
    step.wall(10000, 0, 40, [](double, double) { return 40.0; });
    step.wall(10000, 40, 80, cylinder_30mm);
    step.face(4000, 30, 40, 40);
    none(step, "a step");
    Cloud cone(sigma);
    cone.wall(20000, 0, 29.9, [](double, double z) { return 30 - z; });
    none(cone, "a cone");
  }
}

TEST(FlatEnds, TheWallComesBackExact) {
  Cloud cloud(0);
  cloud.wall(20000, 0.001, 79.999, cylinder_30mm);
  cloud.face(4000, 0, 30, 80);
  cloud.face(8000, 30, 80, 0);
  PointStream all(cloud.points());
  const FlatEnds ends = find_flat_ends(even_points(all, 24000));
  ASSERT_TRUE(ends.upper && ends.lower);
  WallStream wall(all, ends);
  RangeFitOptions options;
  options.reach_start = ends.lower->height_mm;
  options.reach_end = ends.upper->height_mm;
  auto grid = choose_grid(wall, options);
  ASSERT_TRUE(grid);
  grid->z_start_mm = *options.reach_start;
  grid->z_end_mm = *options.reach_end;
  const GatheredSamples gathered = gather(wall, *grid);
  ProfileStream* const whole[] = {&wall};
  auto surface = fit_surface(gathered.sums, gathered.look, whole, options);
  ASSERT_TRUE(surface) << surface.error().message;
  EXPECT_EQ(surface->fit.report.model, SurfaceModel::cylinder);
  EXPECT_NEAR(surface->fit.function(1, 40), 30, 1e-9);
  EXPECT_NEAR(surface->fit.function.base().band_start, 0, 1e-6);
  EXPECT_NEAR(surface->fit.function.base().band_end, 80, 1e-6);
}

}  // namespace
}  // namespace celadon
