#include "acquisition/calibrate/board_detection.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <opencv2/calib3d.hpp>

namespace celadon {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kEdgePixelCentre = 0.5;  // libapriltag counts pixels from their edges
constexpr int kMostWrongBits = 1;
constexpr float kLeastMargin = 15;  // of a decoded tag, levels

Vector2d through(const Eigen::Matrix3d& H, double x, double y) {
  return (H * Vector3d(x, y, 1)).hnormalized();
}

std::string what_is_seen(const GreyView& picture, const std::string& otherwise) {
  std::string problem = picture_problem(picture);
  return problem.empty() ? otherwise : problem;
}

// Levels of the black and of the white squares that four inner corners surround, if corner (i, j) of the board is
// corners[at(i, j)].
template <class At>
double white_over_black(const GreyView& picture, const TargetBoard& board, const std::vector<Vector2d>& corners,
                        const At& at) {
  double sums[2] = {0, 0};
  int counts[2] = {0, 0};
  for (int j = 0; j + 2 < board.rows(); ++j) {
    for (int i = 0; i + 2 < board.columns(); ++i) {
      const Vector2d middle =
          (corners[at(i, j)] + corners[at(i + 1, j)] + corners[at(i, j + 1)] + corners[at(i + 1, j + 1)]) / 4;
      if (!picture.holds(middle, 2)) continue;
      const int white = (i + j) % 2;  // its square is column i + 1, row j + 1
      sums[white] += picture.mean_about(middle);
      ++counts[white];
    }
  }
  return sums[1] / std::max(counts[1], 1) - sums[0] / std::max(counts[0], 1);
}

std::string shown_tags(const std::vector<int>& tags) {
  std::string out;
  for (std::size_t i = 0; i < std::min<std::size_t>(tags.size(), 4); ++i) {
    out += (i > 0 ? ", " : "") + std::to_string(tags[i]);
  }
  return out + (tags.size() > 4 ? " ..." : "");
}

}  // namespace

double free_radius_px(const Vector2d& along_row, const Vector2d& along_column, bool has_tags) {
  constexpr double kLargest_px = 9, kBlur_px = 1;
  // A tag begins half of what it leaves free of its square from the square's sides, a neighbour a whole side away.
  const double share = has_tags ? 0.5 * (1 - TargetBoard::kTagShare) : 0.8;
  const double area = std::abs(along_row.x() * along_column.y() - along_row.y() * along_column.x());
  const double height = area / std::max({along_row.norm(), along_column.norm(), 1e-9});
  return std::min(kLargest_px, share * height - kBlur_px);
}

tl::expected<std::vector<CornerGuess>, std::string> guess_chessboard(const GreyView& picture,
                                                                     const TargetBoard& board) {
  const int columns = board.columns() - 1, rows = board.rows() - 1;
  // OpenCV takes no constant pictures and writes to none.
  const cv::Mat image(picture.height_px, picture.width_px, CV_8U, const_cast<std::uint8_t*>(picture.bytes.data()));
  std::vector<cv::Point2f> found;
  const bool complete = cv::findChessboardCornersSB(image, cv::Size(columns, rows), found,
                                                    cv::CALIB_CB_ACCURACY | cv::CALIB_CB_EXHAUSTIVE);
  if (!complete || found.size() != board.corners().size()) {
    return tl::unexpected(
        what_is_seen(picture, "no whole " + board.text() +
                                  " is seen; hold all of it with its white margin into the picture, turned "
                                  "towards the camera by at least 30 degrees, and free of shadows"));
  }
  std::vector<Vector2d> p;
  for (const cv::Point2f& corner : found) p.emplace_back(corner.x, corner.y);
  const auto index = [columns](int i, int j) { return static_cast<std::size_t>(j * columns + i); };
  // A board that is seen from its front has its columns clockwise of its rows.
  const Vector2d row = p[index(columns - 1, 0)] - p[0], column = p[index(0, rows - 1)] - p[0];
  if (row.x() * column.y() - row.y() * column.x() < 0) {
    for (int j = 0; j < rows; ++j) std::reverse(p.begin() + j * columns, p.begin() + (j + 1) * columns);
  }
  if (white_over_black(picture, board, p, index) < 0) std::reverse(p.begin(), p.end());

  std::vector<CornerGuess> guesses;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const int left = std::max(i - 1, 0), right = std::min(i + 1, columns - 1), above = std::max(j - 1, 0),
                below = std::min(j + 1, rows - 1);
      CornerGuess guess;
      guess.id = j * columns + i;
      guess.saddle.p_px = p[index(i, j)];
      guess.saddle.along_row = (p[index(right, j)] - p[index(left, j)]) / (right - left);
      guess.saddle.along_column = (p[index(i, below)] - p[index(i, above)]) / (below - above);
      guess.saddle.radius_px = free_radius_px(guess.saddle.along_row, guess.saddle.along_column, false);
      guess.tolerance_px = 1.5;
      guesses.push_back(guess);
    }
  }
  return guesses;
}

