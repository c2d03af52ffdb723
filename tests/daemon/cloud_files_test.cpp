// Readers of clouds: files made by hand, round trips through independent writers, hostile files, seeded mutations.

#include "daemon/files/cloud_files.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <random>

#include "daemon/files/polar.h"
#include "tests/daemon/cloud_writers.h"
#include "tests/memory_file.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using namespace std::string_literals;
using ::testing::AllOf;
using testing::Column;
using ::testing::HasSubstr;
using testing::PcdKind;
using testing::PlyKind;
using testing::PlyShape;
using testing::Points;

using std::numbers::pi;

/// A whole pass.
struct Read {
  Points points;  ///< x, y, z in the scanner frame
  std::uint64_t skipped = 0;
  std::string error;
};

Read read_all(CloudFile& cloud) {
  Read read;
  std::optional<std::uint32_t> index;
  while (const Profile* profile = cloud.next()) {
    EXPECT_EQ(profile->index, index.value_or(profile->index));
    index = profile->index + 1;
    EXPECT_EQ(profile->order, ProfileOrder::scattered);
    EXPECT_EQ(profile->r_mm.size(), profile->theta_rad.size());
    EXPECT_EQ(profile->r_mm.size(), profile->z_mm.size());
    for (std::size_t i = 0; i < profile->size(); ++i) {
      read.points.push_back({profile->r_mm[i] * std::cos(profile->theta_rad[i]),
                             profile->r_mm[i] * std::sin(profile->theta_rad[i]), profile->z_mm[i]});
    }
  }
  read.skipped = cloud.skipped();
  read.error = cloud.error();
  return read;
}

class Clouds : public ::testing::Test {
 protected:
  std::unique_ptr<CloudFile> open(std::string_view bytes, const CloudOptions& options = {}) {
    auto cloud = open_cloud(scratch_.write("cloud", bytes), options);
    if (!cloud) {
      throw std::runtime_error(cloud.error().message);
    }
    return std::move(*cloud);
  }
  Read read(std::string_view bytes, const CloudOptions& options = {}) { return read_all(*open(bytes, options)); }
  /// The sentence of whichever of opening and reading fails.
  std::string refusal(std::string_view bytes) {
    const auto cloud = open_cloud(scratch_.write("cloud", bytes), {});
    return cloud ? read_all(**cloud).error : cloud.error().message;
  }
  testing::TemporaryFolder scratch_;
};

void expect_near(const Points& got, const Points& expected, double tolerance) {
  ASSERT_EQ(got.size(), expected.size());
  for (std::size_t i = 0; i < got.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      ASSERT_NEAR(got[i][k], expected[i][k], tolerance) << "point " << i;
    }
  }
}

const Points three = {{3, 4, 5}, {-1, 0, 2}, {0, -2, -7}};

// By hand: every byte from the formats' descriptions.

TEST_F(Clouds, PlyAsciiByHand) {
  const Read got = read(
      "ply\nformat ascii 1.0\ncomment x y z 9 9 9\nelement vertex 3\nproperty uchar red\nproperty float z\n"
      "property float x\nproperty float y\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
      "255 5 3 4\n0 2 -1 0\n  12\t-7.0e0 +0 -2\n3 0 1 2\n");
  expect_near(got.points, three, 1e-15);
  EXPECT_EQ(got.error, "");
}

TEST_F(Clouds, PlyBigEndianByHand) {
  const Read got = read(
      "ply\r\nformat binary_big_endian 1.0\r\nelement vertex 1\r\nproperty short x\r\nproperty float y\r\n"
      "property double z\r\nend_header\r\n"
      "\x01\x02"                             // 258
      "\xC0\x20\x00\x00"                     // -2.5
      "\x40\x59\x00\x00\x00\x00\x00\x00"s);  // 100
  expect_near(got.points, {{258, -2.5, 100}}, 1e-12);
}

TEST_F(Clouds, PcdCompressedByHand) {
  // Four points, all coordinates bytes: x = 7 7 7 7, y = 1 2 3 4, z = 7 7 7 7 again.
  const Read got = read(
      "VERSION .7\nFIELDS x y z\nSIZE 1 1 1\nTYPE U U U\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 2\nPOINTS 4\n"
      "DATA binary_compressed\n"
      "\x0B\x00\x00\x00\x0C\x00\x00\x00"
      "\x00\x07"              // one literal, 7
      "\x20\x00"              // copy 3 from 1 back
      "\x03\x01\x02\x03\x04"  // four literals
      "\x40\x07"s);           // copy 4 from 8 back
  expect_near(got.points, {{7, 1, 7}, {7, 2, 7}, {7, 3, 7}, {7, 4, 7}}, 1e-13);
  EXPECT_EQ(got.error, "");
}

