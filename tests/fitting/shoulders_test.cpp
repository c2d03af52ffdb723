// Bodies of several walls with plane shoulders between them: turned parts in closed form.

#include "fitting/shoulders.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "fitting/composite_fit.h"
#include "fitting/shape_choice.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::kPi;
using test::MemoryStream;
using test::push;
using test::Shape;

struct Shaft {
  std::vector<double> ends;  // of the walls, from below
  std::vector<Shape> walls;  // one fewer
  bool rings = true;         // their samples, too
  double fillet = 0;         // radius in the inner corners and off the outer ones
  Shape at(double z) const {
    std::size_t k = 0;
    while (k + 1 < walls.size() && z >= ends[k + 1]) ++k;
    return walls[k];
  }
};

// How far a round of that radius takes the wall off at a distance from its end.
double rounded(double radius, double distance) {
  const double d = radius - distance;
  return d <= 0 ? 0 : radius - std::sqrt(std::max(0.0, radius * radius - d * d));
}

MemoryStream scattered_shaft(const Shaft& shaft, int n, double sigma, unsigned seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> noise(0, sigma > 0 ? sigma : 1);
  const auto error = [&] { return sigma > 0 ? noise(random) : 0.0; };
  MemoryStream stream;
  for (int k = 0; k < n; ++k) {
    if (k % 1024 == 0) {
      stream.profiles.emplace_back();
      stream.profiles.back().order = ProfileOrder::scattered;
    }
    const double t = 2 * kPi * share(random);
    if (shaft.rings && k % 10 == 0 && shaft.walls.size() > 1) {
      const auto j = 1 + static_cast<std::size_t>(share(random) * static_cast<double>(shaft.walls.size() - 1));
      const double z = shaft.ends[j], from = shaft.walls[j - 1](t, z), to = shaft.walls[j](t, z);
      push(stream.profiles.back(), from + (to - from) * share(random), t, z + error());
      continue;
    }
    const double z = shaft.ends.front() + (shaft.ends.back() - shaft.ends.front()) * share(random);
    double r = shaft.at(z)(t, z);
    for (std::size_t j = 1; j + 1 < shaft.ends.size(); ++j) {
      const double below = shaft.walls[j - 1](t, z), above = shaft.walls[j](t, z);
      const bool inner = (z < shaft.ends[j]) == (below < above);
      r += (inner ? 1 : -1) * rounded(shaft.fillet, std::abs(z - shaft.ends[j]));
    }
    push(stream.profiles.back(), r + error(), t, z);
  }
  return stream;
}

Shape turned(double radius) {
  return [radius](double, double) { return radius; };
}
Shaft four_diameters(bool rings) {
  return {.ends = {0, 20, 50, 56, 100}, .walls = {turned(15), turned(25), turned(20), turned(12)}, .rings = rings};
}

TEST(Shoulders, AShaftComesBackExact) {
  const Shaft shaft = four_diameters(true);
  MemoryStream samples = scattered_shaft(shaft, 100000, 0, 1);
  const auto choice = choose_shape(samples);
  ASSERT_TRUE(choice) << choice.error().message;
  ASSERT_EQ(choice->shape, BodyShape::composite) << choice->reason;
  EXPECT_THAT(choice->reason, testing::HasSubstr("steps all around at z = 20, 50, 56 mm"));
  const auto fit = fit_composite(samples, choice->split);
  ASSERT_TRUE(fit) << fit.error().message;
  ASSERT_EQ(fit->pieces.size(), 4u);
  ASSERT_EQ(fit->shoulders.size(), 3u);
  const double radii[] = {15, 25, 20, 12}, jumps[] = {10, -5, -8};
  for (std::size_t k = 0; k < 4; ++k) {
    const RangeFit& wall = fit->pieces[k];
    EXPECT_EQ(wall.report.model, SurfaceModel::cylinder) << k;
    EXPECT_NEAR(wall.function(1, (shaft.ends[k] + shaft.ends[k + 1]) / 2), radii[k], 1e-9);
    if (k > 0) {
      EXPECT_EQ(wall.function.base().band_start, fit->pieces[k - 1].function.base().band_end);
    }
  }
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_NEAR(fit->shoulders[k].height_mm, shaft.ends[k + 1], 1e-12);
    EXPECT_NEAR(fit->shoulders[k].jump_mm, jumps[k], 1e-9);
    EXPECT_GT(fit->shoulders[k].seen, 100u);
  }
  // All but the samples on the rings and right beside them belong to a wall.
  EXPECT_NEAR(static_cast<double>(fit->report.points), 90000, 1000);
  EXPECT_LT(fit->report.geometric_mm.max, 1e-9);
}

