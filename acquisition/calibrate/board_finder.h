#pragma once
// Finds a target in a picture: its corners to a fraction of a pixel.

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibrate/target_board.h"

namespace celadon {

/// A corner of the board as seen: BoardCorner::id, pixel (centres at whole numbers), standard deviation of each
/// coordinate as told by the picture's noise and the corner's contrast.
struct SeenCorner {
  int id = 0;
  Eigen::Vector2d p_px = Eigen::Vector2d::Zero();
  double sigma_px = 0;
};

class BoardFinder {
 public:
  explicit BoardFinder(const TargetBoard& board);
  ~BoardFinder();
  /// Grey picture, row after row. A chessboard has to be seen whole, a tag board in part (at least 8 corners that span
  /// the plane). The error says in one sentence what was seen instead and what to do (too dark, too blurred, too far
  /// oblique, other tags, nothing).
  tl::expected<std::vector<SeenCorner>, std::string> find(std::span<const std::uint8_t> grey, int width_px,
                                                          int height_px);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace celadon
