#include "daemon/cli/board_sheet.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <memory>

namespace celadon::cli {
namespace {

constexpr double kBorder_mm = 10, kRuler_mm = 100, kRulerStrip_mm = 10, kMark_mm = 0.2, kLine_mm = 4.2;
constexpr double kLetter_mm = 0.53 * BoardSheet::kText_mm;  // mean width
constexpr const char* kAdvice =
    "Print at 100 % (no fitting to the page). Paper stretches differently along x and y: measure the printed pitch "
    "over all squares, from left to right and from top to bottom, and give both lengths to celadon calibrate "
    "(--width, --height).";

constexpr int kFirstRimTag = 100;  // beyond those of most boards
constexpr const char* kRimAdvice =
    "Cut the tags out, each with its white border, and glue them flat round the rim of the platter, at any distances, "
    "where "
    "no object covers them and the camera sees three or more at every angle. Where they are, celadon calibrate finds "
    "out.";

struct Page {
  const char* name;
  double width, height;
};
constexpr std::array<Page, 5> kPages{
    {{"A4", 210, 297}, {"A3", 297, 420}, {"A2", 420, 594}, {"A1", 594, 841}, {"A0", 841, 1189}}};

std::vector<std::string> wrapped(const std::string& text, std::size_t longest) {
  std::vector<std::string> lines(1);
  std::size_t at = 0;
  while (at < text.size()) {
    const std::size_t end = std::min(text.find(' ', at), text.size());
    const std::string word = text.substr(at, end - at);
    if (!lines.back().empty() && lines.back().size() + 1 + word.size() > longest) lines.emplace_back();
    lines.back() += (lines.back().empty() ? "" : " ") + word;
    at = end + 1;
  }
  return lines;
}

using TagFamily = std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)>;

// The black square of a tag, its white cells as holes.
void draw_tag(const apriltag_family_t& family, int tag, double x, double y, double side,
              std::vector<SheetRectangle>& black) {
  const double cell = side / family.width_at_border;
  black.push_back({x, y, side, side});
  // The code's bits, the highest first, are the white cells.
  const std::uint64_t code = family.codes[tag];
  for (std::uint32_t i = 0; i < family.nbits; ++i) {
    if ((code >> (family.nbits - 1 - i) & 1) == 0) continue;
    black.push_back({x + cell * family.bit_x[i], y + cell * family.bit_y[i], cell, cell});
  }
}

void draw_board(const TargetBoard& board, double left, double top, std::vector<SheetRectangle>& black) {
  const TagFamily family(tag36h11_create(), tag36h11_destroy);
  const double side = board.square_mm(), tag_side = TargetBoard::kTagShare * side, free = 0.5 * (side - tag_side);
  for (int row = 0; row < board.rows(); ++row) {
    for (int column = 0; column < board.columns(); ++column) {
      const double x = left + column * side, y = top + row * side;
      if ((column + row) % 2 == 0) black.push_back({x, y, side, side});
      if (const int tag = board.tag_at(column, row); tag >= 0) {
        draw_tag(*family, tag, x + free, y + free, tag_side, black);
      }
    }
  }
}

// Marks every 10 mm, their middles kRuler_mm apart from the first to the last.
void draw_ruler(double x, double y, bool upwards, std::vector<SheetRectangle>& black) {
  constexpr int kMarks = 10;
  for (int i = 0; i <= kMarks; ++i) {
    const double at = i * kRuler_mm / kMarks - 0.5 * kMark_mm, length = i % kMarks == 0 ? 5 : i % 5 == 0 ? 3.5 : 2.5;
    if (upwards) {
      black.push_back({x - length, y + at, length, kMark_mm});
    } else {
      black.push_back({x + at, y, kMark_mm, length});
    }
  }
}

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.5f", value);
  std::string out = text;
  while (out.back() == '0') out.pop_back();
  if (out.back() == '.') out.pop_back();
  return out == "-0" ? "0" : out;
}

}  // namespace