struct TextCase {
  const char* name;
  std::string text;
};
class TextClouds : public Clouds, public ::testing::WithParamInterface<TextCase> {};

TEST_P(TextClouds, GivesTheThreePoints) {
  const Read got = read(GetParam().text);
  expect_near(got.points, three, 1e-15);
  EXPECT_EQ(got.error, "");
  EXPECT_EQ(got.skipped, 0U);
}

INSTANTIATE_TEST_SUITE_P(
    All, TextClouds,
    ::testing::Values(TextCase{"blanks", "3 4 5\n-1 0 2\n0 -2 -7\n"},
                      TextCase{"no_last_line_feed", "3 4 5\n-1 0 2\n0 -2 -7"},
                      TextCase{"many_blanks_and_tabs", "   3\t 4   5  \n-1 0\t2\n\t0 -2 -7\n"},
                      TextCase{"commas", "3,4,5\n-1,0,2\n0,-2,-7\n"},
                      TextCase{"commas_and_blanks", "3, 4, 5\n-1 ,0, 2\n0, -2 , -7\n"},
                      TextCase{"semicolons", "3;4;5\n-1;0;2\n0;-2;-7\n"},
                      TextCase{"carriage_returns", "3,4,5\r\n-1,0,2\r\n0,-2,-7\r\n"},
                      TextCase{"header", "X,Y,Z\n3,4,5\n-1,0,2\n0,-2,-7\n"},
                      TextCase{"quoted_header", "\"x\";\"y\";\"z\"\n3;4;5\n-1;0;2\n0;-2;-7\n"},
                      TextCase{"header_in_another_order", "intensity,z,x,y\n9,5,3,4\n9,2,-1,0\n9,-7,0,-2\n"},
                      TextCase{"header_of_other_names", "East North Height\n3 4 5\n-1 0 2\n0 -2 -7\n"},
                      TextCase{"commented_header", "# z x y\n5 3 4\n2 -1 0\n-7 0 -2\n"},
                      TextCase{"extra_columns", "3 4 5 255 word\n-1 0 2 nan\n0 -2 -7\n"},
                      TextCase{"comments_and_empty_lines", "# a cloud\n\n3 4 5\n   \n  # more\n-1 0 2\n\n0 -2 -7\n#"},
                      TextCase{"byte_order_mark",
                               "\xEF\xBB\xBF"
                               "3 4 5\n-1 0 2\n0 -2 -7\n"},
                      TextCase{"exponents", "3E0 .4e1 +500e-2\n-1.0 0e9 2.\n-0 -2 -7\n"}),
    [](const auto& tested) { return std::string(tested.param.name); });

TEST_F(Clouds, NativeSamplesKeepTheirAngles) {
  const auto cloud = open("r,theta,z\n40,0.25,-3\n41.5,-7.5,100\n1,12.0,0\n");
  EXPECT_EQ(cloud->columns(), CloudColumns::cylindrical);
  const Profile* profile = cloud->next();
  ASSERT_NE(profile, nullptr);
  EXPECT_EQ(profile->r_mm, (std::vector<double>{40, 41.5, 1}));
  EXPECT_EQ(profile->theta_rad, (std::vector<double>{0.25, -7.5, 12}));
  EXPECT_EQ(profile->z_mm, (std::vector<double>{-3, 100, 0}));
}

TEST_F(Clouds, SphericalSamplesAreAboutTheOrigin) {
  CloudOptions options;
  options.millimetres_per_unit = 10;
  const auto cloud = open("theta,rho,phi\n0.5,2,0.25\n-1,3,3\n", options);
  EXPECT_EQ(cloud->columns(), CloudColumns::spherical);
  const Profile* profile = cloud->next();
  ASSERT_NE(profile, nullptr);
  EXPECT_EQ(profile->theta_rad, (std::vector<double>{0.5, -1}));
  EXPECT_NEAR(profile->r_mm[0], 20 * std::sin(0.25), 1e-14);
  EXPECT_NEAR(profile->z_mm[0], 20 * std::cos(0.25), 1e-14);
  EXPECT_NEAR(profile->r_mm[1], 30 * std::sin(3), 1e-14);
  EXPECT_NEAR(profile->z_mm[1], 30 * std::cos(3), 1e-14);
}