TEST(Shoulders, UnderNoiseHeightsAndRadiiAreAsGoodAsTheSamples) {
  for (const bool rings : {false, true})
    for (const double sigma : {0.02, 0.1}) {
      SCOPED_TRACE(testing::Message() << "rings " << rings << ", noise " << sigma);
      const Shaft shaft = four_diameters(rings);
      MemoryStream samples = scattered_shaft(shaft, 100000, sigma, 2);
      const auto shoulders = find_shoulders(samples);
      ASSERT_EQ(shoulders.size(), 3u);
      for (std::size_t k = 0; k < 3; ++k) {
        EXPECT_NEAR(shoulders[k].height_mm, shaft.ends[k + 1], 4 * shoulders[k].sd_mm + 1e-4) << k;
        EXPECT_LT(shoulders[k].sd_mm, rings ? sigma / 10 : 0.002) << k;
        EXPECT_LT(shoulders[k].edge_mm, rings ? 6 * sigma + 0.1 : 0.1) << k;
      }
      const auto fit = fit_composite(samples, {{}, {}, shoulders}, {.form_tolerance_mm = 0.002});
      ASSERT_TRUE(fit) << fit.error().message;
      const double radii[] = {15, 25, 20, 12};
      for (std::size_t k = 0; k < 4; ++k) {
        const RangeFit& wall = fit->pieces[k];
        const auto n = static_cast<double>(wall.report.points);
        EXPECT_EQ(wall.report.model, SurfaceModel::cylinder) << k << wall.report.decided_by;
        EXPECT_NEAR(wall.function(1, (shaft.ends[k] + shaft.ends[k + 1]) / 2), radii[k], 4 * sigma / std::sqrt(n)) << k;
        EXPECT_NEAR(wall.report.noise_mm, sigma, 0.05 * sigma) << k;
      }
    }
}

// Rounds of 1 mm belong to no wall: what is fitted between them does not bend.
TEST(Shoulders, RoundedEdgesAreLeftOut) {
  Shaft shaft{.ends = {0, 40, 80}, .walls = {turned(20), turned(32)}, .rings = true, .fillet = 1};
  MemoryStream samples = scattered_shaft(shaft, 120000, 0.01, 3);
  const auto shoulders = find_shoulders(samples);
  ASSERT_EQ(shoulders.size(), 1u);
  EXPECT_NEAR(shoulders[0].height_mm, 40, 0.01);
  EXPECT_GT(shoulders[0].edge_mm, 0.4);
  EXPECT_LT(shoulders[0].edge_mm, 1.5);
  const auto fit = fit_composite(samples, {{}, {}, shoulders}, {.form_tolerance_mm = 0.002});
  ASSERT_TRUE(fit) << fit.error().message;
  for (std::size_t k = 0; k < 2; ++k) {
    EXPECT_EQ(fit->pieces[k].report.model, SurfaceModel::cylinder) << fit->pieces[k].report.decided_by;
    EXPECT_NEAR(fit->pieces[k].function(0, 40), k == 0 ? 20 : 32, 0.001);
  }
}

// Walls of any form: a lobed cam on a taper.
TEST(Shoulders, WallsMayBeOfAnyForm) {
  const Shape taper = [](double, double z) { return 18 + 0.1 * z; };
  const Shape cam = [](double t, double z) { return 32 + 3 * std::cos(2 * t) + 0.01 * (z - 50); };
  const Shaft shaft{.ends = {0, 50, 90}, .walls = {taper, cam}, .rings = true};
  MemoryStream samples = scattered_shaft(shaft, 150000, 0.01, 4);
  const auto choice = choose_shape(samples);
  ASSERT_TRUE(choice && choice->shape == BodyShape::composite);
  const auto fit = fit_composite(samples, choice->split, {.form_tolerance_mm = 0.002});
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_EQ(fit->pieces[0].report.model, SurfaceModel::revolution) << fit->pieces[0].report.decided_by;
  EXPECT_EQ(fit->pieces[1].report.model, SurfaceModel::general) << fit->pieces[1].report.decided_by;
  EXPECT_LT(test::miss(fit->pieces[0].function, taper).rms, 0.002);
  EXPECT_LT(test::miss(fit->pieces[1].function, cam).rms, 0.002);
}

