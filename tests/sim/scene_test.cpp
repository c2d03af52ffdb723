#include "sim/scene.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "sim/shapes.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

Scene scene(const std::string& name) {
  return *Scene::make(name);
}

// Closed forms as printed in shapes.h, written out again here.
double vase_r(double z) {
  return 13 + 26 / ((1 + std::exp((25 - z) / 18)) * (1 + std::exp((z - 100) / 5))) +
         4 * std::exp(-std::pow((z - 121) / 5, 2)) + 5 * std::exp(-std::pow(z / 8, 2));
}
double humidifier_r(double psi, double z) {
  const double t = std::numbers::pi * z / 110;
  return 33 + 4 * std::sin(t) + 2.4 * std::cos(3 * psi + 0.6 * std::sin(t)) +
         0.9 * std::sin(t) * std::cos(5 * psi + 1) + 0.5 * std::cos(2 * t) * std::sin(2 * psi);
}

TEST(Scene, TruthIsThePrintedClosedForm) {
  const Scene vase = scene("vase"), squeezed = scene("vase-squeezed"), humidifier = scene("humidifier"),
              cylinder = scene("cylinder"), off = scene("cylinder-off");
  for (double theta = -7; theta < 7; theta += 0.37) {
    for (double z = 0; z <= 100; z += 7.3) {
      EXPECT_NEAR(vase.truth_r_mm(theta, z), vase_r(z), 1e-12);
      EXPECT_NEAR(cylinder.truth_r_mm(theta, z), 30, 1e-12);
      EXPECT_NEAR(humidifier.truth_r_mm(theta, z), humidifier_r(theta, z), 1e-12);
      const double a = std::cos(theta) / vase_r(z), b = std::sin(theta) / (0.75 * vase_r(z));
      EXPECT_NEAR(squeezed.truth_r_mm(theta, z), 1 / std::hypot(a, b), 1e-12);
      const double along = 6 * std::cos(theta) + 3 * std::sin(theta),
                   across = 6 * std::sin(theta) - 3 * std::cos(theta);
      EXPECT_NEAR(off.truth_r_mm(theta, z), along + std::sqrt(25.0 * 25.0 - across * across), 1e-12);
    }
  }
  EXPECT_TRUE(std::isnan(vase.truth_r_mm(0, -0.001)));
  EXPECT_TRUE(std::isnan(vase.truth_r_mm(0, 120.001)));
  EXPECT_NEAR(vase_r(78.54), 37.4, 0.01);
}

TEST(Scene, TruthOfTheTurnedAndLobedIsThePrintedClosedForm) {
  const Scene knob = scene("knob"), sphere = scene("sphere"), stepped = scene("stepped-shaft"),
              lobed = scene("lobed-shaft"), taper = scene("taper");
  for (double theta = -7; theta < 7; theta += 0.37) {
    for (double z = 0; z <= 40; z += 1.7) {
      const double flutes = 0.8 * std::cos(6 * theta) / (1 + std::exp((14 - z) / 1.5));
      EXPECT_NEAR(knob.truth_r_mm(theta, z),
                  16 + 8 / (1 + std::exp((z - 10) / 1.5)) - 6 * std::exp((z - 40) / 3) + flutes, 1e-12);
      EXPECT_NEAR(sphere.truth_r_mm(theta, z), std::sqrt(35.0 * 35.0 - (z - 35) * (z - 35)), 1e-7);
      EXPECT_NEAR(lobed.truth_r_mm(theta, z), 25 + 0.6 * std::cos(3 * theta) + 0.15 * std::cos(5 * theta + 0.4), 1e-12);
      EXPECT_NEAR(taper.truth_r_mm(theta, z), 30 - 0.1 * z, 1e-12);
    }
    for (const auto& [z, r] : {std::pair{10, 30}, {30, 24}, {50, 18}, {64, 15}, {70, 18}, {100, 12}}) {
      EXPECT_NEAR(stepped.truth_r_mm(theta, z), r, 1e-12);
    }
  }
}

// A taper that stands off the table's axis, seen from it: |p + r d| = R(z).
TEST(Scene, TurnedBodiesHaveTruthOffTheAxis) {
  Scene moved = scene("taper");
  moved.set_pose({5, -2, 1});
  for (double theta = 0; theta < 6.3; theta += 0.3) {
    const double r = moved.truth_r_mm(theta, 30);
    EXPECT_NEAR(std::hypot(r * std::cos(theta) - 5, r * std::sin(theta) + 2), 27, 1e-12);
  }
  moved.set_pose({40, 0, 0});
  EXPECT_TRUE(std::isnan(moved.truth_r_mm(0, 30)));
}

