// Printed boards, read back from the SVG and PDF text by readers of this test and looked at by libapriltag.
#include "daemon/cli/board_sheet.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <sstream>

namespace celadon::cli {
namespace {

struct Box {
  double x, y, width, height;  // mm, y down
};
struct ReadSheet {
  double width = 0, height = 0;
  std::vector<Box> boxes;
  std::string words;
};

ReadSheet read_svg(const std::string& text) {
  ReadSheet sheet;
  EXPECT_EQ(std::sscanf(text.c_str(), "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%lfmm\" height=\"%lfmm\"",
                        &sheet.width, &sheet.height),
            2);
  EXPECT_NE(text.find("fill-rule=\"evenodd\""), std::string::npos);
  const std::size_t begin = text.find("d=\"\n"), end = text.find("\"/>", begin);
  std::istringstream path(text.substr(begin + 4, end - begin - 4));
  for (std::string line; std::getline(path, line);) {
    Box box{};
    double back = 0;
    EXPECT_EQ(std::sscanf(line.c_str(), "M%lf %lfh%lfv%lfh%lfz", &box.x, &box.y, &box.width, &box.height, &back), 5)
        << line;
    EXPECT_EQ(back, -box.width);
    sheet.boxes.push_back(box);
  }
  sheet.words = text.substr(end);
  return sheet;
}

// The objects lie where the table says, the stream is as long as it says.
ReadSheet read_pdf(const std::string& text) {
  ReadSheet sheet;
  EXPECT_EQ(text.rfind("%PDF-1.4\n", 0), 0u);
  const std::size_t start = std::stoul(text.substr(text.rfind("startxref\n") + 10));
  EXPECT_EQ(text.compare(start, 5, "xref\n"), 0);
  std::istringstream table(text.substr(start + 5));
  int first = 0, count = 0;
  table >> first >> count;
  for (int i = 0; i < count; ++i) {
    std::size_t offset = 0;
    std::string generation, kind;
    table >> offset >> generation >> kind;
    EXPECT_TRUE(i == 0 || text.compare(offset, 7, std::to_string(i) + " 0 obj") == 0) << i;
  }
  double low_x = 0, low_y = 0;
  EXPECT_EQ(std::sscanf(text.c_str() + text.find("/MediaBox ["), "/MediaBox [%lf %lf %lf %lf]", &low_x, &low_y,
                        &sheet.width, &sheet.height),
            4);
  const double mm = 25.4 / 72;
  sheet.width *= mm;
  sheet.height *= mm;
  const std::size_t length = std::stoul(text.substr(text.find("/Length ") + 8));
  const std::size_t begin = text.find("stream\n") + 7;
  EXPECT_EQ(text.compare(begin + length, 9, "endstream"), 0);
  std::istringstream content(text.substr(begin, length));
  double scale = 0;
  std::string line;
  std::getline(content, line);
  EXPECT_EQ(std::sscanf(line.c_str(), "%lf 0 0 %*f 0 0 cm", &scale), 1);
  EXPECT_NEAR(scale * mm, 1, 1e-5);
  bool filled = false;
  while (std::getline(content, line)) {
    Box box{};
    if (std::sscanf(line.c_str(), "%lf %lf %lf %lf re", &box.x, &box.y, &box.width, &box.height) == 4 && !filled) {
      box.y = sheet.height - box.y - box.height;
      sheet.boxes.push_back(box);
    }
    filled = filled || line == "f*";
    if (line.ends_with(" Tj")) sheet.words += line + "\n";
  }
  EXPECT_TRUE(filled);
  return sheet;
}

bool is_black(const ReadSheet& sheet, double x, double y) {
  bool black = false;
  for (const Box& box : sheet.boxes) {
    if (x >= box.x && x < box.x + box.width && y >= box.y && y < box.y + box.height) black = !black;
  }
  return black;
}

// Middles of the tags that libapriltag sees, mm.
std::map<int, std::pair<double, double>> tags_on(const ReadSheet& sheet) {
  constexpr double kPixels = 8;  // a millimetre
  const int width = static_cast<int>(sheet.width * kPixels), height = static_cast<int>(sheet.height * kPixels);
  std::vector<std::uint8_t> pixels(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), 0);
  for (const Box& box : sheet.boxes) {
    const auto pixel = [](double at) { return static_cast<int>(std::ceil(at * kPixels - 0.5)); };
    for (int y = pixel(box.y); y < std::min(height, pixel(box.y + box.height)); ++y) {
      for (int x = pixel(box.x); x < std::min(width, pixel(box.x + box.width)); ++x) {
        pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)] ^= 1;
      }
    }
  }
  for (std::uint8_t& pixel : pixels) pixel = pixel != 0 ? 10 : 245;
  apriltag_family_t* family = tag36h11_create();
  apriltag_detector_t* detector = apriltag_detector_create();
  apriltag_detector_add_family_bits(detector, family, 0);
  image_u8_t image{width, height, width, pixels.data()};
  zarray_t* found = apriltag_detector_detect(detector, &image);
  std::map<int, std::pair<double, double>> tags;
  for (int i = 0; i < zarray_size(found); ++i) {
    apriltag_detection_t* tag = nullptr;
    zarray_get(found, i, &tag);
    tags[tag->id] = {tag->c[0] / kPixels, tag->c[1] / kPixels};
  }
  apriltag_detections_destroy(found);
  apriltag_detector_destroy(detector);
  tag36h11_destroy(family);
  return tags;
}