TEST_F(Clouds, NativeLengthsHaveAUnitAnglesHaveNot) {
  CloudOptions options;
  options.millimetres_per_unit = 10;
  const auto cloud = open("# theta;z;r\n0.5;2;3\n", options);
  EXPECT_EQ(cloud->columns(), CloudColumns::cylindrical);
  const Profile* profile = cloud->next();
  ASSERT_NE(profile, nullptr);
  EXPECT_EQ(profile->r_mm[0], 30);
  EXPECT_EQ(profile->theta_rad[0], 0.5);
  EXPECT_EQ(profile->z_mm[0], 20);
}

TEST_F(Clouds, AxesPermuteCyclicallyAndStayRightHanded) {
  for (const Axis axis : {Axis::x, Axis::y, Axis::z}) {
    CloudOptions options;
    options.axis = axis;
    options.millimetres_per_unit = 25.4;
    const Points p = read("1 0 0\n0 1 0\n0 0 1\n", options).points;
    ASSERT_EQ(p.size(), 3U);
    // The chosen axis comes out as z.
    EXPECT_NEAR(p[static_cast<std::size_t>(axis)][2], 25.4, 1e-12);
    const double determinant = p[0][0] * (p[1][1] * p[2][2] - p[1][2] * p[2][1]) -
                               p[0][1] * (p[1][0] * p[2][2] - p[1][2] * p[2][0]) +
                               p[0][2] * (p[1][0] * p[2][1] - p[1][1] * p[2][0]);
    EXPECT_NEAR(determinant, 25.4 * 25.4 * 25.4, 1e-8);
  }
}

TEST_F(Clouds, UnitsAreKnownByName) {
  EXPECT_EQ(millimetres_per_unit("mm").value(), 1);
  EXPECT_EQ(millimetres_per_unit("cm").value(), 10);
  EXPECT_EQ(millimetres_per_unit("m").value(), 1000);
  EXPECT_EQ(millimetres_per_unit("in").value(), 25.4);
  EXPECT_EQ(millimetres_per_unit("um").value(), 0.001);
  EXPECT_THAT(millimetres_per_unit("furlong").error(), HasSubstr("\"furlong\""));
}

TEST_F(Clouds, NanAndInfinityAreSkippedAndCounted) {
  const Read text = read("1 2 3\nnan 1 1\n1 -inf 1\n1 1 Infinity\n1 1 1e999\n-NaN 0 0\n1.#QNAN 0 0\n4 5 6\n");
  expect_near(text.points, {{1, 2, 3}, {4, 5, 6}}, 1e-15);
  EXPECT_EQ(text.skipped, 6U);
  EXPECT_EQ(text.error, "");

  const double inf = std::numeric_limits<double>::infinity();
  const Points holed = {{1, 2, 3}, {std::nan(""), 0, 0}, {0, inf, 0}, {0, 0, -inf}, {4, 5, 6}};
  for (const std::string& bytes :
       {testing::ply(holed, {}), testing::pcd(holed, PcdKind::compressed, {{"x"}, {"y"}, {"z"}}),
        testing::pcd(holed, PcdKind::ascii, {{"x"}, {"y"}, {"z"}})}) {
    const Read binary = read(bytes);
    expect_near(binary.points, {{1, 2, 3}, {4, 5, 6}}, 1e-6);
    EXPECT_EQ(binary.skipped, 3U);
  }
}

TEST_F(Clouds, PiecesOfNanAloneDoNotEndThePass) {
  std::string text;
  for (int i = 0; i < 100; ++i) {
    text += i % 10 == 9 ? "1 2 3\n" : "nan nan nan\n";
  }
  CloudOptions options;
  options.samples_per_profile = 3;
  const Read got = read(text, options);
  EXPECT_EQ(got.points.size(), 10U);
  EXPECT_EQ(got.skipped, 90U);
}

TEST_F(Clouds, PointsOnTheAxisHaveRangeZero) {
  const auto cloud = open("0 0 5\n-0 0 6\n");
  const Profile* profile = cloud->next();
  ASSERT_NE(profile, nullptr);
  EXPECT_EQ(profile->r_mm, (std::vector<double>{0, 0}));
  EXPECT_EQ(profile->theta_rad, (std::vector<double>{0, 0}));
}

// Round trips.

Points random_points(std::size_t count, int seed, bool integers) {
  std::mt19937 engine(static_cast<unsigned>(seed));
  std::uniform_real_distribution<double> real(-120, 120);
  Points points(count);
  for (auto& point : points) {
    for (double& value : point) {
      value = integers ? std::floor(std::abs(real(engine))) : real(engine);
    }
  }
  return points;
}

