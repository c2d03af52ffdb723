// Pictures without a board, or with one that can not be measured, are told as such.
#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <random>

#include "tests/acquisition/calibrate/board_camera.h"

namespace celadon {
namespace {

using testing::BoardCamera;

constexpr int kPictureWidth = 96, kPictureHeight = 72;

std::vector<std::uint8_t> bytes_of(const cv::Mat& image) {
  return {image.data, image.data + image.total()};
}

// Noise of all sizes, rectangles, stripes, and squares that form no board.
std::vector<std::uint8_t> random_picture(int number) {
  std::mt19937 random(static_cast<std::mt19937::result_type>(number));
  const auto below = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  cv::Mat image(kPictureHeight, kPictureWidth, CV_8U);
  for (std::uint8_t& pixel : cv::Mat_<std::uint8_t>(image)) pixel = static_cast<std::uint8_t>(random());
  switch (number % 5) {
    case 0:
      break;
    case 1:
      cv::GaussianBlur(image, image, {}, 1 + below(4));
      cv::normalize(image, image, 0, 255, cv::NORM_MINMAX);
      break;
    case 2:
      image = 200;
      for (int i = below(60); i >= 0; --i) {
        cv::rectangle(image, cv::Rect(below(kPictureWidth), below(kPictureHeight), 5 + below(60), 5 + below(60)),
                      below(256), cv::FILLED);
      }
      break;
    case 3:
      for (int y = 0; y < kPictureHeight; ++y) {
        for (int x = 0; x < kPictureWidth; ++x) {
          image.at<std::uint8_t>(y, x) =
              static_cast<std::uint8_t>(127 + 100 * std::sin(0.05 * (1 + number % 17) * x + 0.03 * (number % 11) * y));
        }
      }
      break;
    default: {  // cells that are black or white by chance
      const int cell = 4 + below(20);
      const unsigned salt = static_cast<unsigned>(random());
      for (int y = 0; y < kPictureHeight; ++y) {
        for (int x = 0; x < kPictureWidth; ++x) {
          const unsigned key =
              static_cast<unsigned>(x / cell) * 7919U + static_cast<unsigned>(y / cell) * 104729U + salt;
          image.at<std::uint8_t>(y, x) = (key * 2654435761U >> 16 & 1U) != 0 ? 230 : 20;
        }
      }
    }
  }
  return bytes_of(image);
}

TEST(BoardFinderRefuses, AThousandPicturesWithoutABoard) {
  BoardFinder chessboard(*TargetBoard::parse("chessboard:8x5x10")), tags(*TargetBoard::parse("tags:10x7x12"));
  for (int number = 0; number < 1000; ++number) {
    const std::vector<std::uint8_t> bytes = random_picture(number);
    for (BoardFinder* finder : {&chessboard, &tags}) {
      const auto found = finder->find(bytes, kPictureWidth, kPictureHeight);
      EXPECT_FALSE(found) << "picture " << number;
      EXPECT_GT(found ? 0 : found.error().size(), 40u);
    }
  }
}

struct Bad {
  const char *board, *scene, *words;
  double light = 9, blur_px = 0.6;
};

class BadPictures : public ::testing::TestWithParam<Bad> {};

TEST_P(BadPictures, AreToldInASentenceWithTheRemedy) {
  const Bad& bad = GetParam();
  BoardCamera camera(bad.scene, bad.light, bad.blur_px);
  BoardFinder finder(*TargetBoard::parse(bad.board));
  const auto found = finder.find(camera.shoot(1), BoardCamera::kWidth, BoardCamera::kHeight);
  ASSERT_FALSE(found) << found->size();
  EXPECT_NE(found.error().find(bad.words), std::string::npos) << found.error();
  EXPECT_NE(found.error().find("; "), std::string::npos) << found.error();
  EXPECT_EQ(found.error().find('\n'), std::string::npos);
}
INSTANTIATE_TEST_SUITE_P(
    One, BadPictures,
    ::testing::Values(Bad{"chessboard:11x8x8", "board:chessboard", "too dark", 0.3},
                      Bad{"tags:10x7x12", "board:tags", "too dark", 0.3},
                      Bad{"chessboard:11x8x8", "board:chessboard", "blurred", 9, 8},
                      Bad{"tags:10x7x12", "board:tags", "blurred", 9, 8},
                      Bad{"chessboard:11x8x8", "board:tags", "no whole chessboard"},
                      Bad{"tags:10x7x12", "board:chessboard", "no tag of tags:10x7x12"},
                      Bad{"tags:10x7x12", "board:tags:10x7x12+300", "tags 300, 301"},
                      Bad{"tags:10x7x12", "board:tags:7x10x10@held:0,0,65,0,0,30", "lie otherwise"},
                      Bad{"chessboard:11x8x8", "board:chessboard:10x7x8", "no whole chessboard"},
                      Bad{"chessboard:11x8x8", "board:chessboard@held:-45,78,60,0,0,30", "no whole chessboard"},
                      Bad{"tags:10x7x12", "vase", "shows no board"}, Bad{"chessboard:11x8x8", "vase", "shows no board"},
                      Bad{"tags:10x7x12", "board:tags@held:0,0,62,0,0,108", "turn"}));

TEST(BoardFinderRefuses, BytesThatAreNoPicture) {
  BoardFinder finder(*TargetBoard::parse("tags:10x7x12"));
  const std::vector<std::uint8_t> bytes(1000);
  for (const auto& [width, height] : {std::pair{40, 26}, {10, 100}, {-1, -1000}, {0, 0}}) {
    const auto found = finder.find(bytes, width, height);
    ASSERT_FALSE(found);
    EXPECT_NE(found.error().find("1000 bytes"), std::string::npos);
  }
}

}  // namespace
}  // namespace celadon
