#include "fitting/nearest_points.h"

#include <algorithm>
#include <numeric>

namespace celadon {
namespace {

constexpr int kLeaf = 12;

}  // namespace

NearestPoints::NearestPoints(const Eigen::Matrix3Xd& points)
    : points_(points), order_(static_cast<std::size_t>(points.cols())), axis_(static_cast<std::size_t>(points.cols())) {
  std::iota(order_.begin(), order_.end(), 0);
  split(0, static_cast<int>(order_.size()));
}

void NearestPoints::split(int first, int last) {
  if (last - first <= kLeaf) return;
  Eigen::Vector3d low = points_.col(order_[static_cast<std::size_t>(first)]), high = low;
  for (int n = first; n < last; ++n) {
    low = low.cwiseMin(points_.col(order_[static_cast<std::size_t>(n)]));
    high = high.cwiseMax(points_.col(order_[static_cast<std::size_t>(n)]));
  }
  Eigen::Index axis = 0;
  (high - low).maxCoeff(&axis);
  const int middle = first + (last - first) / 2;
  std::nth_element(order_.begin() + first, order_.begin() + middle, order_.begin() + last,
                   [&](int a, int b) { return points_(axis, a) < points_(axis, b); });
  axis_[static_cast<std::size_t>(middle)] = static_cast<signed char>(axis);
  split(first, middle);
  split(middle + 1, last);
}

void NearestPoints::search(int first, int last, const Eigen::Vector3d& x, std::size_t count,
                           std::vector<Neighbour>& heap) const {
  const auto offer = [&](int place) {
    const int index = order_[static_cast<std::size_t>(place)];
    const Neighbour candidate{(points_.col(index) - x).squaredNorm(), index};
    if (heap.size() == count) {
      if (!(candidate < heap.front())) return;
      std::pop_heap(heap.begin(), heap.end());
      heap.pop_back();
    }
    heap.push_back(candidate);
    std::push_heap(heap.begin(), heap.end());
  };
  if (last - first <= kLeaf) {
    for (int place = first; place < last; ++place) offer(place);
    return;
  }
  const int middle = first + (last - first) / 2;
  const auto m = static_cast<std::size_t>(middle);
  const double beyond = x[axis_[m]] - points_(axis_[m], order_[m]);
  const bool below = beyond < 0;
  offer(middle);
  search(below ? first : middle + 1, below ? middle : last, x, count, heap);
  if (heap.size() < count || beyond * beyond <= heap.front().distance_squared)
    search(below ? middle + 1 : first, below ? last : middle, x, count, heap);
}

std::vector<NearestPoints::Neighbour> NearestPoints::nearest(const Eigen::Vector3d& x, int count) const {
  std::vector<Neighbour> heap;
  if (count <= 0) return heap;
  heap.reserve(static_cast<std::size_t>(count));
  search(0, static_cast<int>(order_.size()), x, static_cast<std::size_t>(count), heap);
  std::sort_heap(heap.begin(), heap.end());
  return heap;
}

}  // namespace celadon