TEST_F(Clouds, EveryPlyComesBack) {
  const std::vector<std::vector<Column>> layouts = {
      {{"x"}, {"y"}, {"z"}},
      {{"x", 'f', 8}, {"y", 'f', 8}, {"z", 'f', 8}},
      {{"nx"}, {"z", 'f', 8}, {"red", 'u', 1}, {"y"}, {"x", 'f', 8}, {"label", 'i', 2}},
      {{"z", 'u', 1}, {"y", 'i', 2}, {"x", 'u', 4}, {"pad", 'f', 8}}};
  for (std::size_t layout = 0; layout < layouts.size(); ++layout) {
    const Points points = random_points(10000, 1, layout == 3);
    for (const PlyKind kind : {PlyKind::ascii, PlyKind::little_endian, PlyKind::big_endian}) {
      for (const bool lists : {false, true}) {
        PlyShape shape{kind, layouts[layout], lists, true, lists};
        CloudOptions options;
        options.samples_per_profile = 777;
        const auto cloud = open(testing::ply(points, shape), options);
        EXPECT_EQ(cloud->points(), points.size());
        const Read got = read_all(*cloud);
        EXPECT_EQ(got.error, "");
        expect_near(got.points, points, layout == 1 ? 1e-12 : 1e-5);
      }
    }
  }
}

TEST_F(Clouds, EveryPcdComesBack) {
  const std::vector<std::vector<Column>> layouts = {
      {{"x"}, {"y"}, {"z"}},
      {{"filler", 'f', 8}, {"z", 'f', 8}, {"rgb", 'u', 4}, {"x", 'f', 8}, {"filler", 'i', 2}, {"y", 'f', 8}},
      {{"y", 'u', 1}, {"x", 'i', 8}, {"filler", 'u', 1}, {"z", 'u', 2}}};
  for (std::size_t layout = 0; layout < layouts.size(); ++layout) {
    const Points points = random_points(900, 2, layout == 2);
    for (const PcdKind kind : {PcdKind::ascii, PcdKind::binary, PcdKind::compressed}) {
      const auto cloud = open(testing::pcd(points, kind, layouts[layout]));
      EXPECT_EQ(cloud->points(), points.size());
      const Read got = read_all(*cloud);
      EXPECT_EQ(got.error, "");
      expect_near(got.points, points, layout == 1 ? 1e-12 : 1e-5);
    }
  }
}

TEST_F(Clouds, CompressedColumnsOfManyKilobytesComeBack) {
  // Smooth columns compress well, copies reach back across every buffer's end.
  Points points(60000);
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i] = {static_cast<double>(i % 251), static_cast<double>(i / 500 % 7), static_cast<double>((i * i) % 97)};
  }
  const Read got = read(testing::pcd(points, PcdKind::compressed, {{"x"}, {"y"}, {"z"}}));
  EXPECT_EQ(got.error, "");
  expect_near(got.points, points, 1e-10);
}

TEST_F(Clouds, RewindGivesTheSameAgain) {
  const Points points = random_points(900, 3, false);
  PlyShape lists;
  lists.with_list = true;
  PlyShape ascii;
  ascii.kind = PlyKind::ascii;
  for (const std::string& bytes :
       {testing::ply(points, {}), testing::ply(points, lists), testing::ply(points, ascii),
        testing::pcd(points, PcdKind::compressed, {{"z"}, {"y"}, {"x"}}), "# only text\n1 2 3\nnan 0 0\n4 5 6\n"s}) {
    CloudOptions options;
    options.samples_per_profile = 100;
    const auto cloud = open(bytes, options);
    cloud->next();
    cloud->rewind();
    const Read first = read_all(*cloud);
    const std::uint64_t counted = cloud->points();
    EXPECT_EQ(counted, first.points.size() + first.skipped);
    cloud->rewind();
    EXPECT_EQ(cloud->points(), counted);
    const Read second = read_all(*cloud);
    EXPECT_EQ(first.points, second.points);
    EXPECT_EQ(first.skipped, second.skipped);
    EXPECT_EQ(first.error, second.error);
  }
}

TEST_F(Clouds, PiecesHaveTheWantedSize) {
  std::string text;
  for (int i = 0; i < 100; ++i) {
    text += "1 2 3\n";
  }
  CloudOptions options;
  options.samples_per_profile = 30;
  const auto cloud = open(text, options);
  std::vector<std::size_t> sizes;
  while (const Profile* profile = cloud->next()) {
    sizes.push_back(profile->size());
  }
  EXPECT_EQ(sizes, (std::vector<std::size_t>{30, 30, 30, 10}));
}

