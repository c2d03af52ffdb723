#include "sim/mesh_body.h"

#include <gtest/gtest.h>
#include <Eigen/LU>

#include <cmath>
#include <numbers>
#include <random>

#include "sim/scene.h"
#include "tests/sim/test_meshes.h"
#include "tests/temporary_folder.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;
using testing::box;
using testing::torus;

Ray random_ray(std::mt19937& random) {
  std::uniform_real_distribution<double> u(-1, 1);
  const Vector3d from(120 * u(random), 120 * u(random), 120 * u(random)),
      to(45 * u(random), 45 * u(random), 10 + 12 * u(random));
  return {from, to - from};
}

// Every triangle, by Cramer's rule.
std::optional<double> first_of_all(const TriangleMesh& mesh, const Ray& ray) {
  std::optional<double> first;
  for (const auto& t : mesh.triangles) {
    Eigen::Matrix3d m;
    m << mesh.vertices_mm[t[1]] - mesh.vertices_mm[t[0]], mesh.vertices_mm[t[2]] - mesh.vertices_mm[t[0]], -ray.d;
    if (std::abs(m.determinant()) < 1e-12) continue;
    const Vector3d uvt = m.fullPivLu().solve(ray.p - mesh.vertices_mm[t[0]]);
    if (uvt[0] >= 0 && uvt[1] >= 0 && uvt[0] + uvt[1] <= 1 && uvt[2] > 0 && (!first || uvt[2] < *first)) first = uvt[2];
  }
  return first;
}

TEST(MeshBody, FindsTheFirstOfAllTriangles) {
  const TriangleMesh mesh = torus(30, 10, 40, 24);
  const MeshBody body(mesh);
  std::mt19937 random(5);
  int hits = 0;
  for (int i = 0; i < 1500; ++i) {
    const Ray ray = random_ray(random);
    const auto expected = first_of_all(mesh, ray);
    const auto hit = body.intersect(ray, 0, std::numeric_limits<double>::infinity());
    ASSERT_EQ(hit.has_value(), expected.has_value()) << i;
    if (!hit) continue;
    ++hits;
    EXPECT_NEAR(hit->t, *expected, 1e-11);
  }
  EXPECT_GT(hits, 700);
}

// No ray slips through the edges and corners of a closed mesh.
TEST(MeshBody, EdgesAndCornersHoldTight) {
  const TriangleMesh mesh = torus(30, 10, 12, 8);
  const MeshBody body(mesh);
  for (const auto& t : mesh.triangles) {
    for (std::size_t k = 0; k < 3; ++k) {
      const Vector3d &a = mesh.vertices_mm[t[k]], &b = mesh.vertices_mm[t[(k + 1) % 3]];
      for (const double s : {0.0, 0.31, 0.5}) {
        const Vector3d p = a + s * (b - a),
                       middle(30 * p.x() / p.head<2>().norm(), 30 * p.y() / p.head<2>().norm(), 10);
        const Vector3d from = middle + 8 * (p - middle);  // from outside the tube onto it, at right angles
        const auto hit = body.intersect({from, p - from}, 0, 1.001);
        EXPECT_TRUE(hit) << p.transpose();
      }
    }
  }
}

TEST(MeshBody, WalksToTheNeighbouringPoint) {
  const MeshBody body(torus(30, 10, 200, 120));
  std::mt19937 random(7);
  std::normal_distribution<double> normal(0, 0.4);
  int walked = 0;
  for (int i = 0; i < 500; ++i) {
    const Ray ray = random_ray(random);
    const auto hit = body.intersect(ray, 0, 10);
    if (!hit) continue;
    const Ray near{ray.p + Vector3d(normal(random), normal(random), normal(random)), ray.d};
    const auto direct = body.intersect(near, 0, 10), refined = body.refine(near, hit->t, hit->facet);
    if (!direct || !refined || std::abs(direct->t - hit->t) * ray.d.norm() > 2) continue;
    ++walked;
    EXPECT_EQ(direct->facet, refined->facet);
    EXPECT_NEAR(direct->t, refined->t, 1e-12);
  }
  EXPECT_GT(walked, 200);
}

TEST(MeshBody, SurfacesEndAtSharpEdges) {
  const MeshBody body(box(20, 30, 50));
  const auto side = [&](const Vector3d& from) {
    const auto hit = body.intersect({from, Vector3d(0.3, 0.2, 25) - from}, 0, 1);
    EXPECT_TRUE(hit);
    return hit ? hit->surface : -1;
  };
  const int right = side({90, 0, 25}), front = side({0, 90, 25}), top = side({0, 0, 90});
  EXPECT_NE(right, front);
  EXPECT_NE(right, top);
  EXPECT_EQ(right, side({90, 10, 40}));  // the other triangle of that face
  const auto hit = body.intersect({Vector3d(90, 0, 25), Vector3d(-1, 0, 0)}, 0, 100);
  ASSERT_TRUE(hit);
  EXPECT_FALSE(body.refine({Vector3d(90, 31, 25), Vector3d(-1, 0, 0)}, hit->t, hit->facet));
}

TEST(MeshBody, TruthIsTheOutermostPoint) {
  const Scene ring("ring", std::make_shared<MeshBody>(torus(30, 10, 400, 240)), {});
  for (double theta = 0; theta < 6.3; theta += 0.37) {
    for (double z = 1; z < 20; z += 2.3) {
      const double expected = 30 + std::sqrt(100 - (z - 10) * (z - 10));
      const double r = ring.truth_r_mm(theta, z);
      EXPECT_LE(r, expected + 1e-9);
      EXPECT_NEAR(r, expected, 0.02);  // chords: 0.005 mm square to the surface
    }
  }
  EXPECT_TRUE(std::isnan(ring.truth_r_mm(0, 21)));
}

TEST(MeshBody, StandsOnThePlatterAndFacesOutwards) {
  TriangleMesh mesh = box(20, 30, 50);
  for (Vector3d& v : mesh.vertices_mm) v.z() -= 200;
  for (auto& t : mesh.triangles) std::swap(t[0], t[1]);  // inside out
  const testing::TemporaryFolder folder;
  const auto scene = Scene::make("mesh:" + folder.write("box.stl", binary_stl(mesh, "box")).string());
  ASSERT_TRUE(scene) << scene.error();
  EXPECT_NEAR(scene->z_max_mm(), 50, 1e-4);
  EXPECT_NEAR(scene->truth_r_mm(0, 10), 20, 1e-5);
  EXPECT_NEAR(scene->truth_r_mm(std::numbers::pi / 2, 10), 30, 1e-5);
  const auto hit = scene->intersect({Vector3d(90, 1, 25), Vector3d(-1, 0, 0)});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->normal.x(), 1, 1e-12);
}

TEST(MeshBody, SaysWhatIsWrongWithAFile) {
  const testing::TemporaryFolder folder;
  const auto error_of = [&](const std::string& name, const TriangleMesh& mesh) {
    const auto scene = Scene::make("mesh:" + folder.write(name, binary_ply(mesh, "test")).string());
    return scene ? "" : scene.error();
  };
  TriangleMesh metres = box(20'000, 30'000, 50'000);
  EXPECT_NE(error_of("large.ply", metres).find("scale"), std::string::npos);
  EXPECT_NE(error_of("none.ply", {}).find("no triangles"), std::string::npos);
  const auto missing = Scene::make("mesh:" + (folder / "missing.stl").string());
  ASSERT_FALSE(missing);
  EXPECT_NE(missing.error().find("missing.stl"), std::string::npos);
}

}  // namespace
}  // namespace celadon::sim
