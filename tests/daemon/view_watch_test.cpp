// What a dry turn says of an object's view, against lines made by hand.

#include "daemon/view_watch.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

namespace celadon {
namespace {

constexpr int kRows = 200, kProfiles = 96;

struct Seen {
  std::function<int(double deg)> first_row = [](double) { return 20; };  ///< the object's top
  std::function<int(double deg)> end_row = [](double) { return 180; };
  std::function<float(double deg, int row)> amplitude = [](double, int) { return 150.f; };
};

ViewReading reading_of(const Seen& seen) {
  ViewWatch watch;
  for (int k = 0; k < kProfiles; ++k) {
    const double deg = (k + 0.5) * 360 / kProfiles;
    std::vector<LineRow> rows(kRows);
    Profile profile;
    for (int row = seen.first_row(deg); row < seen.end_row(deg); ++row) {
      LineRow& line = rows[static_cast<std::size_t>(row)];
      line.amplitude = seen.amplitude(deg, row);
      line.status = line.amplitude > 250 ? RowStatus::saturated : RowStatus::found;
      profile.row.push_back(static_cast<std::uint16_t>(row));
      profile.r_mm.push_back(30);
      profile.theta_rad.push_back(deg * std::numbers::pi / 180);
      profile.z_mm.push_back(kRows - row);  // rows count downwards
    }
    watch.see(rows, profile);
  }
  return watch.reading();
}

std::vector<SelfCheck> checks_of(const Seen& seen, double exposure_ms = 4, double longest_ms = 20) {
  const ViewReading reading = reading_of(seen);
  return view_checks(reading, exposure_advice(reading, exposure_ms, longest_ms));
}

TEST(ViewWatch, AnObjectInViewPasses) {
  const auto checks = checks_of({});
  ASSERT_EQ(checks.size(), 2u);
  for (const SelfCheck& check : checks) EXPECT_EQ(check.verdict, CheckVerdict::passed) << check.name;
  const ViewReading reading = reading_of({});
  for (const ViewSector& s : reading.sectors) {
    EXPECT_EQ(s.profiles, 4u);
    EXPECT_EQ(s.rows, 4u * 160);
    EXPECT_EQ(s.amplitude, 150);
  }
  EXPECT_EQ(reading.bright_level, 150);
}

TEST(ViewWatch, WhatRunsOutOfThePictureIsNamedWithItsAngles) {
  // Across theta = 0: a stretch that begins before 360 degrees and ends after them.
  const auto tall =
      checks_of({.first_row = [](double deg) { return std::cos(deg * std::numbers::pi / 180) > 0.8 ? 0 : 20; }});
  EXPECT_EQ(tall[0].verdict, CheckVerdict::failed);
  EXPECT_NE(tall[0].cause.find("higher than the picture from 315 to 45 degrees"), std::string::npos) << tall[0].cause;
  EXPECT_NE(tall[0].remedy.find("--lifts"), std::string::npos);
  EXPECT_NEAR(*tall[0].value, 100. * 20 / 96, 2.1);
  const auto deep = checks_of({.end_row = [](double) { return kRows; }});
  EXPECT_NE(deep[0].cause.find("ends above the object's foot all around"), std::string::npos) << deep[0].cause;
}

TEST(ViewWatch, TooLongAndTooShortExposuresAreNamedWithABetterOne) {
  const auto glaring = checks_of({.amplitude = [](double deg, int) { return deg > 90 && deg < 120 ? 255.f : 150.f; }});
  EXPECT_EQ(glaring[1].verdict, CheckVerdict::failed);
  EXPECT_NE(glaring[1].cause.find("saturated at 4 ms from 90 to 120 degrees"), std::string::npos) << glaring[1].cause;
  EXPECT_NE(glaring[1].remedy.find("2.4 ms"), std::string::npos) << glaring[1].remedy;
  const auto dark = checks_of({.amplitude = [](double, int) { return 10.f; }});
  EXPECT_NE(dark[1].cause.find("hardly seen at 4 ms all around"), std::string::npos) << dark[1].cause;
  EXPECT_NE(dark[1].remedy.find("16 ms"), std::string::npos) << dark[1].remedy;
  const auto both = checks_of({.amplitude = [](double deg, int) { return deg < 180 ? 255.f : 8.f; }});
  EXPECT_NE(both[1].remedy.find("matting spray"), std::string::npos) << both[1].remedy;
}

TEST(ViewWatch, TheBetterExposureBringsBrightPlacesToTwoHundredLevels) {
  const ViewReading dim = reading_of({.amplitude = [](double, int row) { return row < 120 ? 20.f : 50.f; }});
  const ExposureAdvice longer = exposure_advice(dim, 4, 100);
  EXPECT_FALSE(longer.is_good);
  EXPECT_NEAR(longer.better_ms, 4 * 200. / 50, 1e-9);
  EXPECT_NEAR(exposure_advice(dim, 4, 10).better_ms, 10, 1e-9) << "the frame period";
  EXPECT_TRUE(exposure_advice(reading_of({}), 4, 100).is_good);
}

TEST(ViewWatch, NothingSeenIsNoSector) {
  ViewWatch watch;
  watch.see(std::vector<LineRow>(kRows), {});
  for (const ViewSector& s : watch.reading().sectors) EXPECT_EQ(s.profiles, 0u);
}

}  // namespace
}  // namespace celadon
