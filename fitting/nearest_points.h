#pragma once
// The nearest of many points in space.

#include <Eigen/Core>
#include <vector>

namespace celadon {

/// A balanced kd-tree over a copy of the points, halved along the widest side of each box.
class NearestPoints {
 public:
  explicit NearestPoints(const Eigen::Matrix3Xd& points);

  struct Neighbour {
    double distance_squared = 0;
    int index = 0;                                       ///< column of the points given
    auto operator<=>(const Neighbour&) const = default;  // NOLINT(modernize-use-nullptr): its 0 is no pointer
  };
  /// The `count` nearest points, the nearest first; all if there are fewer. Ties go to the smaller index.
  std::vector<Neighbour> nearest(const Eigen::Vector3d& x, int count) const;

 private:
  // Columns [first, last) of order_: the middle one splits at `axis`; leaves have at most kLeaf.
  void split(int first, int last);
  void search(int first, int last, const Eigen::Vector3d& x, std::size_t count, std::vector<Neighbour>& heap) const;

  Eigen::Matrix3Xd points_;
  std::vector<int> order_;
  std::vector<signed char> axis_;  // of the split at this place of order_
};

}  // namespace celadon
