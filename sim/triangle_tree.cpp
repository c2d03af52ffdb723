#include "sim/triangle_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr int kBins = 16, kLeaf = 4, kDepth = 64;
constexpr double kTraverse = 1.5;  // cost of a node relative to a triangle
constexpr double kEdge = 1e-9;     // of the barycentric coordinates

struct Box {
  Vector3d low = Vector3d::Constant(std::numeric_limits<double>::infinity()), high = -low;

  void add(const Vector3d& p) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  void add(const Box& box) {
    low = low.cwiseMin(box.low);
    high = high.cwiseMax(box.high);
  }
  double half_area() const {
    const Vector3d d = (high - low).cwiseMax(0);
    return d.x() * d.y() + d.y() * d.z() + d.z() * d.x();
  }
};

Box box_of(const TreeTriangle& t) {
  Box box;
  box.add(t.p);
  box.add(t.p + t.a);
  box.add(t.p + t.b);
  return box;
}

// Rounded outwards, with room for the rounding of the slab test.
float below(double v) {
  return static_cast<float>(v - 1e-6 * (1 + std::abs(v)));
}
float above(double v) {
  return static_cast<float>(v + 1e-6 * (1 + std::abs(v)));
}

}  // namespace

std::optional<Vector3d> TreeTriangle::plane_crossing(const Ray& ray) const {
  const Vector3d q = ray.d.cross(b);
  const double det = a.dot(q);
  if (det == 0) return std::nullopt;
  const double inverse = 1 / det;
  const Vector3d s = ray.p - p, r = s.cross(a);
  return Vector3d(b.dot(r), s.dot(q), ray.d.dot(r)) * inverse;
}

TriangleTree::TriangleTree(std::vector<TreeTriangle> triangles)
    : triangles_(std::move(triangles)), order_(triangles_.size()) {
  std::iota(order_.begin(), order_.end(), 0);
  std::vector<Vector3d> centres;
  centres.reserve(triangles_.size());
  for (const TreeTriangle& t : triangles_) centres.push_back(t.p + (t.a + t.b) / 3);
  nodes_.reserve(triangles_.size());
  build(0, static_cast<std::int32_t>(triangles_.size()), centres);
  packed_.reserve(triangles_.size());
  for (const std::int32_t i : order_) packed_.push_back(triangles_[static_cast<std::size_t>(i)]);
}

std::int32_t TriangleTree::build(std::int32_t begin, std::int32_t end, const std::vector<Vector3d>& centres) {
  Box box, middles;
  for (std::int32_t i = begin; i < end; ++i) {
    const auto t = static_cast<std::size_t>(order_[static_cast<std::size_t>(i)]);
    box.add(box_of(triangles_[t]));
    middles.add(centres[t]);
  }
  const auto self = static_cast<std::int32_t>(nodes_.size());
  Node node{};
  for (std::size_t k = 0; k < 3; ++k) {
    node.low[k] = below(box.low[static_cast<Eigen::Index>(k)]);
    node.high[k] = above(box.high[static_cast<Eigen::Index>(k)]);
  }
  nodes_.push_back(node);
  const auto first = order_.begin() + begin, last = order_.begin() + end;
  const std::int32_t count = end - begin;

  // The cheapest of kBins - 1 planes across the axis along which the centres spread most.
  Eigen::Index axis = 0;
  const double extent = (middles.high - middles.low).maxCoeff(&axis);
  auto split = first;
  if (extent > 0) {
    const auto bin_of = [&](std::int32_t t) {
      const double at = (centres[static_cast<std::size_t>(t)][axis] - middles.low[axis]) / extent;
      return std::min(kBins - 1, static_cast<int>(at * kBins));
    };
    std::array<Box, kBins> boxes;
    std::array<int, kBins> counts{};
    for (auto i = first; i != last; ++i) {
      const auto bin = static_cast<std::size_t>(bin_of(*i));
      boxes[bin].add(box_of(triangles_[static_cast<std::size_t>(*i)]));
      ++counts[bin];
    }
    std::array<double, kBins> left{};
    Box sum;
    int n = 0;
    for (std::size_t b = 0; b + 1 < kBins; ++b) {
      sum.add(boxes[b]);
      n += counts[b];
      left[b] = n > 0 ? n * sum.half_area() : 0;
    }
    sum = {};
    n = 0;
    double best = std::numeric_limits<double>::infinity();
    int best_bin = 0;
    for (std::size_t b = kBins - 1; b > 0; --b) {
      sum.add(boxes[b]);
      n += counts[b];
      const double cost = left[b - 1] + (n > 0 ? n * sum.half_area() : 0);
      if (cost < best) {
        best = cost;
        best_bin = static_cast<int>(b);
      }
    }
    if (count > kLeaf || best / std::max(box.half_area(), 1e-30) + kTraverse < count) {
      split = std::partition(first, last, [&](std::int32_t t) { return bin_of(t) < best_bin; });
    }
  } else if (count > kLeaf) {
    split = first + count / 2;  // centres that coincide
  }
  if (split == first || split == last) {
    nodes_[static_cast<std::size_t>(self)].begin = begin;
    nodes_[static_cast<std::size_t>(self)].count = count;
    return self;
  }
  const auto middle = static_cast<std::int32_t>(split - order_.begin());
  build(begin, middle, centres);
  const std::int32_t right = build(middle, end, centres);
  nodes_[static_cast<std::size_t>(self)].begin = right;
  return self;
}

