#include "tests/daemon/triangle_reader.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cstring>
#include <limits>
#include <map>
#include <set>
#include <stdexcept>
#include <string>

namespace celadon::testing {
namespace {

template <class T>
T take(std::string_view& bytes) {
  T value;
  if (bytes.size() < sizeof value) {
    throw std::runtime_error("mesh file too short");
  }
  std::memcpy(&value, bytes.data(), sizeof value);
  bytes.remove_prefix(sizeof value);
  return value;
}

Eigen::Vector3d take_vector(std::string_view& bytes) {
  const float x = take<float>(bytes);
  const float y = take<float>(bytes);
  const float z = take<float>(bytes);
  return {x, y, z};
}

double squared_distance_to_segment(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  const Eigen::Vector3d ab = b - a;
  const double length = ab.squaredNorm();
  const double t = length > 0 ? std::clamp((p - a).dot(ab) / length, 0.0, 1.0) : 0;
  return (p - a - t * ab).squaredNorm();
}

/// A lower bound of the distance to the triangle, in plain numbers: test programs are hardly optimised.
double squared_distance_to_box(const double* p, const double* a, const double* b, const double* c) {
  double sum = 0;
  for (int k = 0; k < 3; ++k) {
    const double low = a[k] < b[k] ? (a[k] < c[k] ? a[k] : c[k]) : (b[k] < c[k] ? b[k] : c[k]);
    const double high = a[k] > b[k] ? (a[k] > c[k] ? a[k] : c[k]) : (b[k] > c[k] ? b[k] : c[k]);
    const double out = p[k] < low ? low - p[k] : (p[k] > high ? p[k] - high : 0);
    sum += out * out;
  }
  return sum;
}

}  // namespace

bool Triangles::watertight() const {
  std::set<std::pair<std::uint32_t, std::uint32_t>> edges;
  for (const auto& face : faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      if (!edges.emplace(face[k], face[(k + 1) % 3]).second) {
        return false;
      }
    }
  }
  return std::all_of(edges.begin(), edges.end(), [&](const auto& e) { return edges.count({e.second, e.first}) == 1; });
}

long Triangles::euler_characteristic() const {
  std::set<std::pair<std::uint32_t, std::uint32_t>> edges;
  std::set<std::uint32_t> used;
  for (const auto& face : faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      edges.emplace(std::minmax(face[k], face[(k + 1) % 3]));
      used.insert(face[k]);
    }
  }
  return static_cast<long>(used.size()) - static_cast<long>(edges.size()) + static_cast<long>(faces.size());
}

double Triangles::volume() const {
  double six = 0;
  for (const auto& face : faces) {
    six += vertices[face[0]].dot(vertices[face[1]].cross(vertices[face[2]]));
  }
  return six / 6;
}

double Triangles::distance(const Eigen::Vector3d& p) const {
  double best = std::numeric_limits<double>::infinity();
  for (const auto& face : faces) {
    const Eigen::Vector3d& a = vertices[face[0]];
    const Eigen::Vector3d& b = vertices[face[1]];
    const Eigen::Vector3d& c = vertices[face[2]];
    if (squared_distance_to_box(p.data(), a.data(), b.data(), c.data()) > best) {
      continue;
    }
    const Eigen::Vector3d n = (b - a).cross(c - a);
    const bool inside =
        n.dot((b - a).cross(p - a)) >= 0 && n.dot((c - b).cross(p - b)) >= 0 && n.dot((a - c).cross(p - c)) >= 0;
    if (inside) {
      const double height = n.dot(p - a);
      best = std::min(best, height * height / n.squaredNorm());
    } else {
      best = std::min({best, squared_distance_to_segment(p, a, b), squared_distance_to_segment(p, b, c),
                       squared_distance_to_segment(p, c, a)});
    }
  }
  return std::sqrt(best);
}

Triangles read_stl(std::string_view bytes) {
  Triangles mesh;
  if (bytes.size() < 84 || bytes.substr(0, 5) == "solid") {
    throw std::runtime_error("not a binary STL");
  }
  bytes.remove_prefix(80);
  const auto count = take<std::uint32_t>(bytes);
  if (bytes.size() != 50 * std::size_t{count}) {
    throw std::runtime_error("STL of another size than its count says");
  }
  std::map<std::array<double, 3>, std::uint32_t> index;
  for (std::uint32_t i = 0; i < count; ++i) {
    mesh.normals.push_back(take_vector(bytes));
    std::array<std::uint32_t, 3> face{};
    for (auto& corner : face) {
      const Eigen::Vector3d point = take_vector(bytes);
      const auto [place, fresh] =
          index.emplace(std::array<double, 3>{point.x(), point.y(), point.z()}, mesh.vertices.size());
      if (fresh) {
        mesh.vertices.push_back(point);
      }
      corner = place->second;
    }
    mesh.faces.push_back(face);
    if (take<std::uint16_t>(bytes) != 0) {
      throw std::runtime_error("STL attribute bytes are not 0");
    }
  }
  return mesh;
}

Triangles read_ply_triangles(std::string_view bytes) {
  const auto number_after = [&](const std::string& key) {
    const std::size_t at = bytes.find(key);
    if (at == std::string_view::npos) {
      throw std::runtime_error("no " + key);
    }
    return std::stoul(std::string(bytes.substr(at + key.size(), 20)));
  };
  const std::size_t vertices = number_after("element vertex ");
  const std::size_t faces = number_after("element face ");
  const std::string end = "end_header\n";
  bytes.remove_prefix(bytes.find(end) + end.size());
  Triangles mesh;
  for (std::size_t i = 0; i < vertices; ++i) {
    mesh.vertices.push_back(take_vector(bytes));
  }
  for (std::size_t i = 0; i < faces; ++i) {
    if (take<std::uint8_t>(bytes) != 3) {
      throw std::runtime_error("not a triangle");
    }
    mesh.faces.push_back({take<std::uint32_t>(bytes), take<std::uint32_t>(bytes), take<std::uint32_t>(bytes)});
  }
  if (!bytes.empty()) {
    throw std::runtime_error("bytes after the last face");
  }
  return mesh;
}

}  // namespace celadon::testing