struct TagBoardDetector::Library {
  std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)> family{tag36h11_create(), tag36h11_destroy};
  std::unique_ptr<apriltag_detector_t, void (*)(apriltag_detector_t*)> detector{apriltag_detector_create(),
                                                                                apriltag_detector_destroy};
};

TagBoardDetector::TagBoardDetector(const TargetBoard& board) : board_(board), library_(std::make_unique<Library>()) {
  apriltag_detector_add_family_bits(library_->detector.get(), library_->family.get(), kMostWrongBits);
  library_->detector->quad_decimate = 1;  // cells may be as small as 5 pixels
  library_->detector->nthreads = 1;
}

TagBoardDetector::~TagBoardDetector() = default;

std::vector<TagBoardDetector::Tag> TagBoardDetector::detect(const GreyView& picture, std::vector<int>& others) {
  std::map<int, std::pair<int, int>> squares;
  for (int row = 0; row < board_.rows(); ++row) {
    for (int column = 0; column < board_.columns(); ++column) {
      if (const int tag = board_.tag_at(column, row); tag >= 0) squares[tag] = {column, row};
    }
  }
  image_u8_t image{picture.width_px, picture.height_px, picture.width_px,
                   const_cast<std::uint8_t*>(picture.bytes.data())};  // is not written to
  const std::unique_ptr<zarray_t, void (*)(zarray_t*)> found(apriltag_detector_detect(library_->detector.get(), &image),
                                                             apriltag_detections_destroy);
  std::vector<Tag> tags;
  for (int i = 0; i < zarray_size(found.get()); ++i) {
    apriltag_detection_t* detection = nullptr;
    zarray_get(found.get(), i, &detection);
    if (detection->decision_margin < kLeastMargin) continue;
    const auto square = squares.find(detection->id);
    if (square == squares.end()) {
      others.push_back(detection->id);
      continue;
    }
    Tag tag{detection->id, square->second.first, square->second.second, {}};
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) tag.H(r, c) = MATD_EL(detection->H, r, c);
    }
    Eigen::Matrix3d shift = Eigen::Matrix3d::Identity();
    shift.topRightCorner<2, 1>().setConstant(-kEdgePixelCentre);
    tag.H = shift * tag.H;
    tags.push_back(tag);
  }
  return tags;
}

