// Exposures from peaks that are known: which the sectors get, when two are needed, what is said of the rest.

#include "daemon/exposure_plan.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>

#include "daemon/bracketed_rows.h"

namespace celadon {
namespace {

constexpr int kRows = 200;
const ExposureLimits kLimits{16, 0.02, 0, false};

using Levels = std::function<double(double deg, int row)>;  // grey levels a millisecond, 0: no line

/// Peaks of passes at these exposures, of a camera that saturates at 250 and finds no line below 7.
PeakSurvey survey_of(const Levels& levels_per_ms, const std::vector<double>& exposures_ms) {
  PeakSurvey survey;
  for (const double exposure_ms : exposures_ms) {
    survey.begin_pass(exposure_ms, 0);
    for (double deg = 1.25; deg < 360; deg += 2.5) {
      std::vector<LineRow> rows(kRows);
      Profile profile;
      for (int k = 0; k < kRows; ++k) {
        const double level = levels_per_ms(deg, k) * exposure_ms;
        if (level < 7) continue;
        LineRow& row = rows[static_cast<std::size_t>(k)];
        row.status = level > 250 ? RowStatus::saturated : RowStatus::found;
        row.amplitude = static_cast<float>(std::min(level, 260.));
        profile.row.push_back(static_cast<std::uint16_t>(k));
      }
      survey.see(rows, profile, deg * std::numbers::pi / 180);
    }
    if (!survey.asks_for_another()) break;
  }
  return survey;
}

ExposureChoice choice_of(const Levels& levels_per_ms, const ExposureLimits& limits = kLimits) {
  return choose_exposures(survey_of(levels_per_ms, {16, 2, 0.25, 0.03}).reading(), limits);
}

double at_deg(const ExposurePlan& plan, double deg) {
  return static_cast<double>(plan.at_ns(deg * std::numbers::pi / 180)) * 1e-6;
}

TEST(PeakSurvey, TellsPeaksBeyondWhatOneExposureCan) {
  // 6 and 600 levels a millisecond: 600 is saturated at 16 and 2 ms, 6 is seen at both.
  const Levels two = [](double, int row) { return row < 100 ? 6. : 600.; };
  PeakSurvey one = survey_of(two, {16});
  EXPECT_TRUE(one.asks_for_another());
  const PeakSurvey all = survey_of(two, {16, 2, 0.25, 0.03});
  EXPECT_FALSE(all.asks_for_another());
  for (const PeakHistogram& peaks : all.reading()) {
    EXPECT_NEAR(peaks.weight(), kRows, 1e-9) << "each row once, whichever pass told it";
    EXPECT_NEAR(peaks.quantile(0.25), 6, 1.2);
    EXPECT_NEAR(peaks.quantile(0.95), 600, 120);
    EXPECT_NEAR(peaks.darker_than(50), 100, 1e-9);
  }
}

// How bright it is beyond that is not known, whatever is left of its peak.
TEST(PeakSurvey, ASaturatedRowIsLeftToTheNextPass) {
  for (const RowStatus status : {RowStatus::found, RowStatus::saturated}) {
    PeakSurvey survey;
    survey.begin_pass(16, 0);
    std::vector<LineRow> rows(kRows);
    Profile profile;
    for (int k = 0; k < kRows; ++k) {
      rows[static_cast<std::size_t>(k)].status = status;
      rows[static_cast<std::size_t>(k)].amplitude = 150;
      profile.row.push_back(static_cast<std::uint16_t>(k));
    }
    survey.see(rows, profile, 1);
    EXPECT_EQ(survey.asks_for_another(), status == RowStatus::saturated);
  }
}

TEST(ExposurePlan, BrightPlacesOfEachSectorComeTo100To200Levels) {
  for (const double levels_per_ms : {7., 12.4, 13., 40., 300., 5000.}) {
    const ExposureChoice choice = choice_of([&](double, int) { return levels_per_ms; });
    ASSERT_EQ(choice.plans.size(), 1u);
    EXPECT_TRUE(choice.unreached.empty());
    ASSERT_EQ(choice.plans[0].values_ns().size(), 1u) << "one colour, one exposure";
    const double level = levels_per_ms * at_deg(choice.plans[0], 10);
    EXPECT_LE(level, 200) << levels_per_ms;
    EXPECT_GT(level, 84) << levels_per_ms << ": half of it, less a bin";
  }
}

TEST(ExposurePlan, ADarkThirdHasItsOwnAndNoSecondTurn) {
  // Its borders within sectors: 121 degrees wide from 7 on.
  const ExposureChoice choice = choice_of([](double deg, int) { return deg > 7 && deg < 128 ? 2. : 50.; });
  ASSERT_EQ(choice.plans.size(), 1u);
  const ExposurePlan& plan = choice.plans[0];
  EXPECT_EQ(at_deg(plan, 60), 16);
  EXPECT_EQ(at_deg(plan, 12), 16);
  EXPECT_EQ(at_deg(plan, 122), 16);
  EXPECT_LE(at_deg(plan, 250), 4);
  EXPECT_EQ(plan.values_ns().size(), 2u);
  const auto stretches = plan.stretches();
  ASSERT_EQ(stretches.size(), 2u);
  EXPECT_LT(stretches[0].from_deg, 0);
  EXPECT_NEAR(stretches[0].to_deg, 10, 5);
  EXPECT_EQ(stretches[1].from_deg, stretches[0].to_deg);
  EXPECT_EQ(stretches[1].to_deg, stretches[0].from_deg + 360);
}

// A sweep keeps one exposure: its second turn is planned for the dark third and what is beside it.
TEST(ExposurePlan, TurnsOfOneExposureAreTheBrightOnesAndTheDarkOnes) {
  const ExposureChoice choice = choice_of([](double deg, int) { return deg > 7 && deg < 128 ? 2. : 50.; });
  const std::vector<ExposurePlan> turns = one_exposure_a_turn(choice.plans);
  ASSERT_EQ(turns.size(), 2u);
  EXPECT_EQ(turns[0].values_ns().size(), 1u);
  EXPECT_EQ(turns[0].longest_ns(), choice.plans[0].values_ns().front());
  EXPECT_EQ(turns[1].longest_ns(), choice.plans[0].values_ns().back());
  EXPECT_EQ(at_deg(turns[1], 60), 16);
  EXPECT_EQ(at_deg(turns[1], 7.5), 16) << "the sector of the border";
  EXPECT_EQ(at_deg(turns[1], 129), 16);
  EXPECT_EQ(turns[1].at_ns(4), turns[0].longest_ns());

  const ExposureChoice bands = choice_of([](double, int row) { return row % 2 == 0 ? 50. : 0.9; });
  ASSERT_EQ(bands.plans.size(), 2u);
  const std::vector<ExposurePlan> same = one_exposure_a_turn(bands.plans);
  ASSERT_EQ(same.size(), 2u);
  EXPECT_EQ(same[0].values_ns(), bands.plans[0].values_ns());
  EXPECT_EQ(same[1].values_ns(), bands.plans[1].values_ns());
}

TEST(ExposurePlan, ALittleDarkerIsNotWorthATurn) {
  const ExposureChoice choice = choice_of([](double deg, int) { return deg < 120 ? 20. : 40.; });
  EXPECT_EQ(one_exposure_a_turn(choice.plans).size(), 1u);
}

TEST(ExposurePlan, ChangesAreAtLeast15DegreesApart) {
  // Colours that change every 4 degrees, over a hundred to one.
  const ExposureChoice choice =
      choice_of([](double deg, int) { return 3 * std::exp2(std::fmod(3 * std::floor(deg / 4), 7)); });
  for (const ExposurePlan& plan : choice.plans) {
    for (const ExposurePlan::Stretch& s : plan.stretches()) EXPECT_GE(s.to_deg - s.from_deg, 15 - 1e-9);
  }
}

TEST(ExposurePlan, BrightAndDarkRowsOfOneSectorNeedTwo) {
  const ExposureChoice choice = choice_of([](double deg, int row) {
    return row % 40 < 20 ? 50. : deg < 90 ? 1.5 : 40.;
  });
  ASSERT_EQ(choice.plans.size(), 2u);
  EXPECT_TRUE(choice.unreached.empty());
  const double shorter = at_deg(choice.plans[0], 45), longer = at_deg(choice.plans[1], 45);
  EXPECT_LE(50 * shorter, 200);
  EXPECT_LT(1.5 * shorter, 12) << "no single exposure shows both";
  EXPECT_EQ(longer, 16);
  EXPECT_EQ(at_deg(choice.plans[0], 200), at_deg(choice.plans[1], 200)) << "where one is enough both turns have it";

  // Eight to one is always within one exposure; a dark place that no exposure reaches asks for no turn.
  EXPECT_EQ(choice_of([](double, int row) { return row < 100 ? 50. : 6.5; }).plans.size(), 1u);
  EXPECT_EQ(choice_of([](double, int row) { return row < 100 ? 50. : 0.5; }).plans.size(), 1u);
}

bool says(const ExposureChoice& choice, const std::string& words) {
  return std::any_of(choice.unreached.begin(), choice.unreached.end(),
                     [&](const std::string& sentence) { return sentence.find(words) != std::string::npos; });
}

TEST(ExposurePlan, WhatIsNotReachedIsSaidWithItsRemedy) {
  const ExposureChoice dark =
      choice_of([](double deg, int row) { return deg > 90 && deg < 180 && row > 99 ? 0.6 : 9.; });
  EXPECT_TRUE(says(dark,
                   "hardly seen from 90 to 180 degrees of the table's turn at 16 ms, the longest exposure that the "
                   "frame period allows; choose a slower frame rate, or whiten the object with matting spray."));
  ExposureLimits room = kLimits;
  room.room_limits = true;
  EXPECT_TRUE(says(choice_of([](double, int row) { return row > 99 ? 0.6 : 9.; }, room), "darken the room"));

  ExposureLimits coarse = kLimits;
  coarse.shortest_ms = 1;
  const ExposureChoice bright = choice_of([](double, int) { return 600.; }, coarse);
  EXPECT_TRUE(says(bright, "saturated all around of the table's turn even at 1 ms"));
  EXPECT_TRUE(says(bright, "dim the laser"));
  EXPECT_GE(at_deg(bright.plans[0], 0), 1);

  const ExposureChoice half = choice_of([](double deg, int) { return deg < 180 ? 20. : 0.; });
  EXPECT_TRUE(says(half, "No line is seen from 180 to 360 degrees"));
  EXPECT_EQ(at_deg(half.plans[0], 270), at_deg(half.plans[0], 90)) << "as the nearest that shows something";

  // A bright, a dark, and one so dark that the exposure for the dark one does not show it.
  const ExposureChoice three = choice_of([](double, int row) { return row < 60 ? 900. : row < 130 ? 40. : 1.5; });
  ASSERT_EQ(three.plans.size(), 2u);
  EXPECT_TRUE(says(three, "two exposures are not enough"));
}

TEST(ExposurePlan, TheRoomsLightLeavesLessForTheLine) {
  ExposureLimits lit = kLimits;
  lit.room_levels_per_ms = 40;
  const ExposureChoice choice = choice_of([](double, int) { return 40.; }, lit);
  EXPECT_LE((40 + 40) * at_deg(choice.plans[0], 0), 240);
}

Profile profile_of(const std::vector<LineRow>& rows) {
  Profile profile;
  for (std::size_t k = 0; k < rows.size(); ++k) {
    profile.r_mm.push_back(30 + static_cast<double>(k));
    profile.theta_rad.push_back(1);
    profile.z_mm.push_back(static_cast<double>(k));
    profile.covariance.emplace_back();
    profile.row.push_back(static_cast<std::uint16_t>(k));
  }
  return profile;
}

TEST(BracketedRows, EachPlaceIsKeptInTheTurnThatSeesItWellAndInOneAtLeast) {
  // Peaks of 1 to 5000 levels in the shorter exposure, which the longer one shows by so much brighter.
  for (const double ratio : {2., 4., 8., 64.}) {
    std::vector<LineRow> shorter, longer;
    for (double level = 7; level < 5000; level *= 1.1) {
      const auto row_at = [](double levels) {
        LineRow row;
        row.amplitude = static_cast<float>(std::min(levels, 260.));
        row.status = levels + 40 > 250 ? RowStatus::saturated : RowStatus::found;  // on a room's light of 40
        return row;
      };
      shorter.push_back(row_at(level));
      longer.push_back(row_at(level * ratio));
    }
    Profile in_shorter = profile_of(shorter), in_longer = profile_of(longer);
    for (const std::uint16_t row : in_longer.row) in_longer.colour.push_back({static_cast<std::uint8_t>(row), 1, 1});
    const auto ratio_ns = static_cast<std::int64_t>(1e6 * ratio);
    leave_to_other_exposure(shorter, 1'000'000, ratio_ns, in_shorter);
    leave_to_other_exposure(longer, ratio_ns, 1'000'000, in_longer);
    for (const std::uint16_t row : in_longer.row) EXPECT_NE(longer[row].status, RowStatus::saturated);
    for (std::size_t k = 0; k < shorter.size(); ++k) {
      const auto holds = [&](const Profile& p) { return std::find(p.row.begin(), p.row.end(), k) != p.row.end(); };
      EXPECT_TRUE(holds(in_shorter) || holds(in_longer)) << ratio << ", " << shorter[k].amplitude;
      if (shorter[k].amplitude < 25 && longer[k].status == RowStatus::found && ratio <= 4) {
        EXPECT_FALSE(holds(in_shorter)) << "noisier than in the other turn";
      }
    }
    ASSERT_EQ(in_shorter.size(), in_shorter.row.size());
    for (std::size_t k = 0; k < in_shorter.size(); ++k) EXPECT_EQ(in_shorter.r_mm[k], 30. + in_shorter.row[k]);
    ASSERT_EQ(in_longer.colour.size(), in_longer.size());
    for (std::size_t k = 0; k < in_longer.size(); ++k) EXPECT_EQ(in_longer.colour[k].red, in_longer.row[k]);
    EXPECT_TRUE(in_shorter.colour.empty()) << "had none";
  }
}

TEST(BracketedRows, TheSameExposureLeavesNothingOut) {
  const std::vector<LineRow> rows(5);
  Profile profile = profile_of(rows);
  leave_to_other_exposure(rows, 1'000'000, 1'000'000, profile);
  EXPECT_EQ(profile.size(), 5u);
}

}  // namespace
}  // namespace celadon
