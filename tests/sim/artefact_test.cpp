#include "sim/artefact.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "sim/assembly_body.h"
#include "sim/box_body.h"
#include "sim/scene.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

// The solid, written out again: how far inside it a point is, below 0 outside.
double depth_mm(const Vector3d& p) {
  const auto cylinder = [&](double x, double y, double radius, double low, double high) {
    return std::min({radius - std::hypot(p.x() - x, p.y() - y), p.z() - low, high - p.z()});
  };
  double depth = cylinder(0, 0, 60, 0, 8);
  const double balls[3][4] = {{40, 0, 28, 30.0124}, {-22, 31, 78, 30.0071}, {-8, -18, 52, 24.0048}};
  for (const auto& [x, y, z, diameter] : balls) {
    depth = std::max({depth, diameter / 2 - (p - Vector3d(x, y, z)).norm(), cylinder(x, y, 4, 8, z)});
  }
  const double azimuth = 305 * std::numbers::pi / 180;
  const double out = std::cos(azimuth) * p.x() + std::sin(azimuth) * p.y();
  const double beside = std::cos(azimuth) * p.y() - std::sin(azimuth) * p.x();
  return std::max(depth, std::min({out - 34, 46 - out, 14 - std::abs(beside), p.z() - 8, 42 - p.z()}));
}

// Parts hide each other: no ray passes through the solid before its hit, and every hit lies on it and faces the ray.
TEST(Artefact, RaysMeetTheClosedFormFirst) {
  const auto body = make_artefact();
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> unit(-1, 1);
  int hits = 0, through = 0;
  for (int i = 0; i < 4000; ++i) {
    const double angle = std::numbers::pi * unit(random);
    const Vector3d from(300 * std::cos(angle), 300 * std::sin(angle), 60 + 60 * unit(random));
    const Ray ray{from, (Vector3d(50 * unit(random), 50 * unit(random), 48 + 48 * unit(random)) - from).normalized()};
    const auto hit = body->intersect(ray, 0, 1000);
    const double end = hit ? hit->t : 500;
    for (double t = 200; t < end - 0.01; t += 0.21) ASSERT_LT(depth_mm(ray.p + t * ray.d), 1e-9) << i << " at " << t;
    if (!hit) {
      ++through;
      continue;
    }
    ++hits;
    const Vector3d p = ray.p + hit->t * ray.d;
    EXPECT_NEAR(depth_mm(p), 0, 1e-9);
    EXPECT_LT(hit->normal_O.dot(ray.d), 0);
    // Along the normal one leaves the solid, unless at an edge.
    EXPECT_LT(depth_mm(p + 1e-6 * hit->normal_O.normalized()), 1e-9);
    EXPECT_GT(depth_mm(p - 1e-6 * hit->normal_O.normalized()), -1e-9);
    const auto again = body->refine(ray, hit->t + 0.3, hit->facet);
    ASSERT_TRUE(again);
    EXPECT_NEAR(again->t, hit->t, 1e-9);
    EXPECT_EQ(again->surface, hit->surface);
  }
  EXPECT_GT(hits, 1500);
  EXPECT_GT(through, 200);
}

TEST(Artefact, TheSceneStandsBesideTheAxisAndHasTheOutermostPointAsTruth) {
  const Scene scene = *Scene::make("artefact");
  EXPECT_NE(scene.pose(), ObjectPose());
  EXPECT_FALSE(scene.turns_invisibly());
  const ObjectPose& pose = scene.pose();
  for (double theta = 0; theta < 6.28; theta += 0.1) {
    for (const double z : {4.0, 28.0, 52.0, 78.0}) {
      const double r = scene.truth_r_mm(theta, z);
      const auto depth_at = [&](double at) {
        const double x = at * std::cos(theta) - pose.x_mm, y = at * std::sin(theta) - pose.y_mm;
        const double c = std::cos(pose.turn_rad), s = std::sin(pose.turn_rad);
        return depth_mm({c * x + s * y, c * y - s * x, z});
      };
      if (std::isnan(r)) {
        for (double at = 0; at < 80; at += 0.3) EXPECT_LE(depth_at(at), 1e-9);
      } else {
        EXPECT_NEAR(depth_at(r), 0, 1e-9);
        for (double at = r + 0.01; at < 80; at += 0.3) EXPECT_LT(depth_at(at), 0);
      }
    }
  }
}

TEST(Artefact, ABoxIsMetAtItsFacesAndReachesThemFromWithin) {
  const BoxBody box(10, 20, 30);
  const auto top = box.intersect({Vector3d(4, 9, 50), -Vector3d::UnitZ()}, 0, 100);
  ASSERT_TRUE(top);
  EXPECT_EQ(top->t, 20);
  EXPECT_FALSE(box.intersect({Vector3d(5.1, 9, 50), -Vector3d::UnitZ()}, 0, 100));
  EXPECT_FALSE(box.intersect({Vector3d(4, 9, 50), -Vector3d::UnitZ()}, 0, 19));
  EXPECT_NEAR(box.reach_mm({Vector3d(1, 2, 5), Vector3d(0.6, 0.8, 0)}), 4 / 0.6, 1e-12);
  EXPECT_TRUE(std::isnan(box.reach_mm({Vector3d(6, 2, 5), Vector3d(0.6, 0.8, 0)})));
}

TEST(Artefact, TheCertificateStatesTheClosedForm) {
  const std::string text = artefact_certificate();
  for (const char* stated : {"diameter = { value = 30.0124, u = 0.0 }", "centre_mm = [-22.0, 31.0, 78.0]",
                             "between = [\"A\", \"C\"]", "width_mm = 28.0", "height_mm = 34.0"}) {
    EXPECT_NE(text.find(stated), std::string::npos) << stated << " is not in\n" << text;
  }
  const auto at = text.find("distance = { value = ");
  ASSERT_NE(at, std::string::npos);
  EXPECT_EQ(std::stod(text.substr(at + 21)), std::sqrt(62. * 62 + 31 * 31 + 50 * 50));
}

}  // namespace
}  // namespace celadon::sim