// Off the axis the truth of a freeform body is a point of its own closed form.
TEST(Scene, TruthOfAMovedFreeformBodyLiesOnIt) {
  const Scene moved("moved", make_humidifier(), 1, {4, -3, 0.7});
  for (double theta = 0; theta < 6.3; theta += 0.21) {
    for (double z = 1; z < 110; z += 13) {
      const double r = moved.truth_r_mm(theta, z);
      const double x = r * std::cos(theta) - 4, y = r * std::sin(theta) + 3;
      EXPECT_NEAR(std::hypot(x, y), humidifier_r(std::atan2(y, x) - 0.7, z), 1e-11);
    }
  }
}

TEST(Scene, RaysHitTheClosedFormFirst) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> u(-1, 1);
  for (const std::string& name : Scene::names()) {
    const Scene s = scene(name);
    int hits = 0;
    for (int i = 0; i < 1500; ++i) {
      const double angle = 3.2 * u(random);
      const double half = s.z_max_mm() / 2;
      const Vector3d from(300 * std::cos(angle), 300 * std::sin(angle), 60 + 80 * u(random));
      const Vector3d at(40 * u(random), 40 * u(random), half + (half + 10) * u(random));
      const Ray ray{from, (at - from).normalized()};
      const auto hit = s.intersect(ray);
      // No point of the ray before the hit is inside the body: fine sampling of the closed form.
      const double end = hit ? hit->t : 500;
      for (double t = 200; t < end - 0.02; t += 0.13) {
        const Vector3d p = ray.p + t * ray.d;
        const double truth = s.truth_r_mm(std::atan2(p.y(), p.x()), p.z());
        if (std::isnan(truth)) continue;
        ASSERT_GT(std::hypot(p.x(), p.y()), truth - 0.012) << name << " ray " << i << " t " << t;
      }
      if (!hit || hit->material == Material::platter) continue;
      ++hits;
      EXPECT_LT((ray.p + hit->t * ray.d - hit->p).norm(), 1e-9);
      EXPECT_NEAR(hit->normal.norm(), 1, 1e-12);
      EXPECT_LT(hit->normal.dot(ray.d), 0);
      if (std::abs(hit->normal.z()) < 1 - 1e-12) {  // else a top or a shoulder, where the truth jumps
        const double theta = std::atan2(hit->p.y(), hit->p.x());
        EXPECT_NEAR(std::hypot(hit->p.x(), hit->p.y()), s.truth_r_mm(theta, hit->p.z()), 1e-8) << name;
      }
    }
    EXPECT_GT(hits, 400) << name;
  }
}

TEST(Scene, NormalsArePerpendicularToTheSurface) {
  for (const std::string& name : Scene::names()) {
    const Scene s = scene(name);
    const auto point = [&](double theta, double z) {
      const double r = s.truth_r_mm(theta, z);
      return Vector3d(r * std::cos(theta), r * std::sin(theta), z);
    };
    for (double theta = 0.1; theta < 6.2; theta += 0.5) {
      for (double z = 5; z < std::min(95.0, s.z_max_mm() - 3); z += 11) {
        const Vector3d p = point(theta, z);
        const Vector3d out(std::cos(theta), std::sin(theta), 0);
        const auto hit = s.intersect({p + 50 * out, -out});
        ASSERT_TRUE(hit);
        constexpr double h = 1e-5;
        const Vector3d along = (point(theta + h, z) - point(theta - h, z)) / (2 * h),
                       up = (point(theta, z + h) - point(theta, z - h)) / (2 * h);
        EXPECT_NEAR(hit->normal.dot(along.normalized()), 0, 1e-8) << name;
        EXPECT_NEAR(hit->normal.dot(up.normalized()), 0, 1e-8) << name;
        EXPECT_GT(hit->normal.dot(out), 0);
        const auto refined = s.refine({p + 50 * out, -out}, hit->t + 0.3, hit->facet);
        ASSERT_TRUE(refined);
        EXPECT_NEAR(refined->t, hit->t, 1e-9);
      }
    }
  }
}

TEST(Scene, TopAndPlatterAreThere) {
  const Scene s = scene("cylinder");
  const auto top = s.intersect({Vector3d(5, 0, 200), Vector3d(0, 0, -1)});
  ASSERT_TRUE(top);
  EXPECT_NEAR(top->t, 100, 1e-12);
  EXPECT_EQ(top->material, Material::object);
  const auto platter = s.intersect({Vector3d(60, 0, 200), Vector3d(0, 0, -1)});
  ASSERT_TRUE(platter);
  EXPECT_NEAR(platter->t, 200, 1e-12);
  EXPECT_EQ(platter->material, Material::platter);
  EXPECT_FALSE(s.intersect({Vector3d(90, 0, 200), Vector3d(0, 0, -1)}));
}

TEST(Scene, UnknownNamesAreRefusedWithTheKnownOnes) {
  const auto none = Scene::make("teapot");
  ASSERT_FALSE(none);
  EXPECT_NE(none.error().find("teapot"), std::string::npos);
  EXPECT_NE(none.error().find("humidifier"), std::string::npos);
}

}  // namespace
}  // namespace celadon::sim
