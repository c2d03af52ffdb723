// Parts against a file written by hand from their grammar, against damage of every kind, and against the samples.

#include "daemon/partial_sums.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>

#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
using testing::TemporaryFolder;

const unsigned char kGolden[] = {
#include "tests/daemon/partial_sums_golden.inc"
};

std::string golden() {
  return {reinterpret_cast<const char*>(kGolden), sizeof kGolden};
}

struct Point {
  double r, theta, z;
};

std::vector<Point> random_points(std::size_t n, unsigned seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> share(0, 1);
  std::vector<Point> points(n);
  for (Point& p : points) p = {30 + 3 * share(random), 2 * std::numbers::pi * share(random), -2 + 84 * share(random)};
  return points;
}

SumsGrid small_grid() {
  SumsGrid grid;
  grid.cells = {.z_start_mm = 0, .z_end_mm = 80, .z_intervals = 8, .intervals_per_arc = 4};
  return grid;
}

PartialSums part_of(std::span<const Point> points, const SumsGrid& grid, const std::string& input = "a.xyz") {
  MomentGrid sums(grid.cells);
  FirstLook look(sums);
  Profile profile;
  profile.order = ProfileOrder::scattered;
  for (const Point& p : points) {
    profile.r_mm.push_back(p.r);
    profile.theta_rad.push_back(p.theta);
    profile.z_mm.push_back(p.z);
  }
  sums.add(profile.r_mm, profile.theta_rad, profile.z_mm);
  look.add(profile);
  return {grid, {std::move(sums), std::move(look)}, {input}};
}

NamedPart named(const std::string& name, const PartialSums& sums) {
  const TemporaryFolder folder;
  auto part = read_part(folder.write(name, format_part(sums)));
  EXPECT_TRUE(part) << part.error();
  part->name = name;
  return std::move(*part);
}

TEST(PartialSums, AreReadAndWrittenAsTheGrammarSays) {
  const auto part = parse_part(golden(), "golden.part");
  ASSERT_TRUE(part) << part.error();
  EXPECT_EQ(part->grid.cells.z_start_mm, -8);
  EXPECT_EQ(part->grid.cells.z_intervals, 4);
  EXPECT_EQ(part->grid.cells.intervals_per_arc, 2);
  EXPECT_EQ(part->grid.cells.degree_u, 2);
  EXPECT_EQ(part->grid.cells.degree_v, 1);
  EXPECT_EQ(part->grid.X_FL * Eigen::Vector3d(1, 2, 3), Eigen::Vector3d(4.5, -1, 2.25));
  EXPECT_EQ(part->grid.millimetres_per_unit, 25.4);
  EXPECT_EQ(part->inputs, (std::vector<std::string>{"a.xyz", "b.xyz"}));
  const MomentGrid& sums = part->samples.sums;
  EXPECT_EQ(sums.samples(), 5u);
  EXPECT_EQ(sums.rejected_on_axis(), 1u);
  EXPECT_EQ(sums.rejected_not_finite(), 2u);
  EXPECT_EQ(sums.rejected_outside(), 3u);
  EXPECT_EQ(sums.cell_weight(0, 0), 3);  // of the five samples
  EXPECT_EQ(sums.sum_weighted_range(), 30.5 + 31.25 + 29.75 + 30 + 28.5);
  const MomentLayout& at = sums.layout();
  EXPECT_EQ(sums.cell(0, 0)[at.weight(1, 1)], -0.75 * -0.5 + 0.625 * 0.5);
  EXPECT_EQ(sums.cell(0, 0)[at.range(1, 0)], 30.5 * -0.75 + 31.25 * 0.625);
  EXPECT_EQ(part->samples.look.points(), 11u);
  ASSERT_EQ(part->samples.look.samples().size(), 5u);
  EXPECT_EQ(part->samples.look.samples()[4].v, 2.0625);
  EXPECT_EQ(part->samples.look.extents().highest(0, 0), -1.5);
  EXPECT_EQ(part->samples.look.extents().lowest(2, 9), std::numeric_limits<double>::infinity());
  EXPECT_EQ(format_part(*part), golden());
}

// The hash of a kept sample is its own.
TEST(PartialSums, KeepTheSamplesThatTheGrammarNames) {
  const auto part = parse_part(golden(), "golden.part");
  MomentGrid sums(part->grid.cells);
  FirstLook look(sums);
  Profile profile;
  profile.r_mm = {30};
  profile.theta_rad = {0};
  profile.z_mm = {23};
  look.add(profile);
  ASSERT_EQ(look.samples().size(), 1u);
  EXPECT_EQ(look.sample().hashes()[0], part->samples.look.sample().hashes()[3]);
}

