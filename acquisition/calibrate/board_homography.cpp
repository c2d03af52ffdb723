#include "acquisition/calibrate/board_homography.h"

#include <opencv2/calib3d.hpp>
#include <vector>

namespace celadon {

std::optional<Eigen::Matrix3d> board_homography(const TargetBoard& board, std::span<const SeenCorner> corners) {
  if (corners.size() < 4) return std::nullopt;
  std::vector<cv::Point2d> printed, seen;
  for (const SeenCorner& corner : corners) {
    const Eigen::Vector2d& p = board.corners()[static_cast<std::size_t>(corner.id)].p_mm;
    printed.emplace_back(p.x(), p.y());
    seen.emplace_back(corner.p_px.x(), corner.p_px.y());
  }
  const cv::Mat found = cv::findHomography(printed, seen);
  if (found.empty()) return std::nullopt;
  Eigen::Matrix3d H;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) H(i, j) = found.at<double>(i, j);
  }
  return H;
}

}  // namespace celadon