tl::expected<BoardSheet, std::string> lay_out_board(const TargetBoard& board) {
  const double board_width = board.columns() * board.square_mm(), board_height = board.rows() * board.square_mm();
  const double margin = std::max(5.0, 0.5 * board.square_mm());
  const double width = std::max(board_width, kRuler_mm), height = std::max(board_height, kRuler_mm);
  const double left = kBorder_mm + kRulerStrip_mm + margin, top = std::max(kBorder_mm, margin);
  const std::string title = "Celadon board " + board.text() + ", squares of " + number(board.square_mm()) +
                            " mm: " + number(board_width) + " x " + number(board_height) + " mm";
  for (const Page& page : kPages) {
    for (const bool across : {board_width > board_height, board_width <= board_height}) {
      BoardSheet sheet;
      sheet.page = page.name;
      sheet.width_mm = across ? page.height : page.width;
      sheet.height_mm = across ? page.width : page.height;
      const auto letters = static_cast<std::size_t>((sheet.width_mm - 2 * kBorder_mm) / kLetter_mm);
      std::vector<std::string> lines{title};
      for (const std::string& line : wrapped(kAdvice, letters)) lines.push_back(line);
      const double ruler_y = top + height + margin, text_y = ruler_y + kRulerStrip_mm + kLine_mm;
      const double bottom = text_y + kLine_mm * static_cast<double>(lines.size() - 1) + kBorder_mm;
      if (left + width + margin > sheet.width_mm || bottom > sheet.height_mm) continue;
      draw_board(board, left, top, sheet.black);
      draw_ruler(left, ruler_y, false, sheet.black);
      draw_ruler(left - margin, top, true, sheet.black);
      sheet.texts.push_back({left + 2, ruler_y + 5 + BoardSheet::kText_mm, false, "100 mm along x"});
      sheet.texts.push_back({left - margin - 6, top + kRuler_mm - 2, true, "100 mm along y"});
      for (std::size_t i = 0; i < lines.size(); ++i) {
        sheet.texts.push_back({kBorder_mm, text_y + kLine_mm * static_cast<double>(i), false, lines[i]});
      }
      return sheet;
    }
  }
  return tl::unexpected("board \"" + board.text() + "\" is " + number(board_width) + " x " + number(board_height) +
                        " mm and fits on no page up to A0 (841 x 1189 mm) with its margin and rulers; take fewer or "
                        "smaller squares");
}

tl::expected<BoardSheet, std::string> lay_out_rim_tags(const std::string& text) {
  int count = 0, first = kFirstRimTag, used = 0;
  double side = 0;
  const bool read =
      std::sscanf(text.c_str(), "rim:%dx%lf%n", &count, &side, &used) == 2 &&
      (static_cast<std::size_t>(used) == text.size() ||
       (std::sscanf(text.c_str() + used, "+%d%n", &first, &used) == 1 && text.ends_with(std::to_string(first))));
  if (!read || count < 3 || first < 0 || first + count > TargetBoard::kTagFamilySize || !(side >= 2 && side <= 100)) {
    return tl::unexpected(
        "'" + text +
        "' names no tags for the platter's rim; write rim:COUNTxSIDE or "
        "rim:COUNTxSIDE+FIRST, 3 tags or more, numbers below 587, sides of 2 to 100 mm, such as rim:12x11");
  }
  const Page& page = kPages.front();
  BoardSheet sheet;
  sheet.page = page.name;
  sheet.width_mm = page.width;
  sheet.height_mm = page.height;
  // A white border of a cell and a half, a gap to cut, and the number below.
  const double pitch = side * (1 + 3. / 8) + 6, row_pitch = pitch + kLine_mm;
  const int columns = static_cast<int>((page.width - 2 * kBorder_mm) / pitch);
  const int rows = columns > 0 ? (count + columns - 1) / columns : 0;
  const double text_y = kBorder_mm + rows * row_pitch + kLine_mm;
  const auto letters = static_cast<std::size_t>((page.width - 2 * kBorder_mm) / kLetter_mm);
  const std::vector<std::string> lines = wrapped(kRimAdvice, letters);
  if (columns == 0 || text_y + kLine_mm * static_cast<double>(lines.size()) + kBorder_mm > page.height) {
    return tl::unexpected(std::to_string(count) + " tags of " + number(side) +
                          " mm fit on no A4 page; take fewer or smaller ones");
  }
  const TagFamily family(tag36h11_create(), tag36h11_destroy);
  for (int i = 0; i < count; ++i) {
    const double x = kBorder_mm + i % columns * pitch + 0.5 * (pitch - side),
                 y = kBorder_mm + i / columns * row_pitch + 0.5 * (pitch - side);
    draw_tag(*family, first + i, x, y, side, sheet.black);
    sheet.texts.push_back({x, y + side + 3. / 16 * side + 3 + kLine_mm, false, std::to_string(first + i)});
  }
  for (std::size_t i = 0; i < lines.size(); ++i) {
    sheet.texts.push_back({kBorder_mm, text_y + kLine_mm * static_cast<double>(i), false, lines[i]});
  }
  return sheet;
}