struct Case {
  const char *board, *page;
  int columns, rows;
  double square;
  int first_tag;  // -1: none
};

class BoardSheets : public ::testing::TestWithParam<Case> {};

TEST_P(BoardSheets, ShowTheBoardAtTrueSize) {
  const Case& c = GetParam();
  const auto sheet = lay_out_board(*TargetBoard::parse(c.board));
  ASSERT_TRUE(sheet) << sheet.error();
  EXPECT_EQ(sheet->page, c.page);
  for (const ReadSheet& read : {read_svg(svg_of(*sheet)), read_pdf(pdf_of(*sheet))}) {
    EXPECT_NEAR(read.width, sheet->width_mm, 1e-3);
    EXPECT_NEAR(read.height, sheet->height_mm, 1e-3);
    EXPECT_NE(read.words.find(c.board), std::string::npos);
    EXPECT_NE(read.words.find("100 mm along x"), std::string::npos);
    EXPECT_NE(read.words.find("100 mm along y"), std::string::npos);
    EXPECT_NE(read.words.find("measure the printed pitch"), std::string::npos);
    for (const Box& box : read.boxes) {
      EXPECT_GT(box.x, 5);
      EXPECT_GT(box.y, 4);
      EXPECT_LT(box.x + box.width, read.width - 5);
      EXPECT_LT(box.y + box.height, read.height - 5);
    }
    // The board's own squares are the largest; the first of them is its upper left one.
    const auto first = std::find_if(read.boxes.begin(), read.boxes.end(), [&](const Box& b) {
      return std::abs(b.width - c.square) < 1e-4 && std::abs(b.height - c.square) < 1e-4;
    });
    ASSERT_NE(first, read.boxes.end());
    const double left = first->x, top = first->y;
    for (int row = -1; row <= c.rows; ++row) {
      for (int column = -1; column <= c.columns; ++column) {
        const bool inside = row >= 0 && column >= 0 && row < c.rows && column < c.columns;
        const bool black = inside && (row + column) % 2 == 0;
        // Near the square's edge, where no tag is; of the margin the half next to the board.
        for (const auto& [dx, dy] : {std::pair{0.06, 0.5}, {0.94, 0.5}, {0.5, 0.06}, {0.5, 0.94}}) {
          if (!inside && ((column < 0 && dx < 0.6) || (column >= c.columns && dx > 0.4) || (row < 0 && dy < 0.6) ||
                          (row >= c.rows && dy > 0.4)))
            continue;
          EXPECT_EQ(is_black(read, left + (column + dx) * c.square, top + (row + dy) * c.square), black)
              << column << " " << row;
        }
      }
    }
    const auto tags = tags_on(read);
    EXPECT_EQ(tags.size(), c.first_tag < 0 ? 0u : static_cast<std::size_t>(c.columns * c.rows / 2));
    int tag = c.first_tag;
    for (int row = 0; row < c.rows && c.first_tag >= 0; ++row) {
      for (int column = 0; column < c.columns; ++column) {
        if ((row + column) % 2 == 0) continue;
        ASSERT_TRUE(tags.contains(tag)) << tag;
        EXPECT_NEAR(tags.at(tag).first, left + (column + 0.5) * c.square, 0.15);
        EXPECT_NEAR(tags.at(tag).second, top + (row + 0.5) * c.square, 0.15);
        ++tag;
      }
    }
    // Rulers: eleven thin marks each, 100 mm from the first to the last.
    std::vector<double> along_x, along_y;
    for (const Box& box : read.boxes) {
      if (std::abs(box.width - 0.2) < 1e-4 && box.height > 2) along_x.push_back(box.x);
      if (std::abs(box.height - 0.2) < 1e-4 && box.width > 2) along_y.push_back(box.y);
    }
    for (std::vector<double>* marks : {&along_x, &along_y}) {
      ASSERT_EQ(marks->size(), 11u);
      std::sort(marks->begin(), marks->end());
      for (int i = 0; i <= 10; ++i) EXPECT_NEAR((*marks)[static_cast<std::size_t>(i)] - marks->front(), 10.0 * i, 1e-4);
    }
  }
}
INSTANTIATE_TEST_SUITE_P(
    Each, BoardSheets,
    ::testing::Values(Case{"chessboard:11x8x8", "A4", 11, 8, 8, -1}, Case{"tags:10x7x12", "A4", 10, 7, 12, 0},
                      Case{"tags:7x10x15+40", "A4", 7, 10, 15, 40}, Case{"tags:3x3x9.5+500", "A4", 3, 3, 9.5, 500},
                      Case{"chessboard:12x9x25", "A3", 12, 9, 25, -1}, Case{"tags:9x8x40", "A2", 9, 8, 40, 0}));

