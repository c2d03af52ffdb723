// Distances of batches of points against closed forms and points taken one by one.
#include "fitting/signed_distance.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "tests/fitting/simd_targets.h"
#include "tests/fitting/solid_tools.h"

namespace celadon {
namespace {

struct Cloud {
  std::vector<double> x, y, z;
  void push(const Eigen::Vector3d& p) {
    x.push_back(p.x());
    y.push_back(p.y());
    z.push_back(p.z());
  }
  Eigen::Vector3d at(std::size_t k) const { return {x[k], y[k], z[k]}; }
};
Cloud around(std::mt19937_64& random, const BaseSurface& base, int n) {
  Cloud cloud;
  for (int k = 0; k < n; ++k) {
    const double t = test::uniform(random, -4, 4), r = test::uniform(random, 0.1, 60);
    cloud.push(base.X_WB * Eigen::Vector3d(r * std::cos(t), r * std::sin(t),
                                           test::uniform(random, base.band_start - 5, base.band_end + 5)));
  }
  return cloud;
}
std::vector<double> to_surface(const SignedDistance& d, const Cloud& c) {
  std::vector<double> result(c.x.size());
  d.to_surface(c.x.data(), c.y.data(), c.z.data(), result.size(), result.data());
  return result;
}
std::vector<double> along_ray(const SignedDistance& d, const Cloud& c) {
  std::vector<double> result(c.x.size());
  d.along_ray(c.x.data(), c.y.data(), c.z.data(), result.size(), result.data());
  return result;
}
// The same bits, or no number both.
void expect_same(const std::vector<double>& a, const std::vector<double>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t k = 0; k < a.size(); ++k) EXPECT_TRUE(a[k] == b[k] || (std::isnan(a[k]) && std::isnan(b[k]))) << k;
}

// r = 30 - z/2 in a moved frame: the distance from a cone's line.
TEST(SignedDistance, OfAConeIsItsDistance) {
  std::mt19937_64 random(1);
  BaseSurface base = test::band(0, 40);
  base.X_WB = test::random_placement(random);
  const RangeFunction cone(base, 1, 0, {0, 0, 1, 1}, {0, 4}, Eigen::Vector2d(30, 10));
  const Cloud cloud = around(random, base, 700);
  const SignedDistance distance(cone);
  const std::vector<double> d = to_surface(distance, cloud), e = along_ray(distance, cloud);
  int inside = 0;
  for (std::size_t k = 0; k < d.size(); ++k) {
    const Eigen::Vector3d p = base.X_WB.inverse() * cloud.at(k);
    if (p.z() < 0 || p.z() > 40) {
      EXPECT_TRUE(std::isnan(d[k]));
      EXPECT_TRUE(std::isnan(e[k]));
      continue;
    }
    const double ray = std::hypot(p.x(), p.y()) - (30 - p.z() / 2);
    EXPECT_NEAR(e[k], ray, 1e-12);
    EXPECT_NEAR(d[k], ray / std::sqrt(1.25), 1e-12);
    inside += ray < 0;
  }
  EXPECT_GT(inside, 100);
  EXPECT_LT(inside, 600);
}

RC_GTEST_PROP(SignedDistance, IsTheMembershipOfEachPoint, (unsigned seed)) {
  std::mt19937_64 random(seed);
  BaseSurface base = test::band(-20, 60);
  if (random() % 2) base.X_WB = test::random_placement(random);
  const RangeFunction f = test::random_body(random, base);
  const Cloud cloud = around(random, base, 70);
  const SignedDistance distance(f);
  const std::vector<double> d = to_surface(distance, cloud), e = along_ray(distance, cloud);
  for (std::size_t k = 0; k < d.size(); ++k) {
    const RangeFunction::Membership m = f.membership(cloud.at(k));
    RC_ASSERT(m.in_band == !std::isnan(d[k]));
    if (!m.in_band) continue;
    RC_ASSERT(std::abs(e[k] - m.ray_mm) < 1e-11);
    RC_ASSERT(std::abs(d[k] - m.signed_distance_mm) < 1e-10);
  }
}

TEST(SignedDistance, HasTheSameBitsInAnyBatchAndAtEverySimdLevel) {
  std::mt19937_64 random(2);
  BaseSurface moved = test::band(-20, 60);
  moved.X_WB = test::random_placement(random);
  for (const BaseSurface& base : {test::band(-20, 60), moved}) {
    const RangeFunction f =
        test::random_function(random, test::random_space_u(random, 3), test::random_space_v(random, 3), base);
    const SignedDistance distance(f);
    const Cloud cloud = around(random, base, 613);
    const std::vector<double> d = to_surface(distance, cloud), e = along_ray(distance, cloud);
    test::at_every_simd_level([&] {
      expect_same(to_surface(distance, cloud), d);
      expect_same(along_ray(distance, cloud), e);
      for (const std::size_t size : {std::size_t{1}, std::size_t{3}, std::size_t{64}, std::size_t{257}}) {
        std::vector<double> parts(d.size());
        for (std::size_t k = 0; k < d.size(); k += size) {
          distance.to_surface(cloud.x.data() + k, cloud.y.data() + k, cloud.z.data() + k, std::min(size, d.size() - k),
                              parts.data() + k);
        }
        expect_same(parts, d);
      }
    });
  }
}

TEST(SignedDistance, OpenArcsAreRefused) {
  BaseSurface base = test::band(0, 1);
  base.arcs = BaseArcs::open(0, 1);
  EXPECT_THROW(SignedDistance({base, 0, 0, {0, 1}, {0, 1}, Eigen::MatrixXd::Ones(1, 1)}), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
