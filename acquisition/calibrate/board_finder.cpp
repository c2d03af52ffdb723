#include "acquisition/calibrate/board_finder.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cstdio>
#include <optional>
#include <utility>

#include "acquisition/calibrate/board_detection.h"
#include "acquisition/calibrate/board_picture.h"
#include "acquisition/calibrate/corner_saddle.h"

namespace celadon {
namespace {

constexpr std::size_t kFewestCorners = 8;
constexpr double kSmallestRadius_px = 3.5;
constexpr double kMostOblique = 0.22;  // short over long axis of a square's picture: 77 degrees
constexpr double kWidestCornerBlur_px = 3;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Short over long axis of the ellipse that a circle on the board becomes.
double flatness(const SaddleGuess& guess) {
  Eigen::Matrix2d sides;
  sides << guess.along_row, guess.along_column;
  const Eigen::Vector2d axes = sides.jacobiSvd().singularValues();
  return axes[1] / axes[0];
}

bool spans_plane(const std::vector<SeenCorner>& corners, const TargetBoard& board) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const SeenCorner& corner : corners) {
    mean += board.corners()[static_cast<std::size_t>(corner.id)].p_mm / static_cast<double>(corners.size());
  }
  Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
  for (const SeenCorner& corner : corners) {
    const Eigen::Vector2d d = board.corners()[static_cast<std::size_t>(corner.id)].p_mm - mean;
    spread += d * d.transpose() / static_cast<double>(corners.size());
  }
  const double least = spread.jacobiSvd().singularValues()[1];
  return least > 0.04 * board.square_mm() * board.square_mm();  // two rows have 0.25
}

std::string in_words(const char* format, double a, double b) {
  char text[240];
  std::snprintf(text, sizeof text, format, a, b);
  return text;
}

}  // namespace

struct BoardFinder::Impl {
  explicit Impl(const TargetBoard& b) : board(b) {
    if (board.has_tags()) tags.emplace(board);
  }
  TargetBoard board;
  std::optional<TagBoardDetector> tags;
};

BoardFinder::BoardFinder(const TargetBoard& board) : impl_(std::make_unique<Impl>(board)) {}
BoardFinder::~BoardFinder() = default;

tl::expected<std::vector<SeenCorner>, std::string> BoardFinder::find(std::span<const std::uint8_t> grey, int width_px,
                                                                     int height_px) {
  constexpr int kSmallest_px = 32;
  if (width_px < kSmallest_px || height_px < kSmallest_px ||
      grey.size() != static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px)) {
    return tl::unexpected("a picture of " + std::to_string(width_px) + " x " + std::to_string(height_px) +
                          " pixels with " + std::to_string(grey.size()) +
                          " bytes can not hold a board; give one byte a pixel and at least 32 x 32 of them");
  }
  const TargetBoard& board = impl_->board;
  const GreyView picture{grey, width_px, height_px};
  const auto guesses = board.has_tags() ? impl_->tags->guess(picture) : guess_chessboard(picture, board);
  if (!guesses) return tl::unexpected(guesses.error());

  std::vector<double> flat;
  for (const CornerGuess& guess : *guesses) flat.push_back(flatness(guess.saddle));
  if (!flat.empty() && median(flat) < kMostOblique) {
    return tl::unexpected(
        in_words("the board is seen too far from the side: its squares look %.1f times longer than "
                 "wide, %.1f at most; turn it towards the camera",
                 1 / median(flat), 1 / kMostOblique));
  }
  const PictureNoise noise(picture);
  std::vector<SeenCorner> seen;
  std::vector<double> blurs;
  std::size_t small = 0;
  for (const CornerGuess& guess : *guesses) {
    if (guess.saddle.radius_px < kSmallestRadius_px) {
      ++small;
      continue;
    }
    const auto saddle = fit_saddle(picture, noise, guess.saddle);
    if (!saddle || (saddle->p_px - guess.saddle.p_px).norm() > guess.tolerance_px) continue;
    const int row = guess.id / (board.columns() - 1), column = guess.id % (board.columns() - 1);
    // The square to the lower right of corner (i, j) is as black as the board's first if i + j is even.
    if ((saddle->half_contrast < 0) != ((row + column) % 2 == 0)) continue;
    seen.push_back({guess.id, saddle->p_px, saddle->sigma_px});
    blurs.push_back(saddle->blur_px);
  }
  if (!blurs.empty() && median(blurs) > kWidestCornerBlur_px) {
    return tl::unexpected(
        in_words("the picture is blurred: the board's edges are %.1f pixels wide (standard "
                 "deviation; at most %.1f); focus the lens and hold the board still",
                 median(blurs), kWidestCornerBlur_px));
  }
  const std::size_t needed = board.has_tags() ? kFewestCorners : board.corners().size();
  if (seen.size() < needed || (board.has_tags() && !spans_plane(seen, board))) {
    const std::string problem = picture_problem(picture);
    if (!problem.empty()) return tl::unexpected(problem);
    const std::string count = std::to_string(seen.size()) + " of the board's " +
                              std::to_string(board.corners().size()) + " corners are seen well";
    if (2 * small > guesses->size()) {
      return tl::unexpected("the board is too small in the picture: only " + count + "; bring it nearer");
    }
    if (!board.has_tags()) {
      return tl::unexpected("only " + count +
                            " and a chessboard needs all of them; keep hands, reflections and "
                            "shadows off it");
    }
    return tl::unexpected("only " + count +
                          ", and at least 8 that do not lie in one line are needed; show more of the "
                          "board, nearer, without reflections");
  }
  return seen;
}

}  // namespace celadon