// A dome on the upper of two walls: shoulder and joint in one body.
TEST(Shoulders, GoWithHeads) {
  std::mt19937_64 random(6);
  std::uniform_real_distribution<double> share(0, 1);
  const Shaft shaft{.ends = {0, 30, 60}, .walls = {turned(35), turned(20)}, .rings = true};
  MemoryStream samples = scattered_shaft(shaft, 80000, 0, 5);
  for (int k = 0; k < 20000; ++k) {
    const double c = share(random);
    push(samples.profiles[static_cast<std::size_t>(k) % samples.profiles.size()], 20 * std::sqrt(1 - c * c),
         2 * kPi * share(random), 60 + 20 * c);
  }
  const auto choice = choose_shape(samples);
  ASSERT_TRUE(choice && choice->shape == BodyShape::composite);
  ASSERT_TRUE(choice->split.above_mm) << choice->reason;
  ASSERT_EQ(choice->split.shoulders.size(), 1u) << choice->reason;
  const auto fit = fit_composite(samples, choice->split);
  ASSERT_TRUE(fit) << fit.error().message;
  ASSERT_EQ(fit->pieces.size(), 3u);
  ASSERT_EQ(fit->joints.size(), 1u);
  EXPECT_NEAR(fit->pieces[1].function(0, 40), 20, 1e-7);
  EXPECT_NEAR(fit->pieces[2].function(0, 0.5), 20, 1e-7);
  EXPECT_LT(fit->joints[0].after.gap_mm, 1e-9);
}

TEST(Shoulders, RefusalsNamePlaceAndRemedy) {
  const Shaft shaft = four_diameters(true);
  MemoryStream samples = scattered_shaft(shaft, 60000, 0.01, 7);
  const auto refused = [&](ProfileStream& of, std::vector<double> heights) -> std::string {
    const auto fit = fit_composite(of, {{}, {}, shoulders_at(of, heights)});
    return fit ? "fitted" : fit.error().message;
  };
  EXPECT_EQ(refused(samples, {20, 50, 56}), "fitted");
  EXPECT_THAT(refused(samples, {50, 20}), testing::HasSubstr("50 mm is not below the next one at 20 mm"));
  EXPECT_THAT(refused(samples, {20, 50, 200}), testing::HasSubstr("the wall from"));
  // An ellipse on a circle of its middle radius.
  const Shape ellipse = [](double t, double) { return 20 + 4 * std::cos(2 * t); };
  MemoryStream crossing =
      scattered_shaft({.ends = {0, 30, 60}, .walls = {turned(20), ellipse}, .rings = false}, 60000, 0.01, 8);
  EXPECT_THAT(refused(crossing, {30}), testing::HasSubstr("cross near"));
}

// A groove scanned in rows from above: the shadow under its upper edge is the groove's, not the edge's.
TEST(Shoulders, ShadowsBelongToTheInnerWall) {
  std::mt19937_64 random(9);
  std::normal_distribution<double> noise(0, 0.02);
  MemoryStream samples;
  for (int i = 0; i < 400; ++i) {
    samples.profiles.emplace_back();
    for (double z = 0.05; z < 100; z += 0.13)
      if (z < 65.2 || z >= 66)
        push(samples.profiles.back(), (z >= 62 && z < 66 ? 15 : 18) + noise(random), 2 * kPi * i / 400, z);
  }
  const auto shoulders = find_shoulders(samples);
  ASSERT_EQ(shoulders.size(), 2u);
  EXPECT_NEAR(shoulders[0].height_mm, 62, 0.13);  // rows are that far apart
  EXPECT_NEAR(shoulders[1].height_mm, 66, 0.13);
  const auto fit = fit_composite(samples, {{}, {}, shoulders}, {.form_tolerance_mm = 0.002});
  ASSERT_TRUE(fit) << fit.error().message;
  const double radii[] = {18, 15, 18};
  for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(fit->pieces[k].function(1, 64), radii[k], 0.002) << k;
}

TEST(Shoulders, SmoothWallsHaveNone) {
  MemoryStream vase = test::scattered([](double, double z) { return 30 + 8 * std::sin(z / 8); }, 60000, 0.02);
  EXPECT_TRUE(find_shoulders(vase).empty());
  MemoryStream freeform = test::scattered(test::freeform, 60000, 0.02);
  EXPECT_TRUE(find_shoulders(freeform).empty());
  MemoryStream dome = test::scattered([](double, double z) { return std::sqrt(1600 - z * z); }, 60000, 0.02, 1, 39.9);
  EXPECT_TRUE(find_shoulders(dome).empty());
  MemoryStream none;
  EXPECT_TRUE(find_shoulders(none).empty());
}

}  // namespace
}  // namespace celadon