TEST(RimTags, CanBeCutOutAndAreRead) {
  const auto sheet = lay_out_rim_tags("rim:12x11.2+40");
  ASSERT_TRUE(sheet) << sheet.error();
  for (const ReadSheet& read : {read_svg(svg_of(*sheet)), read_pdf(pdf_of(*sheet))}) {
    const auto tags = tags_on(read);
    EXPECT_EQ(tags.size(), 12u);
    EXPECT_TRUE(tags.contains(40) && tags.contains(51));
    // Each has its white border of a cell at least, and two that are cut apart share none of it.
    for (const auto& [id, at] : tags) {
      for (const auto& [other, there] : tags) {
        if (other != id) {
          EXPECT_GE(std::max(std::abs(at.first - there.first), std::abs(at.second - there.second)), 11.2 * 1.25);
        }
      }
      EXPECT_GT(at.first, 5 + 0.625 * 11.2);
      EXPECT_LT(at.first, read.width - 5 - 0.625 * 11.2);
    }
    EXPECT_NE(read.words.find("glue them flat"), std::string::npos);
  }
}

TEST(RimTags, RefuseWhatIsNone) {
  for (const char* text : {"rim:2x11", "rim:12x1", "rim:12", "rim:12x11+", "rim:12x11+580", "rim:12x11 ", "rim:400x40"})
    EXPECT_FALSE(lay_out_rim_tags(text)) << text;
}

TEST(BoardSheets, RefuseWhatFitsOnNoPage) {
  for (const char* text : {"chessboard:12x9x100", "tags:20x20x60"}) {
    const auto sheet = lay_out_board(*TargetBoard::parse(text));
    ASSERT_FALSE(sheet);
    EXPECT_NE(sheet.error().find("1200 x "), std::string::npos) << sheet.error();
    EXPECT_NE(sheet.error().find("A0"), std::string::npos) << sheet.error();
  }
  EXPECT_EQ(lay_out_board(*TargetBoard::parse("chessboard:12x9x80"))->page, "A0");
}

}  // namespace
}  // namespace celadon::cli
