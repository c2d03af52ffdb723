#include "acquisition/calibrate/target_board.h"

#include <gtest/gtest.h>

#include <set>

namespace celadon {
namespace {

TEST(TargetBoard, ReadsWhatItWrites) {
  for (const char* text : {"chessboard:11x8x8", "tags:10x7x12", "tags:10x7x12+40", "chessboard:4x3x0.5",
                           "tags:3x3x12.7", "chessboard:6x9x10.125"}) {
    const auto board = TargetBoard::parse(text);
    ASSERT_TRUE(board) << board.error();
    EXPECT_EQ(board->text(), text);
  }
}

TEST(TargetBoard, SaysWhatIsWrong) {
  for (const auto& [text, words] : {std::pair{"", "neither"},
                                    {"circles:11x8x8", "neither"},
                                    {"chessboard", "neither"},
                                    {"chessboard:", "can not be read"},
                                    {"chessboard:11x8", "can not be read"},
                                    {"chessboard:11x8x8 ", "can not be read"},
                                    {"chessboard:11x8x8+4", "can not be read"},
                                    {"tags:11x8x8+", "can not be read"},
                                    {"tags:11x8xnan", "outside 0 to 1000"},
                                    {"tags:11x8x0", "outside 0 to 1000"},
                                    {"tags:11x8x-3", "outside 0 to 1000"},
                                    {"chessboard:2x3x8", "3 to 60"},
                                    {"tags:61x3x8", "3 to 60"},
                                    {"tags:99999999999x3x8", "can not be read"},
                                    {"chessboard:11x9x8", "upside down"},
                                    {"chessboard:10x8x8", "upside down"},
                                    {"tags:60x60x8", "586"},
                                    {"tags:10x7x8+553", "586"},
                                    {"tags:10x7x8+-1", "586"},
                                    {"tags:10x7x8+2147483647", "586"}}) {
    const auto board = TargetBoard::parse(text);
    ASSERT_FALSE(board) << text;
    EXPECT_NE(board.error().find(words), std::string::npos) << board.error();
    EXPECT_NE(board.error().find("; "), std::string::npos) << board.error();
  }
  EXPECT_TRUE(TargetBoard::parse("tags:10x7x8+552"));
}

TEST(TargetBoard, CornersAreRowByRowAboutTheMiddle) {
  const TargetBoard board(5, 4, 10, false);
  ASSERT_EQ(board.corners().size(), 12u);
  EXPECT_EQ(board.corners()[0].p_mm, Eigen::Vector2d(-15, -10));
  EXPECT_EQ(board.corners()[3].p_mm, Eigen::Vector2d(15, -10));
  EXPECT_EQ(board.corners()[11].p_mm, Eigen::Vector2d(15, 10));
  for (std::size_t i = 0; i < 12; ++i) EXPECT_EQ(board.corners()[i].id, static_cast<int>(i));
}

TEST(TargetBoard, TagsCountTheWhiteSquares) {
  for (const auto& [columns, rows] : {std::pair{10, 7}, {7, 7}, {9, 6}, {3, 4}}) {
    const TargetBoard board(columns, rows, 10, true, 40);
    int next = 40;
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        const bool white = (row + column) % 2 == 1;
        EXPECT_EQ(board.tag_at(column, row), white ? next++ : -1);
      }
    }
    EXPECT_EQ(next, 40 + columns * rows / 2);
  }
  EXPECT_EQ(TargetBoard(10, 7, 10, false).tag_at(1, 0), -1);
}

}  // namespace
}  // namespace celadon