std::string svg_of(const BoardSheet& sheet) {
  const std::string width = number(sheet.width_mm), height = number(sheet.height_mm);
  std::string out = "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"" + width + "mm\" height=\"" + height +
                    "mm\" viewBox=\"0 0 " + width + " " + height + "\">\n<rect width=\"" + width + "\" height=\"" +
                    height + "\" fill=\"white\"/>\n<path fill=\"black\" fill-rule=\"evenodd\" d=\"\n";
  for (const SheetRectangle& r : sheet.black) {
    out += "M" + number(r.x) + " " + number(r.y) + "h" + number(r.width) + "v" + number(r.height) + "h" +
           number(-r.width) + "z\n";
  }
  out += "\"/>\n";
  for (const SheetText& text : sheet.texts) {
    const std::string x = number(text.x), y = number(text.y);
    out += "<text font-family=\"Helvetica, Arial, sans-serif\" font-size=\"" + number(BoardSheet::kText_mm) +
           "\" x=\"" + x + "\" y=\"" + y + "\"" +
           (text.upwards ? " transform=\"rotate(-90 " + x + " " + y + ")\"" : std::string()) + ">" + text.text +
           "</text>\n";
  }
  return out + "</svg>\n";
}

std::string pdf_of(const BoardSheet& sheet) {
  constexpr double kPoint = 72 / 25.4;  // points a millimetre
  // Millimetres, y upwards.
  std::string content = number(kPoint) + " 0 0 " + number(kPoint) + " 0 0 cm\n0 g\n";
  for (const SheetRectangle& r : sheet.black) {
    content += number(r.x) + " " + number(sheet.height_mm - r.y - r.height) + " " + number(r.width) + " " +
               number(r.height) + " re\n";
  }
  content += "f*\nBT\n/F1 " + number(BoardSheet::kText_mm) + " Tf\n";
  for (const SheetText& text : sheet.texts) {
    content +=
        (text.upwards ? "0 1 -1 0 " : "1 0 0 1 ") + number(text.x) + " " + number(sheet.height_mm - text.y) + " Tm\n(";
    for (const char c : text.text) {
      if (c == '(' || c == ')' || c == '\\') content += '\\';
      content += c;
    }
    content += ") Tj\n";
  }
  content += "ET\n";
  const std::array<std::string, 5> objects{
      "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
      "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
      "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 " + number(sheet.width_mm * kPoint) + " " +
          number(sheet.height_mm * kPoint) + "] /Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>",
      "<< /Length " + std::to_string(content.size()) + " >>\nstream\n" + content + "endstream",
      "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>"};
  std::string out = "%PDF-1.4\n";
  std::string table = "0000000000 65535 f \n";
  for (std::size_t i = 0; i < objects.size(); ++i) {
    char entry[32];
    std::snprintf(entry, sizeof entry, "%010zu 00000 n \n", out.size());
    table += entry;
    out += std::to_string(i + 1) + " 0 obj\n" + objects[i] + "\nendobj\n";
  }
  const std::string count = std::to_string(objects.size() + 1);
  const std::string start = std::to_string(out.size());
  return out + "xref\n0 " + count + "\n" + table + "trailer\n<< /Size " + count + " /Root 1 0 R >>\nstartxref\n" +
         start + "\n%%EOF\n";
}

}  // namespace celadon::cli
