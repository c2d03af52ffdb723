// Fiducials on the platter, found, surveyed and followed, against the virtual scanner's truth.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>
#include <vector>

#include "acquisition/datum/rim_survey.h"
#include "acquisition/datum/rim_tag_finder.h"
#include "acquisition/datum/rim_tag_tracker.h"
#include "tests/acquisition/datum/rim_camera.h"

namespace celadon {
namespace {

using testing::RimCamera;

constexpr double kTurn = 2 * std::numbers::pi;

struct Followed {
  int expected = 0, seen = 0;
  double rms_px = 0, worst_px = 0, stated_px = 0;
};

Followed follow(RimCamera& camera, const Calibration& calibration, int frames, double error_rad = 0) {
  RimTagTracker tracker(calibration);
  Followed out;
  double squares = 0, stated = 0;
  for (int k = 0; k < frames; ++k) {
    const double angle = kTurn * k / frames;
    const auto& seen = tracker.track(camera.mode(), camera.shoot(angle, static_cast<std::uint64_t>(k)),
                                     [&](double) { return angle + error_rad; });
    out.expected += tracker.expected();
    for (const TagSighting& tag : seen) {
      ++out.seen;
      squares += tag.shift_px.squaredNorm() / 2;
      stated += tag.information.inverse().trace() / 2;
      out.worst_px = std::max(out.worst_px, tag.shift_px.norm());
    }
  }
  out.rms_px = std::sqrt(squares / std::max(1, out.seen));
  out.stated_px = std::sqrt(stated / std::max(1, out.seen));
  return out;
}

TEST(RimTags, AreWhereTheTruthHasThem) {
  RimCamera camera("empty");
  const Followed f = follow(camera, camera.truth(), 12);
  std::printf("%d of %d seen, rms %.4f, stated %.4f, worst %.3f px\n", f.seen, f.expected, f.rms_px, f.stated_px,
              f.worst_px);
  EXPECT_GE(f.seen, 0.95 * f.expected);
  EXPECT_LE(f.rms_px, 0.05);
  EXPECT_LE(f.worst_px, 0.2);
}

TEST(RimTags, AreSeenInTheLightOfAScan) {
  RimCamera camera("cylinder", 1);
  const Followed f = follow(camera, camera.truth(), 24);
  std::printf("%d of %d seen, rms %.4f, stated %.4f, worst %.3f px\n", f.seen, f.expected, f.rms_px, f.stated_px,
              f.worst_px);
  EXPECT_GE(f.seen, 3 * 24);
  EXPECT_LE(f.rms_px, 0.1);
  EXPECT_LE(f.rms_px, 2 * f.stated_px + 0.03);
}

// The object hides those behind it; what is half hidden is not taken for a tag that lies elsewhere.
TEST(RimTags, BehindAnObjectAreNotMistaken) {
  RimCamera camera("humidifier");
  const Followed f = follow(camera, camera.truth(), 16);
  EXPECT_GT(f.seen, 3 * 16);
  EXPECT_LT(f.seen, f.expected);
  EXPECT_LE(f.worst_px, 0.3);
}

// 3 degrees are 3.5 mm at the rim: the search finds them.
TEST(RimTags, AreFoundFarFromTheirPlaces) {
  RimCamera camera("empty");
  const double error = 0.05;
  Calibration calibration = camera.truth();
  RimTagTracker tracker(calibration);
  for (int k = 0; k < 20; ++k) {
    tracker.track(camera.mode(), camera.shoot(0.1 * k, 1), [&](double) { return 0.1 * k - error; });
  }
  const auto& seen = tracker.track(camera.mode(), camera.shoot(2, 1), [&](double) { return 2 - error; });
  ASSERT_GE(seen.size(), 4U);
  const CameraModel& m = calibration.camera_model;
  const Lens lens(m);
  const auto project = [&](const Eigen::Vector3d& p) { return lens.project(p.x() / p.z(), p.y() / p.z()); };
  for (const TagSighting& tag : seen) {
    const RimTag& rim = calibration.rim_tags[tag.tag];
    const Eigen::Vector2d expected =
        project(tag_middle_C(calibration, rim, 2)) - project(tag_middle_C(calibration, rim, 2 - error));
    EXPECT_LE((tag.shift_px - expected).norm(), 0.25) << rim.number;
  }
}

// A table that slips by a cell and a half between two frames: no tag is taken for its neighbour's place.
TEST(RimTags, AreNotFollowedToAWrongPlaceAfterASlip) {
  RimCamera camera("cylinder", 1);
  const Calibration calibration = camera.truth();
  const Lens lens(calibration.camera_model);
  const auto project = [&](const Eigen::Vector3d& p) { return lens.project(p.x() / p.z(), p.y() / p.z()); };
  RimTagTracker tracker(calibration);
  constexpr double kSlip = 0.035;
  int seen = 0;
  for (int k = 0; k < 40; ++k) {
    const double angle = 0.0236 * k, really = angle - (k < 8 ? 0 : kSlip);
    for (const TagSighting& tag : tracker.track(camera.mode(), camera.shoot(really, static_cast<std::uint64_t>(k)),
                                                [&](double) { return angle; })) {
      const RimTag& rim = calibration.rim_tags[tag.tag];
      const Eigen::Vector2d expected =
          project(tag_middle_C(calibration, rim, really)) - project(tag_middle_C(calibration, rim, angle));
      EXPECT_LE((tag.shift_px - expected).norm(), 0.75) << k << " " << rim.number;
      ++seen;
    }
  }
  EXPECT_GE(seen, 90);
}

TEST(RimTags, ABlackPictureShowsNone) {
  RimCamera camera("empty");
  const Calibration calibration = camera.truth();
  RimTagTracker tracker(calibration);
  const std::vector<std::uint8_t> black(std::size_t{RimCamera::kWidth} * RimCamera::kHeight, 16);
  EXPECT_TRUE(tracker.track(camera.mode(), black, [](double) { return 0.; }).empty());
  EXPECT_GT(tracker.expected(), 0);
}

TEST(RimSurvey, TellsWhereTheTagsAre) {
  RimCamera camera("empty");
  const Calibration truth = camera.truth();
  RimTagFinder finder;
  std::vector<RimView> views;
  for (int k = 0; k < 18; ++k) {
    const double angle = kTurn * k / 18;
    views.push_back({angle, finder.find(camera.shoot(angle, static_cast<std::uint64_t>(k)), RimCamera::kWidth,
                                        RimCamera::kHeight)});
  }
  const std::vector<RimTag> tags = survey_rim(truth, views);
  ASSERT_EQ(tags.size(), 12U);
  for (std::size_t k = 0; k < tags.size(); ++k) {
    ASSERT_EQ(tags[k].number, truth.rim_tags[k].number);
    double worst = 0;
    for (std::size_t c = 0; c < 4; ++c) {
      worst = std::max(worst, (tags[k].corners_mm[c] - truth.rim_tags[k].corners_mm[c]).norm());
    }
    EXPECT_LE(worst, 0.06) << tags[k].number;
    EXPECT_LE(tags[k].u_mm, 0.03);
    EXPECT_LE(worst, 6 * tags[k].u_mm + 0.02);
  }
}

// One that is carried along by the camera, or lies on the bench, is not on the platter.
TEST(RimSurvey, LeavesOutWhatDoesNotTurnWithTheTable) {
  RimCamera camera("empty");
  const Calibration truth = camera.truth();
  std::vector<RimView> views;
  for (int k = 0; k < 12; ++k) {
    SeenTag still{
        7,
        {Eigen::Vector2d(600, 700), Eigen::Vector2d(640, 700), Eigen::Vector2d(640, 720), Eigen::Vector2d(600, 720)}};
    views.push_back({kTurn * k / 12, {still}});
  }
  EXPECT_TRUE(survey_rim(truth, views).empty());
  EXPECT_TRUE(survey_rim(truth, {}).empty());
}

}  // namespace
}  // namespace celadon
