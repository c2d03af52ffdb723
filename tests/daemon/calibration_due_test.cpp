// When a calibration is due: by a calendar counted elsewhere, by scans, and by what scans found.

#include "daemon/calibration_due.h"

#include <gtest/gtest.h>

namespace celadon {
namespace {

constexpr std::int64_t kNoon_s = 1'767'268'800;  // 2026-01-01T12:00:00Z, by `date -u +%s`
constexpr std::int64_t kDay_s = 86'400;

Calibration calibrated(const std::string& date) {
  Calibration calibration;
  calibration.date = date;
  return calibration;
}

SelfCheck check(const std::string& name, CheckVerdict verdict) {
  SelfCheck c;
  c.name = name;
  c.verdict = verdict;
  c.cause = "the plane of laser 0 moved";
  return c;
}

class CalibrationDue : public ::testing::Test {
 protected:
  void scan(const std::string& created, std::vector<SelfCheck> checks = {}, ScanState state = ScanState::done) {
    ScanRecord record;
    record.id = scans_.size() + 1;
    record.created = created;
    record.checks = std::move(checks);
    record.state = state;
    scans_.emplace(record.id, record);
  }
  std::vector<std::string> reasons(std::int64_t now_unix_s = kNoon_s,
                                   const std::string& date = "2026-01-01T00:00:00Z") {
    return calibration_due(calibrated(date), limits_, scans_, now_unix_s);
  }

  CalibrationLimits limits_{.days = 10, .scans = 2};
  std::map<std::uint64_t, ScanRecord> scans_;
};

TEST_F(CalibrationDue, ByAge) {
  EXPECT_TRUE(reasons(kNoon_s).empty());
  EXPECT_TRUE(reasons(kNoon_s + 10 * kDay_s).empty());
  const auto late = reasons(kNoon_s + 11 * kDay_s);
  ASSERT_EQ(late.size(), 1u);
  EXPECT_EQ(late.front(),
            "The calibration of 2026-01-01T00:00:00Z is 11 days old, and good for 10; run celadon calibrate.");
  EXPECT_EQ(reasons(kNoon_s, "2025-12-20").size(), 1u) << "a date without a time";
  EXPECT_TRUE(reasons(kNoon_s, "2026-02-28T10:00:00.25Z").empty()) << "a clock that is behind";
  limits_.days = 0;
  EXPECT_TRUE(reasons(kNoon_s + 5000 * kDay_s).empty());
}

TEST_F(CalibrationDue, ByScansThatWereDoneSince) {
  scan("2025-12-31T23:59:59Z");
  scan("2026-01-01T00:00:01Z");
  scan("2026-01-01T00:00:02Z", {}, ScanState::failed);
  scan("2026-01-01T00:00:03Z");
  EXPECT_TRUE(reasons().empty());
  scan("2026-01-01T00:00:04Z");
  const auto used = reasons();
  ASSERT_EQ(used.size(), 1u);
  EXPECT_NE(used.front().find("has served 3 scans, and is good for 2"), std::string::npos) << used.front();
}

TEST_F(CalibrationDue, ByAFailedCheckUntilItPassesAgain) {
  limits_.scans = 0;
  scan("2025-12-31T00:00:00Z", {check("datum_laser 0", CheckVerdict::failed)});
  EXPECT_TRUE(reasons().empty()) << "of the calibration before";
  scan("2026-01-01T01:00:00Z", {check("laser_agreement", CheckVerdict::failed),
                                check("steadiness", CheckVerdict::failed), check("closure", CheckVerdict::failed)});
  scan("2026-01-01T02:00:00Z", {check("laser_agreement", CheckVerdict::not_verifiable)});
  const auto doubted = reasons();
  ASSERT_EQ(doubted.size(), 1u);
  EXPECT_EQ(doubted.front(),
            "The calibration of 2026-01-01T00:00:00Z is doubted by the check 'laser_agreement' of scan 2: the plane of "
            "laser 0 moved; run celadon calibrate.");
  scan("2026-01-01T03:00:00Z", {check("laser_agreement", CheckVerdict::passed)});
  EXPECT_TRUE(reasons().empty());
  scan("2026-01-01T04:00:00Z",
       {check("datum_laser 1", CheckVerdict::failed), check("datum_camera", CheckVerdict::failed)});
  EXPECT_EQ(reasons().size(), 2u);
}

}  // namespace
}  // namespace celadon
