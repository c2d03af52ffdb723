#include "sim/mesh_body.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>
#include <utility>

#include "daemon/files/mesh_reader.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr double kSmoothCosine = 0.99026806874157036;  // of 8 degrees
constexpr double kHighest_mm = 1000, kWidest_mm = 200;

using Neighbours = std::vector<std::array<std::int32_t, 3>>;

// Of each triangle those that share an edge with it; edges of more than two triangles join none.
Neighbours neighbours_of(const TriangleMesh& mesh) {
  struct Edge {
    std::int32_t triangle = -1, side = 0, count = 0;
  };
  std::unordered_map<std::uint64_t, Edge> edges;
  edges.reserve(mesh.triangles.size() * 3 / 2);
  Neighbours result(mesh.triangles.size(), {-1, -1, -1});
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
    for (std::size_t side = 0; side < 3; ++side) {
      const std::uint64_t a = mesh.triangles[i][(side + 1) % 3], b = mesh.triangles[i][(side + 2) % 3];
      Edge& edge = edges[std::min(a, b) << 32 | std::max(a, b)];
      ++edge.count;
      if (edge.count == 1) {
        edge.triangle = static_cast<std::int32_t>(i);
        edge.side = static_cast<std::int32_t>(side);
        continue;
      }
      auto& other = result[static_cast<std::size_t>(edge.triangle)][static_cast<std::size_t>(edge.side)];
      if (edge.count == 2) {
        other = static_cast<std::int32_t>(i);
        result[i][side] = edge.triangle;
      } else if (other >= 0) {
        for (auto& back : result[static_cast<std::size_t>(other)]) back = back == edge.triangle ? -1 : back;
        other = -1;
      }
    }
  }
  return result;
}

}  // namespace

tl::expected<std::shared_ptr<const MeshBody>, std::string> MeshBody::read(const std::string& file) {
  auto mesh = read_mesh(file);
  if (!mesh) return tl::unexpected(mesh.error());
  auto body = std::make_shared<const MeshBody>(*std::move(mesh));
  if (!(body->height_ > 0) || body->height_ > kHighest_mm || body->r_max_ > kWidest_mm) {
    return tl::unexpected(file + ": the mesh is " + std::to_string(body->height_) + " mm high and reaches " +
                          std::to_string(body->r_max_) + " mm from its z axis; the virtual scanner takes up to " +
                          std::to_string(static_cast<int>(kHighest_mm)) + " and " +
                          std::to_string(static_cast<int>(kWidest_mm)) + " mm: scale or move it");
  }
  return body;
}

MeshBody::MeshBody(TriangleMesh mesh) : neighbours_(neighbours_of(mesh)) {
  double lowest = std::numeric_limits<double>::infinity(), volume = 0;
  for (const auto& t : mesh.triangles) {
    const Vector3d &a = mesh.vertices_mm[t[0]], &b = mesh.vertices_mm[t[1]], &c = mesh.vertices_mm[t[2]];
    volume += a.dot(b.cross(c));
    lowest = std::min({lowest, a.z(), b.z(), c.z()});
  }
  std::vector<TreeTriangle> triangles;
  triangles.reserve(mesh.triangles.size());
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
    auto& t = mesh.triangles[i];
    if (volume < 0) {
      std::swap(t[1], t[2]);
      std::swap(neighbours_[i][1], neighbours_[i][2]);
    }
    const Vector3d p = mesh.vertices_mm[t[0]] - Vector3d(0, 0, lowest);
    triangles.push_back(
        {p, mesh.vertices_mm[t[1]] - mesh.vertices_mm[t[0]], mesh.vertices_mm[t[2]] - mesh.vertices_mm[t[0]]});
    for (const std::uint32_t corner : t) {
      const Vector3d v = mesh.vertices_mm[corner] - Vector3d(0, 0, lowest);
      height_ = std::max(height_, v.z());
      r_max_ = std::max(r_max_, v.head<2>().norm());
    }
  }
  // Smooth surfaces, flooded from face to face.
  std::vector<Vector3d> normals;
  normals.reserve(triangles.size());
  for (const TreeTriangle& t : triangles) normals.push_back(t.a.cross(t.b).normalized());
  surface_.assign(triangles.size(), -1);
  std::vector<std::int32_t> reached;
  for (std::size_t seed = 0, count = 0; seed < triangles.size(); ++seed) {
    if (surface_[seed] >= 0) continue;
    const auto name = static_cast<std::int32_t>(count++);
    surface_[seed] = name;
    reached.push_back(static_cast<std::int32_t>(seed));
    while (!reached.empty()) {
      const auto at = static_cast<std::size_t>(reached.back());
      reached.pop_back();
      for (const std::int32_t next : neighbours_[at]) {
        if (next < 0 || surface_[static_cast<std::size_t>(next)] >= 0) continue;
        if (normals[at].dot(normals[static_cast<std::size_t>(next)]) < kSmoothCosine) continue;
        surface_[static_cast<std::size_t>(next)] = name;
        reached.push_back(next);
      }
    }
  }
  tree_ = std::make_unique<const TriangleTree>(std::move(triangles));
}

BodyHit MeshBody::hit_at(double t, int triangle) const {
  const TreeTriangle& face = tree_->triangle(triangle);
  return {t, face.a.cross(face.b), surface_[static_cast<std::size_t>(triangle)], triangle, 0};
}

std::optional<BodyHit> MeshBody::intersect(const Ray& ray, double t_min, double t_max) const {
  const auto found = tree_->first(ray, t_min, t_max);
  if (!found) return std::nullopt;
  return hit_at(found->t, found->triangle);
}

std::optional<BodyHit> MeshBody::refine(const Ray& ray, double /*t_near*/, int facet) const {
  constexpr int kSteps = 16;
  int at = facet;
  for (int i = 0; i < kSteps; ++i) {
    const auto crossing = tree_->triangle(at).plane_crossing(ray);
    if (!crossing) return std::nullopt;
    const std::array<double, 3> weight{1 - (*crossing)[1] - (*crossing)[2], (*crossing)[1], (*crossing)[2]};
    const auto least = static_cast<std::size_t>(std::min_element(weight.begin(), weight.end()) - weight.begin());
    if (weight[least] >= -1e-9) {
      const BodyHit hit = hit_at((*crossing)[0], at);
      if (!(hit.normal_O.dot(ray.d) < 0)) return std::nullopt;
      return hit;
    }
    const int next = neighbours_[static_cast<std::size_t>(at)][least];
    if (next < 0 || surface_[static_cast<std::size_t>(next)] != surface_[static_cast<std::size_t>(at)]) {
      return std::nullopt;
    }
    at = next;
  }
  return std::nullopt;
}

double MeshBody::reach_mm(const Ray& ray) const {
  const double far = (r_max_ + ray.p.head<2>().norm() + 1) / ray.d.norm();
  const auto found = tree_->first({ray.p + far * ray.d, -ray.d}, 0, far);
  return found ? far - found->t : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace celadon::sim
