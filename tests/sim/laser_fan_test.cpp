// The line on bodies with edges, tops and undercuts, the other way round: from each pixel into the scene, and from
// there to the laser.
#include "sim/laser_fan.h"

#include <gtest/gtest.h>

#include <cmath>

#include "sim/mesh_body.h"
#include "sim/renderer.h"
#include "tests/sim/test_meshes.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;
constexpr int kColumns = 1280, kRows = 1024;
constexpr double kSigma_mm = 0.3;

struct EdgeCase {
  const char* name;
  ObjectPose pose;
  int least_lit;  ///< pixels of every fifth row
  int edges;
};
std::ostream& operator<<(std::ostream& out, const EdgeCase& c) {
  return out << c.name;
}

Scene scene_of(const EdgeCase& c) {
  if (std::string(c.name) == "ring") {
    return {"ring", std::make_shared<MeshBody>(testing::torus(28, 11, 300, 160)), c.pose};
  }
  if (std::string(c.name) == "box") return {"box", std::make_shared<MeshBody>(testing::box(20, 30, 40)), c.pose};
  Scene scene = *Scene::make(c.name);
  scene.set_pose(c.pose);
  return scene;
}

// Brightness of the sheet at the point that a pixel sees; 0 in the laser's shadow.
double seen_light(const Scene& scene, const OpticsConfig& c, const VirtualCamera& camera, int x, int y) {
  const auto hit = scene.intersect({camera.centre_W(), camera.ray_W(x, y)});
  if (!hit) return 0;
  const double s = c.sheet.normal_W.dot(hit->p) - c.sheet.distance_mm;
  if (std::abs(s) > 5 * kSigma_mm) return 0;
  const Vector3d from = c.sheet.emitter_W + s * c.sheet.normal_W, beam = hit->p - from;
  const double facing = -hit->normal.dot(beam.normalized());
  if (facing <= 0) return 0;
  if (scene.intersect({from, beam}, 0, 1 - 1e-4)) return 0;
  const double albedo = hit->material == Material::platter ? c.platter_albedo : 1;
  return c.line_levels * 0.25 / kSigma_mm * std::exp(-s * s / (2 * kSigma_mm * kSigma_mm)) * facing * albedo *
         std::hypot(c.sheet.emitter_W.x(), c.sheet.emitter_W.y()) / beam.norm();
}

class EveryPixel : public ::testing::TestWithParam<EdgeCase> {};

TEST_P(EveryPixel, SeesItsPlaceInTheSheet) {
  const Scene scene = scene_of(GetParam());
  OpticsConfig c = default_optics(kColumns, kRows, 0.7, 0.01);
  c.sheet.sigma_mm = kSigma_mm;
  c.blur_px = 0.05;
  c.reflection = 0;
  c.platter_albedo = 0.5;
  Renderer renderer(scene, c);
  Exposure e;
  e.exposure_ns = 4'000'000;
  for (int i = 0; i < 10; ++i) e.motion.samples.push_back({0, 0, 1});
  std::vector<float> image;
  renderer.render_line(e, image);
  int lit = 0, off = 0, rows_off = 0;
  double light = 0, wrong = 0;
  for (int y = 3; y < kRows; y += 5) {
    double row_light = 0, row_drawn = 0;
    for (int x = 0; x < kColumns; ++x) {
      const double drawn = static_cast<double>(image[static_cast<std::size_t>(y * kColumns + x)]);
      const double expected = seen_light(scene, c, renderer.camera(), x, y);
      row_light += expected;
      row_drawn += drawn;
      light += expected;
      wrong += std::abs(drawn - expected);
      lit += expected > 1 ? 1 : 0;
      off += std::abs(drawn - expected) > 0.05 * c.line_levels ? 1 : 0;
    }
    rows_off += std::abs(row_light - row_drawn) > 0.2 * std::max(row_light, 0.5 * c.line_levels) ? 1 : 0;
  }
  EXPECT_GT(lit, GetParam().least_lit);
  EXPECT_LT(wrong, 0.02 * light);
  EXPECT_LT(off, 0.01 * lit);
  EXPECT_LE(rows_off, GetParam().edges);  // a row through which an edge runs is lit as if it were whole
}
INSTANTIATE_TEST_SUITE_P(Bodies, EveryPixel,
                         ::testing::Values(EdgeCase{"knob", {2, 1, 0.3}, 500, 1}, EdgeCase{"sphere", {}, 500, 0},
                                           EdgeCase{"sphere", {3, -2, 0}, 500, 0},
                                           EdgeCase{"stepped-shaft", {}, 1000, 5},
                                           EdgeCase{"stepped-shaft", {-4, 3, 0}, 1000, 5},
                                           EdgeCase{"lobed-shaft", {0, 0, 1}, 1000, 1},
                                           EdgeCase{"taper", {1, 1, 0}, 1000, 1}, EdgeCase{"ring", {}, 500, 1},
                                           EdgeCase{"ring", {5, 8, 0}, 500, 1}, EdgeCase{"box", {0, 0, 0.5}, 500, 2}));

}  // namespace
}  // namespace celadon::sim
