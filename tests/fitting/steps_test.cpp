// Steps of turned parts in closed form, and what is none.
#include "fitting/steps.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

namespace celadon {
namespace {

class Samples {
 public:
  explicit Samples(double sigma) : normal_(0, sigma) {}
  template <class Radius>
  void wall(
      int n, double height, Radius radius, bool (*seen)(double z) = [](double) { return true; }) {
    for (int k = 0; k < n; ++k) {
      const double v = 4 * share_(random_), z = height * share_(random_);
      if (seen(z)) samples_.push_back({radius(v, z) + normal_(random_), v, z});
    }
  }
  void shoulder(int n, double z, double inner, double outer) {
    for (int k = 0; k < n; ++k)
      samples_.push_back({inner + (outer - inner) * share_(random_), 4 * share_(random_), z + normal_(random_)});
  }
  std::vector<WallStep> steps(double height) const { return find_steps(samples_, 4, 0, height); }

 private:
  std::mt19937_64 random_{5};
  std::normal_distribution<double> normal_;
  std::uniform_real_distribution<double> share_{0, 1};
  std::vector<SamplePoint> samples_;
};

double angle_of(double v) {  // near enough
  return v * std::numbers::pi / 2;
}
double shaft(double, double z) {
  return z < 20 ? 15 : z < 50 ? 25 : z < 56 ? 20 : z < 80 ? 25 : 18 - (z - 80) * 0.2;
}

TEST(Steps, AreFoundWithTheirHeightsAndJumps) {
  for (const double sigma : {0.0, 0.02, 0.1})
    for (const bool shoulders : {false, true}) {
      Samples samples(sigma);
      samples.wall(120000, 100, shaft);
      if (shoulders) {
        samples.shoulder(4000, 20, 15, 25);
        samples.shoulder(2000, 50, 20, 25);
        samples.shoulder(2000, 80, 18, 25);
      }
      const auto steps = samples.steps(100);
      ASSERT_EQ(steps.size(), 4u) << sigma << shoulders;
      const double heights[] = {20, 50, 56, 80}, jumps[] = {10, -5, 5, -7};
      for (std::size_t k = 0; k < 4; ++k) {
        EXPECT_NEAR(steps[k].z_mm, heights[k], 0.2) << sigma << shoulders;
        EXPECT_NEAR(steps[k].jump_mm, jumps[k], 0.3 + 2 * sigma) << sigma << shoulders;
      }
    }
}

// What a scanner from above sees of a groove: nothing right below its upper edge.
TEST(Steps, AreFoundBesideShadows) {
  Samples samples(0.02);
  samples.wall(
      120000, 100, [](double, double z) { return z < 62   ? 18.0
                                                 : z < 66 ? 15.0
                                                          : 18.0; },
      [](double z) { return z < 65.2 || z >= 66; });
  const auto steps = samples.steps(100);
  ASSERT_EQ(steps.size(), 2u);
  EXPECT_NEAR(steps[0].z_mm, 62, 0.2);
  EXPECT_NEAR(steps[0].jump_mm, -3, 0.1);
  EXPECT_NEAR(steps[1].z_mm, 65.6, 0.6);
  EXPECT_NEAR(steps[1].jump_mm, 3, 0.1);
}

TEST(Steps, SmoothWallsHaveNone) {
  const auto none = [](const char* what, double sigma, double (*radius)(double, double)) {
    Samples samples(sigma);
    samples.wall(100000, 100, radius);
    for (const WallStep& step : samples.steps(100))
      ADD_FAILURE() << what << " at " << step.z_mm << " by " << step.jump_mm;
  };
  none("cylinder", 0.02, [](double, double) { return 30.0; });
  none("noisy cylinder", 2, [](double, double) { return 30.0; });
  none("cone", 0.02, [](double, double z) { return 10 + 0.9 * z; });
  none("vase", 0.02, [](double, double z) { return 30 + 8 * std::sin(z / 8); });
  none("steep shoulder of a bottle", 0.02, [](double, double z) { return 25 - 10 / (1 + std::exp(-(z - 60) / 2)); });
  none("lobes", 0.02, [](double v, double) { return 30 + 5 * std::cos(6 * angle_of(v)); });
  none("a slanted step", 0.02, [](double v, double z) { return z < 50 + 15 * std::cos(angle_of(v)) ? 20.0 : 30.0; });
}

TEST(Steps, AFewSamplesShowNone) {
  EXPECT_TRUE(find_steps({}, 4, 0, 10).empty());
  EXPECT_TRUE(Samples(0).steps(10).empty());
  Samples few(0.02);
  few.wall(300, 100, shaft);
  EXPECT_TRUE(few.steps(100).empty());
}

}  // namespace
}  // namespace celadon
