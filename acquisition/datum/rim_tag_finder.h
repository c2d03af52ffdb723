#pragma once
// Fiducials on the platter in a picture, wherever they are.

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <Eigen/Core>

namespace celadon {

/// A tag of the family tag36h11 as it was seen: the corners of its black square, upper left, upper right, lower right,
/// lower left of the upright tag; pixel centres at whole numbers.
struct SeenTag {
  int number = 0;
  std::array<Eigen::Vector2d, 4> corners_px;
};

/// The detector of libapriltag.
class RimTagFinder {
 public:
  RimTagFinder();
  ~RimTagFinder();
  RimTagFinder(const RimTagFinder&) = delete;
  RimTagFinder& operator=(const RimTagFinder&) = delete;
  /// @param grey  width x height levels, row by row
  std::vector<SeenTag> find(std::span<const std::uint8_t> grey, int width_px, int height_px);

 private:
  struct Library;
  std::unique_ptr<Library> library_;
};

}  // namespace celadon