TEST(PartialSums, SumsAndSampleComeBack) {
  const PartialSums part = part_of(random_points(5000, 1), small_grid());
  const std::string bytes = format_part(part);
  const auto back = parse_part(bytes, "a.part");
  ASSERT_TRUE(back) << back.error();
  EXPECT_EQ(format_part(*back), bytes);
  EXPECT_EQ(back->samples.sums.samples(), part.samples.sums.samples());
  EXPECT_EQ(back->samples.sums.rejected_outside(), part.samples.sums.rejected_outside());
  EXPECT_GT(back->samples.sums.rejected_outside(), 0u);
  std::vector<double> a(part.samples.sums.packed_size()), b = a;
  for (int j = 0; j < part.samples.sums.v_cells(); ++j)
    for (int i = 0; i < 8; ++i) {
      part.samples.sums.pack(i, j, a.data());
      back->samples.sums.pack(i, j, b.data());
      EXPECT_EQ(a, b);
    }
}

// Wherever it is cut off, and whichever bit is turned, a part is refused with its name and no more.
TEST(PartialSums, CutOffAtEveryByteTheyAreRefused) {
  const std::string bytes = golden();
  for (std::size_t n = 0; n < bytes.size(); ++n) {
    const auto part = parse_part(bytes.substr(0, n), "cut.part");
    ASSERT_FALSE(part) << n;
    EXPECT_TRUE(part.error().starts_with("cut.part: ")) << part.error();
    if (n < 16) continue;
    EXPECT_THAT(part.error(), HasSubstr("truncated")) << n;
  }
  EXPECT_THAT(parse_part(bytes + '\0', "x").error(), HasSubstr("1 bytes after its end"));
}

TEST(PartialSums, WithAnyBitTurnedTheyAreRefused) {
  const std::string bytes = golden();
  for (std::size_t n = 0; n < bytes.size(); ++n)
    for (const int bit : {0, 3, 7}) {
      if (n >= 10 && n < 12) continue;  // the minor version, which readers pass over
      std::string bad = bytes;
      bad[n] = static_cast<char>(bad[n] ^ (1 << bit));
      EXPECT_FALSE(parse_part(bad, "bad.part")) << n << ", bit " << bit;
    }
}

TEST(PartialSums, ForeignFilesAndOtherVersionsAreRefused) {
  for (const std::string& foreign : {std::string("ply\nformat ascii 1.0\n"), std::string("\x89PNG\r\n\x1a\n 12345678"),
                                     std::string(), std::string(1000, '\0')})
    EXPECT_THAT(parse_part(foreign, "f").error(), HasSubstr("is no part"));
  std::string next = golden();
  next[8] = 2;
  EXPECT_THAT(parse_part(next, "f").error(), HasSubstr("version 2"));
  EXPECT_THAT(read_part("/absent/a.part").error(), HasSubstr("/absent/a.part"));
}

// Sums of random parts of a cloud, added in any order: those of the whole to rounding, the same bytes, and the same
// choice of samples.
RC_GTEST_PROP(PartialSums, PartsAddUpToTheWhole, ()) {
  const auto seed = *rc::gen::inRange(1, 1000);
  const auto points = random_points(3000, static_cast<unsigned>(seed));
  const int parts = *rc::gen::inRange(1, 6);
  std::vector<std::vector<Point>> shares(static_cast<std::size_t>(parts));
  std::mt19937 random(static_cast<unsigned>(seed));
  for (const Point& p : points) shares[random() % shares.size()].push_back(p);
  const auto merged = [&] {
    std::vector<NamedPart> list;
    for (std::size_t k = 0; k < shares.size(); ++k)
      list.push_back(named(std::to_string(k), part_of(shares[k], small_grid(), std::to_string(k) + ".xyz")));
    return list;
  };
  const auto forward = merge_parts(merged());
  auto list = merged();
  std::reverse(list.begin(), list.end());
  const auto backward = merge_parts(std::move(list));
  RC_ASSERT(forward && backward);
  RC_ASSERT(format_part(*forward) == format_part(*backward));
  const PartialSums whole = part_of(points, small_grid());
  RC_ASSERT(forward->samples.sums.samples() == whole.samples.sums.samples());
  std::vector<double> a(whole.samples.sums.packed_size()), b = a;
  for (int j = 0; j < whole.samples.sums.v_cells(); ++j)
    for (int i = 0; i < 8; ++i) {
      whole.samples.sums.pack(i, j, a.data());
      forward->samples.sums.pack(i, j, b.data());
      for (std::size_t k = 0; k < a.size(); ++k) RC_ASSERT(std::abs(a[k] - b[k]) <= 1e-13 * (1 + a.back()));
    }
  const auto sorted = [](const PartialSums& part) {
    auto hashes = part.samples.look.sample().hashes();
    std::sort(hashes.begin(), hashes.end());
    return hashes;
  };
  RC_ASSERT(sorted(*forward) == sorted(whole));
}