void TagBoardDetector::keep_consistent(std::vector<Tag>& tags) const {
  constexpr double kHalf = 0.5 * TargetBoard::kTagShare;
  std::vector<cv::Point2d> on_board, in_picture;
  double side_px = 0;
  for (const Tag& tag : tags) {
    for (const auto& [x, y] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}) {
      const Vector2d p = through(tag.H, x, y);
      on_board.emplace_back(tag.column + 0.5 + kHalf * x, tag.row + 0.5 + kHalf * y);
      in_picture.emplace_back(p.x(), p.y());
    }
    const Vector2d diagonal = through(tag.H, 1, 1) - through(tag.H, -1, -1);
    side_px = std::max(side_px, diagonal.norm() / std::sqrt(2.0) / TargetBoard::kTagShare);
  }
  // A lens bends the board by less than a quarter of a square.
  std::vector<unsigned char> fits;
  const cv::Mat H = cv::findHomography(on_board, in_picture, fits, cv::RANSAC, std::max(2.0, 0.25 * side_px));
  std::size_t kept = 0;
  for (std::size_t i = 0; i < tags.size() && !H.empty(); ++i) {
    if (fits[4 * i] + fits[4 * i + 1] + fits[4 * i + 2] + fits[4 * i + 3] == 4) tags[kept++] = tags[i];
  }
  tags.resize(kept);
}

tl::expected<std::vector<CornerGuess>, std::string> TagBoardDetector::guess(const GreyView& picture) {
  std::vector<int> others;
  std::vector<Tag> tags = detect(picture, others);
  if (tags.empty()) {
    if (!others.empty()) {
      return tl::unexpected("the picture shows tags " + shown_tags(others) + " that are not on " + board_.text() +
                            "; hold up the right board or name the one in use");
    }
    return tl::unexpected(
        what_is_seen(picture, "no tag of " + board_.text() +
                                  " is seen; hold the board into the picture, nearer, turned towards the "
                                  "camera by at least 30 degrees"));
  }
  const std::size_t seen = tags.size();
  keep_consistent(tags);
  if (2 * tags.size() < seen + 1) {
    return tl::unexpected("of " + std::to_string(seen) + " tags " + std::to_string(seen - tags.size()) +
                          " lie otherwise than on " + board_.text() + "; name the board that is in use");
  }
  std::map<int, std::vector<CornerGuess>> by_corner;
  constexpr double kSquare = 1 / TargetBoard::kTagShare;  // half its side in the tag's units
  for (const Tag& tag : tags) {
    for (const auto& [x, y] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}) {
      const int i = tag.column + (x > 0 ? 0 : -1), j = tag.row + (y > 0 ? 0 : -1);
      if (i < 0 || j < 0 || i + 1 >= board_.columns() || j + 1 >= board_.rows()) continue;
      CornerGuess guess;
      guess.id = j * (board_.columns() - 1) + i;
      guess.saddle.p_px = through(tag.H, kSquare * x, kSquare * y);
      // Sides of a square, as large there as half a side to both sides tells.
      guess.saddle.along_row =
          through(tag.H, kSquare * (x + 1), kSquare * y) - through(tag.H, kSquare * (x - 1), kSquare * y);
      guess.saddle.along_column =
          through(tag.H, kSquare * x, kSquare * (y + 1)) - through(tag.H, kSquare * x, kSquare * (y - 1));
      by_corner[guess.id].push_back(guess);
    }
  }
  std::vector<CornerGuess> guesses;
  for (const auto& [id, from_tags] : by_corner) {
    CornerGuess mean = from_tags.front();
    if (from_tags.size() == 2) {
      const SaddleGuess& other = from_tags.back().saddle;
      mean.saddle.p_px = 0.5 * (mean.saddle.p_px + other.p_px);
      mean.saddle.along_row = 0.5 * (mean.saddle.along_row + other.along_row);
      mean.saddle.along_column = 0.5 * (mean.saddle.along_column + other.along_column);
    }
    mean.saddle.radius_px = free_radius_px(mean.saddle.along_row, mean.saddle.along_column, true);
    mean.tolerance_px = std::max(1.0, 0.03 * std::max(mean.saddle.along_row.norm(), mean.saddle.along_column.norm()));
    guesses.push_back(mean);
  }
  return guesses;
}

}  // namespace celadon