TEST_F(Clouds, MemoryDoesNotGrowWithTheFile) {
  const auto peak_kb = [] {
    rusage usage{};
    ::getrusage(RUSAGE_SELF, &usage);
    return usage.ru_maxrss;
  };
  // 48 MB of zeros as vertices, written sparse.
  const auto path = scratch_.write("large.ply",
                                   "ply\nformat binary_little_endian 1.0\nelement vertex 4000000\nproperty float x\n"
                                   "property float y\nproperty float z\nend_header\n");
  const auto header = std::filesystem::file_size(path);
  std::filesystem::resize_file(path, header + 48000000);
  const auto before = peak_kb();
  const auto cloud = open_cloud(path, {});
  ASSERT_TRUE(cloud);
  std::size_t count = 0;
  while (const Profile* profile = (*cloud)->next()) {
    count += profile->size();
  }
  EXPECT_EQ(count, 4000000U);
#ifndef __SANITIZE_ADDRESS__
  EXPECT_LT(peak_kb() - before, 8000);
#endif
}

// What is refused, and how it is said.

struct Hostile {
  const char* name;
  std::string bytes;
  std::vector<const char*> says;
};
class HostileClouds : public Clouds, public ::testing::WithParamInterface<Hostile> {};

TEST_P(HostileClouds, AreNamedInOneSentence) {
  const std::string sentence = refusal(GetParam().bytes);
  EXPECT_THAT(sentence, HasSubstr((scratch_.path() / "cloud").string()));
  for (const char* part : GetParam().says) {
    EXPECT_THAT(sentence, HasSubstr(part));
  }
  EXPECT_EQ(sentence.find('\n'), std::string::npos);
}

std::string ply_header(const std::string& format, const std::string& vertices) {
  return "ply\nformat " + format + " 1.0\nelement vertex " + vertices +
         "\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
}
std::string pcd_header(const std::string& width, const std::string& height, const std::string& points,
                       const std::string& data) {
  return "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH " + width + "\nHEIGHT " + height + "\nPOINTS " +
         points + "\nDATA " + data + "\n";
}
const std::string twelve(12, '\0');

