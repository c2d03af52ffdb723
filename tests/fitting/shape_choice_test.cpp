// Cylinder, sphere or pieces: by bodies whose shape is known.

#include <gtest/gtest.h>

#include "fitting/shape_choice.h"
#include "tests/fitting/composite_tools.h"

namespace celadon {
namespace {

using namespace test;

// Discs at given heights, in the density of the stream's wall.
void add_disc(MemoryStream& stream, double R, double z, int samples, double sigma, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0, 1);
  stream.profiles.emplace_back();
  stream.profiles.back().order = ProfileOrder::scattered;
  for (int k = 0; k < samples; ++k)
    push(stream.profiles.back(), R * std::sqrt(share(random)), 2 * kPi * share(random), z + sigma * normal(random));
}

TEST(ShapeChoice, WallsAndWallsWithFlatEndsAreCylinders) {
  MemoryStream wall = scattered_pieces(capsule(25, 0, 80, false, false), 20000, 0.05, 1);
  const auto open = choose_shape(wall);
  ASSERT_TRUE(open) << open.error().message;
  EXPECT_EQ(open->shape, BodyShape::cylinder) << open->reason;
  add_disc(wall, 25, 80, 3000, 0.05, 2);
  add_disc(wall, 25, 0, 3000, 0.05, 3);
  const auto closed = choose_shape(wall);
  ASSERT_TRUE(closed) << closed.error().message;
  EXPECT_EQ(closed->shape, BodyShape::cylinder) << closed->reason;
}

TEST(ShapeChoice, BallsAreSpheres) {
  MemoryStream ball =
      scattered_body([](double, double) { return 25.0; }, {.samples = 20000, .sigma = 0.05, .centre_z = 40});
  const auto choice = choose_shape(ball);
  ASSERT_TRUE(choice) << choice.error().message;
  EXPECT_EQ(choice->shape, BodyShape::sphere) << choice->reason;
  EXPECT_NEAR(choice->centre_z_mm, 40, 0.01);
  MemoryStream egg = scattered_body([](double phi, double) { return 25 + 4 * std::cos(phi); }, {.samples = 20000});
  const auto of_egg = choose_shape(egg);
  ASSERT_TRUE(of_egg) << of_egg.error().message;
  EXPECT_EQ(of_egg->shape, BodyShape::sphere) << of_egg->reason;
}

TEST(ShapeChoice, SplitsCapsulesAtTheCentresOfTheirHeads) {
  for (const bool below : {false, true})
    for (const bool above : {false, true}) {
      if (!below && !above) continue;
      MemoryStream samples = scattered_pieces(capsule(25, 10, 110, below, above), 30000, 0.02, 4);
      const auto choice = choose_shape(samples);
      ASSERT_TRUE(choice) << choice.error().message;
      EXPECT_EQ(choice->shape, BodyShape::composite) << choice->reason;
      ASSERT_EQ(choice->split.below_mm.has_value(), below);
      ASSERT_EQ(choice->split.above_mm.has_value(), above);
      EXPECT_NEAR(choice->split.below_mm.value_or(10), 10, 0.01);
      EXPECT_NEAR(choice->split.above_mm.value_or(110), 110, 0.01);
    }
}

TEST(ShapeChoice, FindsTheHeadOfAKnob) {
  MemoryStream samples = scattered_pieces(Knob{.slope = 0, .low = -20}.body(), 30000, 0.02, 5);
  const auto choice = choose_shape(samples);
  ASSERT_TRUE(choice) << choice.error().message;
  EXPECT_EQ(choice->shape, BodyShape::composite) << choice->reason;
  ASSERT_TRUE(choice->split.above_mm);
  EXPECT_FALSE(choice->split.below_mm);
  EXPECT_NEAR(*choice->split.above_mm, 60, 8);
  const auto fit = fit_composite(samples, choice->split);
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_NEAR(fit->report.geometric_mm.rms, 0.02, 2e-3);
  EXPECT_LT(fit->joints[0].after.angle_rad, 0.05 * kPi / 180);
}

TEST(ShapeChoice, DoesAsItIsTold) {
  MemoryStream samples = scattered_pieces(capsule(25, 10, 90, false, true), 20000, 0.02, 6);
  EXPECT_EQ(choose_shape(samples, BodyShape::cylinder)->shape, BodyShape::cylinder);
  EXPECT_EQ(choose_shape(samples, BodyShape::sphere)->shape, BodyShape::sphere);
  MemoryStream wall = scattered_pieces(capsule(25, 0, 80, false, false), 20000, 0.05, 1);
  const auto none = choose_shape(wall, BodyShape::composite);
  ASSERT_FALSE(none);
  EXPECT_NE(none.error().message.find("no head"), std::string::npos) << none.error().message;
  MemoryStream few = scattered_pieces(capsule(25, 0, 80, false, false), 20, 0.05, 1);
  EXPECT_FALSE(choose_shape(few));
}

}  // namespace
}  // namespace celadon
