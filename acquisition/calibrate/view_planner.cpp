#include "acquisition/calibrate/view_planner.h"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "acquisition/calibrate/board_homography.h"

namespace celadon {
namespace {

using Eigen::Vector2d;

constexpr double kDegree_rad = std::numbers::pi / 180;
constexpr int kParts = 3;            // of the picture, each way
constexpr int kCornersOfAPart = 20;  // that count as seen there
constexpr int kTiltedViews = 2;      // each way
constexpr double kTilted_rad = 15 * kDegree_rad;
constexpr double kDistances = 1.2;  // farthest to nearest
// What makes a view another one.
constexpr double kMoved = 0.08;  // of the picture's width
constexpr double kNearer = 0.1, kTurned_rad = 10 * kDegree_rad;

/// Picture of a point of the board and its derivative, by a homography.
struct Mapped {
  Vector2d p;
  Eigen::Matrix2d J;
};
Mapped map(const Eigen::Matrix3d& H, const Vector2d& p) {
  const Eigen::Vector3d q = H * p.homogeneous();
  Mapped m{q.hnormalized(), {}};
  m.J = (H.topLeftCorner<2, 2>() - m.p * H.bottomLeftCorner<1, 2>()) / q.z();
  return m;
}

double between(double a, double b) {
  return std::abs(std::remainder(a - b, 2 * std::numbers::pi));
}

}  // namespace

BoardAppearance appearance_of(const TargetBoard& board, std::span<const SeenCorner> corners) {
  BoardAppearance seen;
  const auto found = board_homography(board, corners);
  if (!found) return seen;
  const Eigen::Matrix3d& H = *found;
  const Mapped middle = map(H, Vector2d::Zero());
  const Eigen::JacobiSVD<Eigen::Matrix2d> svd(middle.J, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Vector2d s = svd.singularValues();
  seen.middle_px = middle.p;
  seen.px_per_mm = s.x();
  seen.roll_rad = std::atan2(middle.J(1, 0), middle.J(0, 0));
  const double tilt = std::acos(std::clamp(s.y() / s.x(), 0., 1.));
  // What comes nearer grows.
  const Vector2d along_board = svd.matrixV().col(1) * board.square_mm();
  const double ahead = map(H, along_board).J.determinant(), behind = map(H, -along_board).J.determinant();
  seen.tilt_rad = svd.matrixU().col(1) * (std::abs(ahead) > std::abs(behind) ? tilt : -tilt);
  return seen;
}

ViewPlanner::ViewPlanner(const TargetBoard& board, int width_px, int height_px, int wanted)
    : board_(board), width_px_(width_px), height_px_(height_px), wanted_(wanted), corners_in_part_(kParts * kParts) {}

bool ViewPlanner::is_new(std::span<const SeenCorner> corners) const {
  const BoardAppearance now = appearance_of(board_, corners);
  return std::none_of(views_.begin(), views_.end(), [&](const BoardAppearance& then) {
    return (now.middle_px - then.middle_px).norm() < kMoved * width_px_ &&
           std::abs(now.px_per_mm / then.px_per_mm - 1) < kNearer &&
           (now.tilt_rad - then.tilt_rad).norm() < kTurned_rad && between(now.roll_rad, then.roll_rad) < kTurned_rad;
  });
}

void ViewPlanner::add(std::span<const SeenCorner> corners) {
  views_.push_back(appearance_of(board_, corners));
  for (const SeenCorner& c : corners) {
    const int column = std::clamp(static_cast<int>(c.p_px.x() / width_px_ * kParts), 0, kParts - 1);
    const int row = std::clamp(static_cast<int>(c.p_px.y() / height_px_ * kParts), 0, kParts - 1);
    ++corners_in_part_[static_cast<std::size_t>(row * kParts + column)];
  }
}

bool ViewPlanner::complete() const {
  return views() >= 2 * wanted_ || (views() >= wanted_ && advice().empty());
}

std::string ViewPlanner::advice() const {
  struct Way {
    Vector2d direction;
    const char* edge;
  };
  const std::array<Way, 4> ways = {{{Vector2d(-1, 0), "left edge"},
                                    {Vector2d(1, 0), "right edge"},
                                    {Vector2d(0, -1), "upper edge"},
                                    {Vector2d(0, 1), "lower edge"}}};
  for (const Way& way : ways) {
    const auto tilted = std::count_if(views_.begin(), views_.end(), [&](const BoardAppearance& view) {
      return view.tilt_rad.dot(way.direction) > kTilted_rad;
    });
    if (tilted < kTiltedViews) return std::string("Tilt the board so that its ") + way.edge + " comes nearer.";
  }
  static constexpr std::array<const char*, kParts* kParts> kNames = {
      "upper left corner", "upper edge",        "upper right corner", "left edge",         "middle",
      "right edge",        "lower left corner", "lower edge",         "lower right corner"};
  for (std::size_t part = 0; part < corners_in_part_.size(); ++part) {
    if (corners_in_part_[part] < kCornersOfAPart) {
      return std::string("Move the board to the ") + kNames.at(part) + " of the picture.";
    }
  }
  const auto [far, near] = std::minmax_element(views_.begin(), views_.end(),
                                               [](const auto& a, const auto& b) { return a.px_per_mm < b.px_per_mm; });
  if (views_.empty() || near->px_per_mm < kDistances * far->px_per_mm) {
    return "Hold the board nearer to the camera, and farther away.";
  }
  if (views() < wanted_) return "Hold the board in other places and at other angles.";
  return "";
}

}  // namespace celadon