INSTANTIATE_TEST_SUITE_P(
    All, HostileClouds,
    ::testing::Values(
        Hostile{"empty", "", {"is empty (0 bytes)"}},
        Hostile{"ply_of_10_to_the_12",
                ply_header("binary_little_endian", "1000000000000") + twelve,
                {"promises 1 000 000 000 000 records", "12 bytes from byte 127", "ends at byte 139", "record 1"}},
        Hostile{"ply_of_2_to_the_64", ply_header("binary_little_endian", "18446744073709551615"), {"promises 18 446"}},
        Hostile{"ply_beyond_2_to_the_64", ply_header("ascii", "99999999999999999999"), {"not a number of elements"}},
        Hostile{"ply_of_minus_one", ply_header("ascii", "-1"), {"\"-1\" is not a number of elements"}},
        Hostile{"ply_ascii_of_10_to_the_12", ply_header("ascii", "1000000000000") + "1 2 3\n", {"1 000 000 000 000"}},
        Hostile{
            "ply_truncated", ply_header("binary_big_endian", "2") + twelve + "12345", {"ends at byte 129", "record 1"}},
        Hostile{"ply_ascii_truncated",
                ply_header("ascii", "3") + "1.00000 2.000000 3.000000\n4 5 6\n",
                {"line 10", "ends after 2 points", "promises 3"}},
        Hostile{"ply_without_end", "ply\nformat ascii 1.0\nelement vertex 3\n", {"without \"end_header\"", "byte 38"}},
        Hostile{"ply_without_format", "ply\nelement vertex 1\nend_header\n", {"without a format"}},
        Hostile{
            "ply_of_another_format", "ply\nformat binary_middle_endian 1.0\nend_header\n", {"binary_middle_endian"}},
        Hostile{"ply_of_another_type", "ply\nformat ascii 1.0\nelement vertex 1\nproperty real x\n", {"\"real\""}},
        Hostile{"ply_without_z",
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n",
                {"without a property z"}},
        Hostile{
            "ply_with_z_a_list",
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty list uchar float "
            "z\nend_header\n1 2 1 3\n",
            {"without a property z"}},
        Hostile{"ply_without_vertices",
                "ply\nformat ascii 1.0\nelement face 1\nproperty char a\nend_header\n1\n",
                {"without an element \"vertex\""}},
        Hostile{"ply_of_no_vertices", ply_header("ascii", "0"), {"0 vertices"}},
        Hostile{
            "ply_property_before_element", "ply\nformat ascii 1.0\nproperty float x\n", {"line 3", "not understood"}},
        Hostile{"ply_with_endless_list",
                "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty list uint double w\nproperty float "
                "x\nproperty float y\nproperty float z\nend_header\n\xff\xff\xff\xff" +
                    twelve,
                {"ends inside vertex 0", "starts at byte"}},
        Hostile{"ply_with_negative_list",
                "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty list int double w\nproperty float "
                "x\nproperty float y\nproperty float z\nend_header\n\xfe\xff\xff\xff" +
                    twelve,
                {"ends inside vertex 0"}},
        Hostile{"ply_with_nan_list_in_front",
                "ply\nformat binary_little_endian 1.0\nelement a 1\nproperty list float double w\nelement vertex "
                "1\nproperty float x\nproperty float y\nproperty float z\nend_header\n\xff\xff\xff\xff" +
                    twelve,
                {"ends inside its element \"a\""}},
        Hostile{"pcd_of_10_to_the_12",
                pcd_header("1000000000000", "1", "1000000000000", "binary") + twelve,
                {"promises 1 000 000 000 000"}},
        Hostile{"pcd_ascii_of_10_to_the_12",
                pcd_header("1000000000000", "1", "1000000000000", "ascii") + "1 2 3\n",
                {"promises 1 000 000 000 000"}},
        Hostile{"pcd_of_product_beyond_2_to_the_64",
                pcd_header("5000000000", "5000000000", "1", "binary") + twelve,
                {"more than any file holds"}},
        Hostile{"pcd_contradicts_itself",
                pcd_header("3", "2", "5", "ascii") + "1 2 3\n",
                {"contradicts itself: POINTS 5, but WIDTH x HEIGHT 6"}},
        Hostile{"pcd_truncated", pcd_header("2", "1", "2", "binary") + twelve, {"ends at byte"}},
        Hostile{"pcd_of_nothing", pcd_header("0", "1", "0", "ascii"), {"holds 0 points"}},
        Hostile{"pcd_without_data", "# .PCD v.7\nFIELDS x y z\n", {"without a line DATA"}},
        Hostile{"pcd_of_other_data", pcd_header("1", "1", "1", "zipped") + twelve, {"\"zipped\""}},
        Hostile{
            "pcd_without_y", "FIELDS x z\nSIZE 4 4\nTYPE F F\nCOUNT 1 1\nPOINTS 1\nDATA ascii\n1 2\n", {"no field y"}},
        Hostile{"pcd_with_odd_size",
                "FIELDS x y z\nSIZE 3 4 4\nTYPE F F F\nPOINTS 1\nDATA binary\n" + twelve,
                {"field x of SIZE 3"}},
        Hostile{"pcd_with_short_size",
                "FIELDS x y z\nSIZE 4 4\nTYPE F F F\nPOINTS 1\nDATA binary\n" + twelve,
                {"SIZE has 2 entries for 3 fields"}},
        Hostile{"pcd_with_huge_count",
                "FIELDS x y z w\nSIZE 4 4 4 8\nTYPE F F F F\nCOUNT 1 1 1 99999999999\nPOINTS 1\n",
                {"\"99999999999\" is not within"}},
        Hostile{"pcd_block_beyond_the_end",
                pcd_header("1", "1", "1", "binary_compressed") + "\xff\xff\xff\x0f\x0c\0\0\0"s + twelve,
                {"compressed block of 268 435 455 bytes"}},
        Hostile{"pcd_block_without_sizes",
                pcd_header("1", "1", "1", "binary_compressed") + "\1\0"s,
                {"before its compressed block"}},
        Hostile{"pcd_block_of_another_size",
                pcd_header("1", "1", "1", "binary_compressed") + "\2\0\0\0\x0d\0\0\0\0a"s,
                {"stands for 13 bytes"}},
        Hostile{"pcd_copy_from_before",
                pcd_header("1", "1", "1", "binary_compressed") + "\4\0\0\0\x0c\0\0\0\0a\x20\5"s,
                {"from before the start"}},
        Hostile{"pcd_block_too_short",
                pcd_header("1", "1", "1", "binary_compressed") + "\2\0\0\0\x0c\0\0\0\0a"s,
                {"ends too early"}},
        Hostile{"pcd_block_too_long",
                pcd_header("1", "1", "1", "binary_compressed") + "\x0f\0\0\0\x0c\0\0\0\x0b"s + twelve + "\0a"s,
                {"goes on after the last point"}},
        Hostile{"garbage_line", "1 2 3\n4 5 6\n7 eight 9\n", {"line 3", "\"eight\" is not a number (column 2, y)"}},
        Hostile{"short_line", "1,2,3\n4,5\n", {"line 2", "has 2 values, 3 are needed"}},
        Hostile{"empty_field", "1,2,3\n4,,6\n", {"line 2", "\"\" is not a number"}},
        Hostile{"decimal_commas", "1,5 2,5 3,5\n", {"line 1"}},
        Hostile{"half_a_number", "1 2 3\n1 2 3mm\n", {"line 2", "\"3mm\""}},
        Hostile{"native_garbage", "r,theta,z\n1,2,3\n1,x,3\n", {"line 3", "(column 2, theta)"}},
        Hostile{"words", "this is a letter\nto nobody\n", {"line 2"}},
        Hostile{"one_word", "hello\n", {"line 1", "neither a header"}},
        Hostile{"header_alone", "x,y,z\n# nothing\n", {"holds no points"}},
        Hostile{"comments_alone", "# nothing\n\n", {"holds no points"}},
        Hostile{"binary_noise", "\x01\x00\x02 whatever\n"s, {"this is not text"}},
        Hostile{"endless_line", std::string(300000, '1'), {"this is not text"}},
        Hostile{"endless_line_later",
                "1 2 3\n" + std::string(600000, '1') + "\n1 2 3\n",
                {"line 2", "longer than any record"}},
        Hostile{"gzip", "\x1f\x8b\x08 etc", {"gzip"}}, Hostile{"zip", "PK\x03\x04 etc", {"zip archive"}},
        Hostile{"utf_16",
                "\xff\xfe"
                "1\0 \0"s,
                {"UTF-16"}},
        Hostile{"step", "ISO-10303-21;\nHEADER;\n", {"STEP"}}, Hostile{"stl", "solid vase\nfacet normal\n", {"STL"}}),
    [](const auto& tested) { return std::string(tested.param.name); });

