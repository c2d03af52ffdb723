// Which of two peaks is the line: frames in which the reflection outshines the line over a stretch, folds of the
// surface where both are lines, occlusion edges, and rows of peaks written by hand.

#include "acquisition/line_continuity.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <functional>
#include <random>
#include <stdexcept>
#include <vector>

#include "acquisition/laser_line.h"
#include "tests/acquisition/simd_targets.h"
#include "tests/acquisition/synthetic_line.h"

namespace celadon {
namespace {

using synthetic::Picture;
using synthetic::RowKind;
using synthetic::Scene;
using synthetic::Truth;

/// A second line in a frame.
struct Reflection {
  int from = 0, to = 0;   ///< rows
  double share = 1.6;     ///< of the line's brightness, in the middle of its rows
  double offset_px = 90;  ///< from the line
  double lean = 0;        ///< px a row, beside the line
  bool fades = true;      ///< grows from nothing, and vanishes
};

struct Jump {
  int row = 0;
  double by_px = 0;
};

/// A winding line with occlusion edges and a reflection.
Picture reflected_frame(int width, int height, const Scene& scene, unsigned seed, const Reflection& r,
                        const std::vector<Jump>& jumps = {}) {
  std::mt19937_64 random(seed * 7919 + 3);
  const auto phase = [&] { return std::uniform_real_distribution<double>(0, 6.28)(random); };
  const double p1 = phase(), p2 = phase(), p3 = phase();
  Truth truth;
  for (int y = 0; y < height; ++y) {
    const double turn = 6.283 * y / 1024;
    double center = 0.45 * width + 60 * std::sin(1.3 * turn + p1) + 10 * std::sin(5.1 * turn + p2);
    for (const Jump& jump : jumps) center += y >= jump.row ? jump.by_px : 0;
    truth.center_px.push_back(center);
    truth.width_px.push_back(3);
    truth.amplitude.push_back(scene.amplitude * (0.75 + 0.25 * std::sin(3.7 * turn + p3)));
    truth.kind.push_back(RowKind::line);
  }
  const auto reflection = [&](int x, int y) {
    if (y < r.from || y >= r.to) return 0.0;
    const auto row = static_cast<std::size_t>(y);
    const double fade = r.fades ? std::sin(3.14159 * (y - r.from + 0.5) / (r.to - r.from)) : 1;
    const double u = (x - truth.center_px[row] - r.offset_px - r.lean * (y - r.from)) / 3.5;
    return std::abs(u) < 6 ? fade * r.share * truth.amplitude[row] * std::exp(-0.5 * u * u) : 0.0;
  };
  return synthetic::draw(
      width, height, truth, scene, seed, [&](int, int) { return scene.ambient_low; }, reflection);
}

std::vector<LineRow> extract(const Picture& picture, bool continuity, std::span<const LineRow> previous = {}) {
  LaserLineOptions options;
  options.continuity = continuity;
  std::vector<LineRow> rows(static_cast<std::size_t>(picture.height));
  LaserLineExtractor(options).extract(synthetic::mode_of(picture.width, picture.height), picture.on, picture.off, rows,
                                      previous);
  return rows;
}

struct Tally {
  int right = 0, wrong = 0, flagged = 0, missed = 0;
  double percent(int count) const { return 100.0 * count / std::max(right + wrong + flagged + missed, 1); }
};

/// Rows from..to against the truth; a position over 1.5 px off is wrong.
void tally(const Picture& picture, const std::vector<LineRow>& rows, int from, int to, Tally& t) {
  for (auto y = static_cast<std::size_t>(from); y < static_cast<std::size_t>(to); ++y) {
    if (rows[y].x_px >= 0) {
      const bool right = std::abs(static_cast<double>(rows[y].x_px) - picture.truth.center_px[y]) <= 1.5;
      ++(right ? t.right : t.wrong);
    } else {
      ++(rows[y].status == RowStatus::ambiguous ? t.flagged : t.missed);
    }
  }
}

void print(const char* what, const Tally& t) {
  std::printf("%-44s right %6.2f %%, wrong %6.3f %%, flagged %5.2f %%, missed %5.2f %%\n", what, t.percent(t.right),
              t.percent(t.wrong), t.percent(t.flagged), t.percent(t.missed));
}

TEST(LineContinuity, AReflectionThatOutshinesTheLineIsPassedOver) {
  Tally before, after;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const Reflection r{.from = 150 + static_cast<int>(seed) * 20,
                       .to = 450 + static_cast<int>(seed) * 30,
                       .share = 1.1 + 0.1 * seed,
                       .offset_px = seed % 2 == 0 ? 90.0 : -110.0,
                       .lean = 0.05 * (static_cast<double>(seed % 5) - 2)};
    const auto picture = reflected_frame(1280, 1024, synthetic::nominal_scene(), seed, r);
    tally(picture, extract(picture, false), 0, 1024, before);
    tally(picture, extract(picture, true), 0, 1024, after);
  }
  print("reflection of 1.2 to 2.3, brightness alone", before);
  print("the same with continuity", after);
  EXPECT_GE(before.percent(before.wrong), 3) << "not the case that is to be tested";
  EXPECT_LE(after.percent(after.wrong), 0.05);
  EXPECT_GE(after.percent(after.right), 98);
}

// Both the line and its reflection jump at the edge; neither may be joined to the other.
TEST(LineContinuity, OcclusionEdgesStayEdges) {
  Tally before, after;
  for (unsigned seed = 21; seed <= 32; ++seed) {
    const double offset = seed % 2 == 0 ? 90 : -90;
    // The first jump brings the line to where its reflection was.
    const std::vector<Jump> jumps{{420, offset}, {700, -40}, {850, 17}};
    const Reflection r{.from = 250, .to = 600, .share = 1.8, .offset_px = offset};
    const auto picture = reflected_frame(1280, 1024, synthetic::nominal_scene(), seed, r, jumps);
    tally(picture, extract(picture, false), 0, 1024, before);
    tally(picture, extract(picture, true), 0, 1024, after);
  }
  print("with occlusion edges, brightness alone", before);
  print("the same with continuity", after);
  EXPECT_GE(before.percent(before.wrong), 3);
  EXPECT_LE(after.percent(after.wrong), 0.05);
}

// One surface before another, both lit: neither line is the other's reflection, and nobody can tell which is meant.
TEST(LineContinuity, AFoldIsFlaggedAndNotDecided) {
  for (unsigned seed = 41; seed <= 44; ++seed) {
    Scene scene = synthetic::nominal_scene();
    Truth truth;
    for (int y = 0; y < 600; ++y) {
      truth.center_px.push_back(400 + 0.2 * y);
      truth.width_px.push_back(3);
      truth.amplitude.push_back(scene.amplitude);
      truth.kind.push_back(y < 350 ? RowKind::line : RowKind::none);
    }
    const auto behind = [&](int x, int y) {
      const double u = (x - 300 - 0.1 * y) / 3;
      return y >= 250 ? scene.amplitude * std::exp(-0.5 * u * u) : 0;
    };
    const auto picture = synthetic::draw(
        800, 600, truth, scene, seed, [](int, int) { return 15.0; }, behind);
    const auto rows = extract(picture, true);
    int flagged = 0;
    for (std::size_t y = 0; y < rows.size(); ++y) {
      flagged += y >= 250 && y < 350 && rows[y].status == RowStatus::ambiguous;
      if (rows[y].x_px < 0) continue;
      const double x = static_cast<double>(rows[y].x_px), row = static_cast<double>(y);
      if (y < 250) {
        EXPECT_NEAR(x, 400 + 0.2 * row, 1.5) << y;
      }
      if (y >= 350) {
        EXPECT_NEAR(x, 300 + 0.1 * row, 1.5) << y;
      }
    }
    EXPECT_GE(flagged, 95) << "of 100 rows with both";
  }
}

TEST(LineContinuity, TheFrameBeforeTellsWhereNothingElseCan) {
  Tally alone, guided, misguided;
  for (unsigned seed = 51; seed <= 56; ++seed) {
    // All along the line, so that no row shows which of the two goes on alone.
    const Reflection r{.from = 0, .to = 1024, .share = 1.2, .offset_px = 80, .fades = false};
    const auto picture = reflected_frame(1280, 1024, synthetic::nominal_scene(), seed, r);
    std::vector<LineRow> before(1024), elsewhere(1024);
    for (std::size_t y = 0; y < before.size(); ++y) {
      const auto x = static_cast<float>(picture.truth.center_px[y]);
      before[y] = {x + 4, 0.2f, 100, 3, RowStatus::found};  // the table has turned a little since
      elsewhere[y] = {x + 300, 0.2f, 100, 3, RowStatus::found};
    }
    tally(picture, extract(picture, true), 0, 1024, alone);
    tally(picture, extract(picture, true, before), 0, 1024, guided);
    tally(picture, extract(picture, true, elsewhere), 0, 1024, misguided);
  }
  print("reflection all along, alone", alone);
  print("with the frame before", guided);
  EXPECT_GE(guided.percent(guided.right), 98);
  EXPECT_LE(guided.percent(guided.wrong), 0.05);
  EXPECT_LE(alone.percent(alone.right), 5);
  EXPECT_EQ(misguided.right, alone.right) << "a line far away is none of the two";
}

TEST(LineContinuity, FramesWithoutASecondLineAreLeftAsTheyAre) {
  for (unsigned seed = 61; seed <= 64; ++seed) {
    const auto picture = synthetic::scan_frame(1280, 1024, synthetic::nominal_scene(), seed);
    const auto before = extract(picture, false), after = extract(picture, true);
    for (std::size_t y = 0; y < before.size(); ++y) {
      EXPECT_EQ(before[y].x_px, after[y].x_px) << y;
      EXPECT_EQ(before[y].status, after[y].status) << y;
    }
  }
}

TEST(LineContinuity, EverySimdTargetChoosesAlike) {
  const Reflection r{.from = 60, .to = 340, .share = 1.7, .offset_px = -100};
  const auto picture = reflected_frame(640, 400, synthetic::nominal_scene(), 71, r, {{300, 60}});
  const auto expected = extract(picture, true);
  on_every_target([&] {
    const auto rows = extract(picture, true);
    for (std::size_t y = 0; y < rows.size(); ++y) {
      EXPECT_EQ(rows[y].status, expected[y].status) << y;
      EXPECT_NEAR(rows[y].x_px, expected[y].x_px, 0.01) << y;
    }
  });
}

/// Peaks by hand: line and reflection at columns of the row, -1 for none; the reflection is the brighter one.
std::vector<PeakChoice> chosen(int rows, const std::function<int(int)>& line, const std::function<int(int)>& reflection,
                               std::vector<LineRow> previous = {}) {
  std::vector<PeakPair> peaks;
  std::vector<LineRow> found;
  for (int y = 0; y < rows; ++y) {
    const auto l = static_cast<std::int16_t>(line(y)), r = static_cast<std::int16_t>(reflection(y));
    peaks.push_back(r >= 0 ? PeakPair{r, l} : PeakPair{l, -1});
    found.push_back({.x_px = static_cast<float>(peaks.back().first_px), .status = RowStatus::found});
  }
  std::vector<PeakChoice> choices;
  choose_peaks(peaks, found, previous, choices);
  return choices;
}

TEST(LineContinuity, RowsOfTheReflectionAloneAreFlagged) {
  const auto line = [](int y) { return y >= 50 && y < 60 ? -1 : 200 + y; };  // hidden by a speckle for ten rows
  const auto reflection = [](int y) { return y >= 30 && y < 80 ? 300 + y : -1; };
  const auto choices = chosen(100, line, reflection);
  ASSERT_EQ(choices.size(), 50u);
  for (const PeakChoice& choice : choices) {
    EXPECT_EQ(choice.center_px, choice.row >= 50 && choice.row < 60 ? -1 : 200 + choice.row) << choice.row;
  }
}

// A line and its reflection in the platter meet where the object stands: one peak is left, and it is nobody's own.
TEST(LineContinuity, WhereTwoLinesMeetNeitherGoesOn) {
  const auto goes_on = [](int y) { return y < 44 ? 400 - y / 2 : 378; };
  const auto ends = [](int y) { return y < 44 ? 300 + y : -1; };
  EXPECT_TRUE(chosen(90, goes_on, ends).empty());
  const auto ends_far_off = [](int y) { return y < 44 ? 200 + y : -1; };
  EXPECT_EQ(chosen(90, goes_on, ends_far_off).size(), 44u);
}

TEST(LineContinuity, FewRowsAreNoEvidence) {
  const auto line = [](int) { return 200; };
  const auto reflection = [](int y) { return y >= 3 && y < 40 ? 300 : -1; };
  EXPECT_TRUE(chosen(40, line, reflection).empty()) << "the line has three rows of its own";
  EXPECT_EQ(chosen(60, line, reflection).size(), 37u) << "it has twenty more";
}

TEST(LineContinuity, TheFrameBeforeIsNotBelievedAgainstThisOne) {
  const auto line = [](int) { return 200; };
  const auto reflection = [](int y) { return y >= 30 && y < 80 ? 300 : -1; };
  const std::vector<LineRow> at_reflection(100, LineRow{.x_px = 301, .status = RowStatus::found});
  EXPECT_TRUE(chosen(100, line, reflection, at_reflection).empty());
  const std::vector<LineRow> at_line(100, LineRow{.x_px = 199, .status = RowStatus::found});
  EXPECT_EQ(chosen(100, line, reflection, at_line).size(), 50u);
}

TEST(LineContinuity, RowsOfTheFrameBeforeOfAnotherSizeAreRefused) {
  const auto picture = synthetic::straight_line(320, 40, 140, 0, 3, synthetic::nominal_scene(), 1);
  EXPECT_THROW(extract(picture, true, std::vector<LineRow>(39)), std::invalid_argument);
  std::vector<LineRow> rows(40);
  LaserLineExtractor extractor;
  EXPECT_THROW(extractor.extract(synthetic::mode_of(320, 40), picture.on, {}, rows, rows), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
