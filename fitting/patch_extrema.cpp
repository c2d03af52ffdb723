#include "fitting/patch_extrema.h"

#include <algorithm>
#include <limits>
#include <queue>
#include <utility>

namespace celadon {
namespace {

constexpr int kMostHalvings = 1 << 16;

struct Patch {
  IntervalMatrix c;
  double z0, z1, v0, v1, reach;  // reach: the largest coefficient
  int number;                    // of equal ones the older goes first: the same order always
};
struct ReachesLess {
  bool operator()(const Patch& a, const Patch& b) const {
    return a.reach != b.reach ? a.reach < b.reach : a.number > b.number;
  }
};

// The halves of Bezier coefficients along the rows, by de Casteljau's scheme.
std::pair<IntervalMatrix, IntervalMatrix> halved(const IntervalMatrix& c) {
  const Eigen::Index n = c.rows() - 1;
  IntervalMatrix low(c.rows(), c.cols()), high = c;
  for (Eigen::Index level = 0; level <= n; ++level) {
    low.row(level) = high.row(0);
    for (Eigen::Index i = 0; i < n - level; ++i) high.row(i) = 0.5 * (high.row(i) + high.row(i + 1));
  }
  return {low, high};
}

// How far the control polygon stands off, along the rows.
double bend(const IntervalMatrix& c) {
  const Eigen::Index n = c.rows();
  if (n < 3) return 0;
  return (c.topRows(n - 2) - 2 * c.middleRows(1, n - 2) + c.bottomRows(n - 2)).cwiseAbs().maxCoeff();
}

class Search {
 public:
  explicit Search(double width) : width_(width) {}

  void push(IntervalMatrix c, double z0, double z1, double v0, double v1) {
    const Eigen::Index p = c.rows() - 1, q = c.cols() - 1;
    for (const Eigen::Index i : {Eigen::Index{0}, p})  // corners are values of the function
      for (const Eigen::Index j : {Eigen::Index{0}, q})
        if (c(i, j) > value_) {
          value_ = c(i, j);
          z_ = i == 0 ? z0 : z1;
          v_ = j == 0 ? v0 : v1;
        }
    const double reach = c.maxCoeff();
    if (reach <= value_ + width_) {
      left_ = std::max(left_, reach);
    } else {
      patches_.push({std::move(c), z0, z1, v0, v1, reach, number_++});
    }
  }

  Extremum largest(const BaseArcs& arcs) {
    for (int k = 0; k < kMostHalvings && !patches_.empty() && patches_.top().reach > value_ + width_; ++k) {
      const Patch patch = patches_.top();
      patches_.pop();
      if (bend(patch.c) >= bend(patch.c.transpose())) {
        const auto [low, high] = halved(patch.c);
        const double z = 0.5 * (patch.z0 + patch.z1);
        push(low, patch.z0, z, patch.v0, patch.v1);
        push(high, z, patch.z1, patch.v0, patch.v1);
      } else {
        const auto [low, high] = halved(patch.c.transpose());
        const double v = 0.5 * (patch.v0 + patch.v1);
        push(low.transpose(), patch.z0, patch.z1, patch.v0, v);
        push(high.transpose(), patch.z0, patch.z1, v, patch.v1);
      }
    }
    const double queued = patches_.empty() ? value_ : patches_.top().reach;
    return {value_, std::max({value_, left_, queued}), arcs.theta_of_v(v_), z_};
  }

 private:
  double width_, value_ = -std::numeric_limits<double>::infinity(), left_ = value_;
  double z_ = 0, v_ = 0;
  int number_ = 0;
  std::priority_queue<Patch, std::vector<Patch>, ReachesLess> patches_;
};

Extremum largest(const BezierPatches& all, double sign, double width_mm) {
  Search search(width_mm);
  for (std::size_t j = 0; j + 1 < all.v().size(); ++j)
    for (std::size_t i = 0; i + 1 < all.along().size(); ++i)
      search.push(sign * all.patch(i, j), all.along()[i], all.along()[i + 1], all.v()[j], all.v()[j + 1]);
  return search.largest(all.arcs());
}

}  // namespace

Extrema extrema(const BezierPatches& patches, double width_mm) {
  Extrema both{largest(patches, 1, width_mm), largest(patches, -1, width_mm)};
  both.smallest.value_mm *= -1;
  both.smallest.bound_mm *= -1;
  return both;
}

}  // namespace celadon
