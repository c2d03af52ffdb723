// errors.svg: what is drawn where.

#include "daemon/files/error_picture.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <regex>

namespace celadon {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

BaseSurface wall() {
  BaseSurface base;
  base.band_start = 10;
  base.band_end = 70;
  return base;
}

struct Field {
  double x, y, width, height;
};
// The fields of one colour.
std::vector<Field> fields_of(const std::string& svg, const std::string& colour) {
  std::smatch path;
  std::vector<Field> fields;
  if (!std::regex_search(svg, path, std::regex("<path fill=\"" + colour + "\" d=\"([^\"]*)\"/>"))) return fields;
  const std::string d = path[1];
  const std::regex rect("M([0-9.]+) ([0-9.]+)h([0-9.]+)v([0-9.]+)h-[0-9.]+z");
  for (std::sregex_iterator at(d.begin(), d.end(), rect), end; at != end; ++at)
    fields.push_back({std::stod((*at)[1]), std::stod((*at)[2]), std::stod((*at)[3]), std::stod((*at)[4])});
  return fields;
}

TEST(ErrorPicture, AFieldLiesAtItsAngleAndHeight) {
  const BaseSurface base = wall();
  ErrorMap map(base);
  map.add(base.arcs.v_of_theta(1.0), 25, 0.02);
  map.add(base.arcs.v_of_theta(5.0), 60, -0.01);
  map.add(base.arcs.v_of_theta(3.0), 40, -0.02);
  const PieceErrors piece{base, map};
  const std::string svg = error_picture(std::span(&piece, 1), "a <vase> & more", "caption");
  EXPECT_THAT(svg, HasSubstr("a &lt;vase> &amp; more"));
  EXPECT_THAT(svg, HasSubstr("+20 um"));
  EXPECT_THAT(svg, HasSubstr("-20 um"));
  EXPECT_THAT(svg, HasSubstr(">360<"));
  EXPECT_THAT(svg, HasSubstr("height, mm"));
  // The plot is 720 wide from 74, 300 high from 62.
  for (const auto& [colour, theta, z] : {std::tuple{"#b2182b", 1.0, 25.0}, std::tuple{"#8cafd2", 5.0, 60.0}}) {
    const std::vector<Field> found = fields_of(svg, colour);
    ASSERT_EQ(found.size(), 1u) << colour;
    const double x = 74 + 720 * theta / 6.283185307, y = 62 + 300 * (70 - z) / 60;
    EXPECT_LE(found[0].x, x);
    EXPECT_GE(found[0].x + found[0].width, x);
    EXPECT_LE(found[0].y, y + 0.01);
    EXPECT_GE(found[0].y + found[0].height, y - 0.01);
  }
}

TEST(ErrorPicture, PiecesStandAboveEachOther) {
  const BaseSurface base = wall();
  BaseSurface dome;
  dome.kind = BaseKind::sphere;
  dome.band_end = 1;
  ErrorMap of_wall(base), of_dome(dome);
  of_wall.add(0.5, 20, 0.001);
  of_dome.add(0.5, 0.1, -0.001);
  const PieceErrors pieces[] = {{base, of_wall}, {dome, of_dome}};
  const std::string svg = error_picture(pieces, "bullet", "");
  EXPECT_LT(svg.find("polar angle"), svg.find("height, mm"));
  EXPECT_THAT(svg, HasSubstr("+1 um"));
  EXPECT_EQ(svg, error_picture(pieces, "bullet", ""));
}

TEST(ErrorPicture, WithoutSamplesAllIsGrey) {
  const BaseSurface base = wall();
  const ErrorMap map(base);
  const PieceErrors piece{base, map};
  const std::string svg = error_picture(std::span(&piece, 1), "", "");
  EXPECT_EQ(fields_of(svg, "#d9d9d9").size(), static_cast<std::size_t>(ErrorMap::kAlong));
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
}

}  // namespace
}  // namespace celadon