TEST_F(Clouds, RecordsBeforeABrokenOneAreDelivered) {
  const Read got = read("1 2 3\n4 5 6\nseven\n7 8 9\n");
  EXPECT_EQ(got.points.size(), 2U);
  EXPECT_THAT(got.error, HasSubstr("line 3"));
}

TEST_F(Clouds, SystemErrorsNameTheFileAndTheRemedy) {
  const auto message = [](const std::filesystem::path& path) {
    const auto cloud = open_cloud(path, {});
    return cloud ? "opened"s : cloud.error().message;
  };
  EXPECT_THAT(message(scratch_.path() / "none.ply"), HasSubstr("none.ply: No such file or directory; check the name"));
  EXPECT_THAT(message(scratch_.path()), HasSubstr("Is a directory; name a file, not a folder"));
  EXPECT_THAT(message("/dev/null"), HasSubstr("pipe or device"));
  const auto pipe = scratch_.path() / "pipe";
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);
  EXPECT_THAT(message(pipe), HasSubstr("pipe or device"));
  const auto loop = scratch_.path() / "loop";
  std::filesystem::create_symlink(loop, loop);
  EXPECT_THAT(message(loop), HasSubstr("in a circle"));
}

TEST_F(Clouds, AFileThatShrinksWhileReadIsNamed) {
  const auto path = scratch_.write("cloud", testing::ply(random_points(100000, 4, false), {}));
  const auto cloud = open_cloud(path, {});
  ASSERT_TRUE(cloud);
  (*cloud)->next();
  std::filesystem::resize_file(path, 600000);
  const Read got = read_all(**cloud);
  EXPECT_LT(got.points.size(), 100000U);
  EXPECT_THAT(got.error, AllOf(HasSubstr("became shorter"), HasSubstr("600 000")));
}