std::optional<TriangleTree::Found> TriangleTree::first(const Ray& ray, double t_min, double t_max) const {
  const Vector3d inverse = ray.d.cwiseInverse();
  const auto enter = [&](const Node& node) {
    double from = t_min, to = t_max;
    for (std::size_t k = 0; k < 3; ++k) {
      const auto axis = static_cast<Eigen::Index>(k);
      const double a = (static_cast<double>(node.low[k]) - ray.p[axis]) * inverse[axis];
      const double b = (static_cast<double>(node.high[k]) - ray.p[axis]) * inverse[axis];
      from = std::max(from, std::min(a, b));  // a ray inside the slab's plane gives NaN, which max and min drop
      to = std::min(to, std::max(a, b));
    }
    return from <= to ? from : std::numeric_limits<double>::infinity();
  };
  std::array<std::pair<std::int32_t, double>, kDepth> stack;
  std::size_t waiting = 0;
  std::optional<Found> found;
  std::int32_t at = 0;
  if (enter(nodes_[0]) == std::numeric_limits<double>::infinity()) return found;
  while (true) {
    const Node& node = nodes_[static_cast<std::size_t>(at)];
    if (node.count > 0) {
      for (std::int32_t i = node.begin; i < node.begin + node.count; ++i) {
        const auto hit = packed_[static_cast<std::size_t>(i)].plane_crossing(ray);
        if (!hit || !((*hit)[0] > t_min && (*hit)[0] < t_max)) continue;
        const double u = (*hit)[1], v = (*hit)[2];
        if (u < -kEdge || v < -kEdge || u + v > 1 + kEdge) continue;
        t_max = (*hit)[0];
        found = Found{t_max, order_[static_cast<std::size_t>(i)]};
      }
    } else {
      const std::int32_t left = at + 1, right = node.begin;
      const double to_left = enter(nodes_[static_cast<std::size_t>(left)]),
                   to_right = enter(nodes_[static_cast<std::size_t>(right)]);
      const bool left_first = to_left <= to_right;
      const double near = left_first ? to_left : to_right, far = left_first ? to_right : to_left;
      if (far < std::numeric_limits<double>::infinity() && waiting < kDepth) {
        stack[waiting++] = {left_first ? right : left, far};
      }
      if (near < std::numeric_limits<double>::infinity()) {
        at = left_first ? left : right;
        continue;
      }
    }
    do {
      if (waiting == 0) return found;
      at = stack[--waiting].first;
    } while (stack[waiting].second >= t_max);
  }
}

}  // namespace celadon::sim