TEST(PartialSums, OfOtherGridsAreRefusedWithBothValues) {
  const auto points = random_points(200, 2);
  struct Case {
    void (*change)(SumsGrid&);
    std::vector<const char*> says;
  };
  const Case cases[] = {
      {[](SumsGrid& g) { g.cells.base = BaseKind::sphere, g.cells.z_start_mm = 0, g.cells.z_end_mm = 2; },
       {"base", "cylinder", "sphere"}},
      {[](SumsGrid& g) { g.cells.z_end_mm = 81.5; }, {"band", "80.0", "81.5"}},
      {[](SumsGrid& g) { g.cells.z_intervals = 16; }, {"intervals", "[8,4]", "[16,4]"}},
      {[](SumsGrid& g) { g.cells.degree_v = 5; }, {"degrees", "[3,3]", "[3,5]"}},
      {[](SumsGrid& g) { g.cells.arcs = BaseArcs::open(0.5, 3); }, {"angular range", "[0.5,3.0]", "6.28"}},
      {[](SumsGrid& g) { g.X_FL.translation().x() = 0.125; }, {"frame", "0.125"}},
      {[](SumsGrid& g) { g.millimetres_per_unit = 25.4; }, {"unit", "1.0", "25.4"}}};
  for (const Case& c : cases) {
    SumsGrid other = small_grid();
    c.change(other);
    const auto merged =
        merge_parts({named("here.part", part_of(points, small_grid())), named("there.part", part_of(points, other))});
    ASSERT_FALSE(merged) << c.says[0];
    for (const char* text : c.says) EXPECT_THAT(merged.error(), HasSubstr(text));
    for (const char* text : {"here.part", "there.part", "one grid file"}) EXPECT_THAT(merged.error(), HasSubstr(text));
  }
  const PartialSums part = part_of(points, small_grid());
  EXPECT_THAT(merge_parts({named("a.part", part), named("b.part", part)}).error(), HasSubstr("the same part"));
}

TEST(GridFile, EveryNumberComesBack) {
  SumsGrid grid = small_grid();
  grid.cells.z_start_mm = 1.0 / 3;
  grid.X_FL.linear() = Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  grid.X_FL.translation() << 1.0 / 7, -2, 3;
  grid.millimetres_per_unit = 0.001;
  for (const bool open : {false, true}) {
    if (open) grid.cells.arcs = BaseArcs::open(0.3, 200 * std::numbers::pi / 180);
    const std::string text = format_grid(grid);
    const auto back = parse_grid(text, "grid.json");
    ASSERT_TRUE(back) << back.error();
    EXPECT_FALSE(difference(grid, "a", *back, "b")) << *difference(grid, "a", *back, "b");
    EXPECT_EQ(format_grid(*back), text);
  }
}

TEST(GridFile, NamesWhatIsWrong) {
  const json good = json::parse(format_grid(small_grid()));
  struct Case {
    const char* pointer;
    json value;
    const char* says;
  };
  const Case cases[] = {{"/version", 2, "version"},
                        {"/format", "stl", "format"},
                        {"/base", "torus", "base"},
                        {"/band", json::array({3, 3}), "band"},
                        {"/intervals/0", 12, "intervals[0] is 12, no power of two"},
                        {"/intervals/1", 8192, "cells"},
                        {"/degree/1", 6, "degree[1] is 6"},
                        {"/degree", json::array({3}), "degree"},
                        {"/frame/z", json::array({0, 0, -1}), "frame"},
                        {"/millimetres_per_unit", 0, "millimetres_per_unit"},
                        {"/weights", "covariance", "weights"},
                        {"/arcs/closed", 1, "arcs.closed"}};
  for (const Case& c : cases) {
    json bad = good;
    bad[json::json_pointer(c.pointer)] = c.value;
    const auto read = parse_grid(bad.dump(), "bad.json");
    ASSERT_FALSE(read) << c.pointer;
    EXPECT_THAT(read.error(), HasSubstr(c.says));
    EXPECT_TRUE(read.error().starts_with("bad.json: ")) << read.error();
  }
  EXPECT_FALSE(parse_grid("", "f"));
  EXPECT_FALSE(read_grid("/absent/grid.json"));
}

}  // namespace
}  // namespace celadon