/// Bytes changed, cut, doubled and inserted in valid files of every kind: never a crash, never more points than there
/// are bytes, and silence only if all that was promised came.
TEST_F(Clouds, MutatedFilesNeverCrashOrLie) {
  const Points points = random_points(60, 5, true);
  std::vector<std::string> originals;
  for (const PlyKind kind : {PlyKind::ascii, PlyKind::little_endian, PlyKind::big_endian}) {
    originals.push_back(testing::ply(points, {kind, {{"x"}, {"y"}, {"z"}}, false, true, false}));
    originals.push_back(testing::ply(points, {kind, {{"x"}, {"y", 'i', 2}, {"z", 'f', 8}}, true, true, true}));
  }
  for (const PcdKind kind : {PcdKind::ascii, PcdKind::binary, PcdKind::compressed}) {
    originals.push_back(testing::pcd(points, kind, {{"filler", 'u', 1}, {"x"}, {"y", 'f', 8}, {"z", 'u', 2}}));
  }
  originals.push_back("# x y z\n1 2 3\n4 5 6\n7 8 9\n");
  originals.push_back("r,theta,z\r\n1,2,3\r\n4,5,6\r\n");
  std::mt19937 engine(20260101);
  const auto below = [&](std::size_t n) { return std::uniform_int_distribution<std::size_t>(0, n - 1)(engine); };
  const std::string favourites = "0123456789-+.,; \n#eE\xff\x80\x00\x20\x1f"s;
  for (int round = 0; round < 12000; ++round) {
    std::string bytes = originals[static_cast<std::size_t>(round) % originals.size()];
    for (std::size_t change = below(4) + 1; change > 0 && !bytes.empty(); --change) {
      const std::size_t at = below(bytes.size());
      switch (below(5)) {
        case 0:
          bytes[at] = static_cast<char>(below(256));
          break;
        case 1:
          bytes[at] = favourites[below(favourites.size())];
          break;
        case 2:
          bytes.resize(at);
          break;
        case 3:
          bytes.insert(at, 1, favourites[below(favourites.size())]);
          break;
        default:
          bytes.insert(at, bytes.substr(below(bytes.size()), below(40)));
      }
    }
    const testing::MemoryFile mutant(bytes);
    const auto cloud = open_cloud(mutant.path(), {});
    if (!cloud) {
      EXPECT_FALSE(cloud.error().message.empty());
      continue;
    }
    std::uint64_t count = 0;
    while (const Profile* profile = (*cloud)->next()) {
      count += profile->size();
    }
    ASSERT_LE(count, 88 * bytes.size());
    if ((*cloud)->error().empty()) {
      ASSERT_EQ((*cloud)->points(), count + (*cloud)->skipped()) << "round " << round;
    }
  }
}

TEST(Polar, AgreesWithTheLibrarysArctangent) {
  std::mt19937_64 engine(7);
  std::uniform_real_distribution<double> exponent(-12, 12);
  std::uniform_real_distribution<double> turn(0, 2 * pi);
  std::vector<double> x;
  std::vector<double> y;
  for (int i = 0; i < 200000; ++i) {
    const double size = std::pow(10, exponent(engine));
    const double angle = turn(engine);
    x.push_back(size * std::cos(angle));
    y.push_back(size * std::sin(angle));
  }
  for (int i = 0; i < 64; ++i) {
    x.push_back(std::cos(i * pi / 32));
    y.push_back(std::sin(i * pi / 32));
  }
  for (const double a : {0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 1e150}) {
    for (const double b : {0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 1e150}) {
      x.push_back(a);
      y.push_back(b);
    }
  }
  std::vector<double> r(x.size());
  std::vector<double> theta(x.size());
  to_polar(x.data(), y.data(), x.size(), r.data(), theta.data());
  for (std::size_t i = 0; i < x.size(); ++i) {
    double expected = x[i] == 0 && y[i] == 0 ? 0 : std::atan2(y[i], x[i]);
    expected += expected < 0 ? 2 * pi : 0;
    const double off = std::abs(theta[i] - expected);
    ASSERT_LT(std::min(off, 2 * pi - off), 1.8e-15) << x[i] << " " << y[i];
    ASSERT_GE(theta[i], 0);
    ASSERT_LT(theta[i], 2 * pi);
    if (std::hypot(x[i], y[i]) > 1e-100) {
      ASSERT_NEAR(r[i] / std::hypot(x[i], y[i]), 1, 5e-16);
    }
  }
}

// Parts hold every point once, in order; small files, text and records of many sizes come as one.
TEST(CloudParts, AreTheWholeFileInOrder) {
  constexpr std::size_t kPoints = (1U << 20) + 5;
  std::string bytes = "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(kPoints) +
                      "\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
  for (std::size_t k = 0; k < kPoints; ++k) {
    const float p[] = {1, 0, static_cast<float>(k)};
    bytes.append(reinterpret_cast<const char*>(p), sizeof p);
  }
  testing::TemporaryFolder folder;
  const auto parts = open_cloud_parts(folder.write("large.ply", bytes), {});
  ASSERT_TRUE(parts) << parts.error().message;
  ASSERT_EQ(parts->size(), 4u);
  for (int pass = 0; pass < 2; ++pass) {
    std::size_t expected = 0;
    for (const auto& part : *parts) {
      part->rewind();
      while (const Profile* profile = part->next())
        for (const double z : profile->z_mm) ASSERT_EQ(z, static_cast<double>(expected++));
      EXPECT_EQ(part->error(), "");
    }
    EXPECT_EQ(expected, kPoints);
  }
  const auto small = open_cloud_parts(folder.write("small.xyz", "1 0 0\n1 0 1\n"), {});
  ASSERT_TRUE(small);
  EXPECT_EQ(small->size(), 1u);
  EXPECT_FALSE(open_cloud_parts(folder / "missing.ply", {}));
}

}  // namespace
}  // namespace celadon
