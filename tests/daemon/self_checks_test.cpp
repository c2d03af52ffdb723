// Self-checks against truth: bodies in closed form that turn or move by a known amount between the two looks, errors of
// known harmonics.

#include "daemon/checks/self_checks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>

#include "daemon/checks/error_harmonics.h"
#include "daemon/checks/overlap_comparison.h"
#include "daemon/profile_log.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

using Body = std::function<double(double theta_rad, double z_mm)>;
double freeform(double t, double z) {
  return 33 + 2.4 * std::cos(3 * t + 0.01 * z) + 0.5 * std::sin(2 * t + 0.02 * z);
}
double round_body(double, double z) {
  return 30 + 2 * std::sin(z / 20);
}

struct Looks {
  double turned_deg = 0, shifted_mm = 0;
  double noise_mm = 0.02, profile_noise_mm = 0;
  int profiles = 1200, rows = 300;
  unsigned seed = 1;
};

// What a scan of a body sees at the beginning and beyond the end of its turn.
OverlapResult compared(const Body& body, const Looks& looks) {
  std::mt19937 random(looks.seed);
  std::normal_distribution<double> normal;
  OverlapComparison comparison;
  const double pitch = 360 * kDegree / looks.profiles;
  const auto profile_at = [&](double angle_rad, double shift_mm) {
    Profile p;
    const double common = looks.profile_noise_mm * normal(random);
    for (int row = 0; row < looks.rows; ++row) {
      const double z = 0.3 * row;
      p.row.push_back(static_cast<std::uint16_t>(row));
      p.z_mm.push_back(z);
      p.theta_rad.push_back(-angle_rad);
      p.r_mm.push_back(body(angle_rad, z) + shift_mm + common + looks.noise_mm * normal(random));
    }
    return p;
  };
  for (int k = 0; k * pitch <= OverlapComparison::kFirstLook_rad; ++k)
    comparison.first(k * pitch, profile_at(k * pitch, 0));
  for (int k = 0; k < std::max(4, looks.profiles / 60); ++k) {
    const double beyond = (k + 0.4) * pitch;
    comparison.again(beyond, profile_at(beyond + looks.turned_deg * kDegree, looks.shifted_mm));
  }
  return comparison.result();
}

TEST(OverlapComparison, FindsTheTurnOfAFreeformBody) {
  for (const double turned_deg : {0., 0.02, -0.5, 2., -2., 3.6, 9.}) {
    const OverlapResult found = compared(freeform, {.turned_deg = turned_deg});
    ASSERT_EQ(found.missing, "");
    EXPECT_NEAR(found.turn_rad / kDegree, turned_deg, 5 * found.turn_u_rad / kDegree + 1e-3) << turned_deg;
    EXPECT_LT(found.turn_u_rad / kDegree, 0.01);
    EXPECT_NEAR(found.noise_mm, 0.02, 0.001);
  }
}

TEST(OverlapComparison, FindsAShiftAndTellsItFromATurn) {
  const OverlapResult shifted = compared(freeform, {.shifted_mm = 0.3});
  EXPECT_NEAR(shifted.shift_mm, 0.3, 5 * shifted.shift_u_mm);
  EXPECT_EQ(shifted.cause, OverlapResult::Cause::shift);
  const OverlapResult turned = compared(freeform, {.turned_deg = 2});
  EXPECT_EQ(turned.cause, OverlapResult::Cause::turn);
}

TEST(OverlapComparison, ARoundBodyShowsNoTurn) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const OverlapResult found = compared(round_body, {.turned_deg = 5, .seed = seed});
    EXPECT_GT(4 * found.turn_u_rad / kDegree, 0.25) << seed;
    EXPECT_NEAR(found.shift_mm, 0, 5 * found.shift_u_mm) << seed;
  }
}

// Also where the errors of a profile's samples are not independent, which only the scatter of the profiles shows.
TEST(OverlapComparison, UncertaintiesAreThoseOfItsErrors) {
  constexpr int kSeeds = 100;
  for (const double common : {0., 0.005}) {
    double turn = 0, shift = 0;
    for (unsigned seed = 1; seed <= kSeeds; ++seed) {
      Looks looks{.turned_deg = 0.1, .profile_noise_mm = common, .rows = 100, .seed = seed};
      const OverlapResult turned = compared(freeform, looks);
      turn += std::pow((turned.turn_rad - 0.1 * kDegree) / turned.turn_u_rad, 2) / kSeeds;
      looks.turned_deg = 0;
      const OverlapResult still = compared(freeform, looks);
      shift += std::pow(still.shift_mm / still.shift_u_mm, 2) / kSeeds;
    }
    for (const double ratio : {std::sqrt(turn), std::sqrt(shift)}) {
      EXPECT_LT(ratio, 1.2) << common;
      EXPECT_GT(ratio, 0.5) << common;
    }
  }
}

// Two lasers and two stops of the head: rows show other places in each turn, and one of four does not close.
TEST(CompareOverlap, JudgesEachTurnByItself) {
  const testing::TemporaryFolder folder;
  for (const double shift_mm : {0.0, 0.3}) {
    const auto file = folder / ("log" + std::to_string(shift_mm));
    auto log = ProfileLogWriter::create(file, {});
    ASSERT_TRUE(log) << log.error().message;
    std::mt19937 random(3);
    std::normal_distribution<double> normal;
    constexpr int kProfiles = 400, kOverlap = 8;
    constexpr double kPitch = 2 * std::numbers::pi / kProfiles;
    for (int turn = 0; turn < 4; ++turn) {
      (*log)->append(LogStop{{turn / 2 * 0.3, 0}});
      for (int k = 0; k < kProfiles + kOverlap; ++k) {
        Profile p;
        p.laser = static_cast<std::uint8_t>(turn % 2);
        p.table_angle_rad = 7 * turn + k * kPitch;
        const double moved = k >= kProfiles && turn == 2 ? shift_mm : 0;
        for (int row = 0; row < 100; ++row) {
          p.row.push_back(static_cast<std::uint16_t>(row));
          p.z_mm.push_back(row + 20 * turn);
          p.theta_rad.push_back(-p.table_angle_rad);
          p.r_mm.push_back(freeform(k * kPitch, row + 20 * turn) + moved + 0.02 * normal(random));
        }
        ASSERT_TRUE((*log)->append(p, k >= kProfiles));
      }
    }
    ASSERT_TRUE((*log)->finish(LogOutcome::complete, ""));
    const OverlapResult result = compare_overlap(file);
    ASSERT_EQ(result.missing, "");
    EXPECT_NEAR(result.shift_mm, shift_mm, 0.02);
  }
}

TEST(OverlapComparison, FewProfilesCompareNothing) {
  EXPECT_NE(compared(freeform, {.profiles = 60}).missing, "");
}

// r = 30 all around and 60 mm high.
RangeFit round_fit() {
  BaseSurface base;
  base.band_start = 0;
  base.band_end = 60;
  RangeFit fit;
  fit.function = RangeFunction(base, 0, 0, {0, 1}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 30));
  fit.surface = symbolic_product(fit.function);
  fit.report.model = SurfaceModel::cylinder;
  fit.report.points = 500'000;
  fit.report.noise_mm = 0.02;
  fit.report.kappa = 4;
  fit.report.coverage = 1;
  fit.geometric_errors = ErrorMap(base);
  return fit;
}

void miss(RangeFit& fit, const std::function<double(double theta_rad)>& error_mm) {
  const BaseSurface& base = fit.function.base();
  for (int j = 0; j < 1440; ++j) {
    const double theta = 2 * std::numbers::pi * (j + 0.5) / 1440;
    for (int i = 0; i < 60; ++i) fit.geometric_errors.add(base.arcs.v_of_theta(theta), i + 0.5, error_mm(theta));
  }
}

const SelfCheck& named(const std::vector<SelfCheck>& checks, const std::string& name) {
  const auto found = std::find_if(checks.begin(), checks.end(), [&](const auto& c) { return c.name == name; });
  if (found == checks.end()) throw std::runtime_error("no check " + name);
  return *found;
}

Calibration calibrated(double systematic_mm) {
  Calibration calibration;
  calibration.lasers = {LaserPlane{}};
  calibration.systematic_mm = systematic_mm;
  return calibration;
}

std::vector<SelfCheck> checked(const RangeFit& fit, const OverlapResult& overlap, double systematic_mm = 0.005,
                               std::optional<AgreementError> lasers = std::nullopt) {
  return self_checks({BodyFit{fit}, calibrated(systematic_mm), overlap, ClosureError{0.001, 0.026, 20'000}, lasers});
}

TEST(SelfChecks, HarmonicsOfARoundBodyAreThoseOfItsErrors) {
  RangeFit fit = round_fit();
  miss(fit,
       [](double t) { return 0.003 + 0.008 * std::cos(t - 1) + 0.03 * std::sin(2 * t) + 0.002 * std::cos(9 * t); });
  const auto checks = checked(fit, compared(round_body, {}));
  const SelfCheck &first = named(checks, "harmonic_1"), &second = named(checks, "harmonic_2");
  EXPECT_NEAR(*first.value, 0.008, 1e-4);
  EXPECT_EQ(first.verdict, CheckVerdict::passed);
  EXPECT_NEAR(*second.value, 0.03, 1e-4);
  EXPECT_EQ(second.verdict, CheckVerdict::failed);
  EXPECT_NE(second.cause, "");
  EXPECT_NE(second.remedy, "");
  // 0.02 sqrt(2 * 4 / 500000); four of them and twice 0.005
  EXPECT_NEAR(*second.standard_uncertainty, 8e-5, 1e-9);
  EXPECT_NEAR(*second.limit, std::hypot(3.2e-4, 0.01), 1e-9);
  EXPECT_NEAR(*named(checks, "steadiness").value, 0.002 / std::numbers::sqrt2, 2e-4);
  EXPECT_EQ(named(checks, "steadiness").verdict, CheckVerdict::passed);
}

TEST(SelfChecks, RockingIsToldBySteadiness) {
  RangeFit fit = round_fit();
  miss(fit, [](double t) { return 0.1 * std::sin(31 * t); });
  EXPECT_EQ(named(checked(fit, compared(round_body, {})), "steadiness").verdict, CheckVerdict::failed);
}

/// What two lasers differ by, mean and root mean square in mm, over 400 cells of noise 0.01 mm.
AgreementError differing(double bias, double rms) {
  AgreementError e;
  e.first = 0;
  e.second = 1;
  e.bias = bias;
  e.bias_sd = 0.001;
  e.rms = rms;
  e.noise = 0.01;
  e.cells = 400;
  return e;
}

// A dent, or edges that the surface cannot follow, are in some places; what shakes does so all around.
TEST(SelfChecks, WhatIsOffInSomePlacesIsNoShaking) {
  RangeFit fit = round_fit();
  miss(fit, [](double t) { return std::abs(std::sin(5 * t)) < 0.15 ? 0.3 : 0; });
  EXPECT_EQ(named(checked(fit, compared(round_body, {})), "steadiness").verdict, CheckVerdict::passed);
}

std::vector<double> sine_around(double amplitude_mm, int cycles) {
  std::vector<double> around;
  for (int j = 0; j < 180; ++j) around.push_back(amplitude_mm * std::sin(2 * kDegree * cycles * (j + 0.5)));
  return around;
}

// Two turns differ by what shook, and not by what the surface misses.
TEST(SelfChecks, TwoTurnsTellShakingWhateverTheSurfaceMisses) {
  RangeFit fit = round_fit();
  fit.report.model = SurfaceModel::general;
  miss(fit, [](double t) { return 0.1 * std::sin(31 * t); });
  AgreementError turns = differing(0, 0.01);
  turns.around = sine_around(0, 31);
  turns.around_noise = 0.002;
  const OverlapResult overlap = compared(round_body, {});
  EXPECT_EQ(named(checked(fit, overlap, 0.005, turns), "steadiness").verdict, CheckVerdict::passed);
  turns.around = sine_around(0.1, 31);
  const auto shaken = checked(fit, overlap, 0.005, turns);
  EXPECT_EQ(named(shaken, "steadiness").verdict, CheckVerdict::failed);
  EXPECT_NEAR(*named(shaken, "steadiness").value, 0.05, 0.002);  // of one turn
}

// A free form may have followed what rocks, and its errors then say nothing.
TEST(SelfChecks, OfAFreeFormSteadinessIsNotPassedInOneTurn) {
  RangeFit fit = round_fit();
  fit.report.model = SurfaceModel::general;
  miss(fit, [](double) { return 0; });
  const OverlapResult overlap = compared(round_body, {});
  EXPECT_EQ(named(checked(fit, overlap), "steadiness").verdict, CheckVerdict::not_verifiable);
  miss(fit, [](double t) { return 0.1 * std::sin(31 * t); });
  EXPECT_EQ(named(checked(fit, overlap), "steadiness").verdict, CheckVerdict::failed);
}

TEST(SelfChecks, JitterIsJudgedByItself) {
  RangeFit fit = round_fit();
  miss(fit, [](double) { return 0; });
  const BodyFit body{fit};
  const Calibration calibration = calibrated(0.005);
  CheckedScan scan{body, calibration, compared(round_body, {}), std::nullopt};
  EXPECT_EQ(named(self_checks(scan), "jitter").verdict, CheckVerdict::not_verifiable);
  scan.jitter = JitterResult{0.004, 0.003, 0.0005, 300};
  EXPECT_EQ(named(self_checks(scan), "jitter").verdict, CheckVerdict::passed);
  scan.jitter->mm = 0.02;
  EXPECT_EQ(named(self_checks(scan), "jitter").verdict, CheckVerdict::failed);
  EXPECT_EQ(named(self_checks(scan), "steadiness").verdict, CheckVerdict::passed);
}

TEST(SelfChecks, WhatAnObjectCannotShowIsNotPassed) {
  RangeFit fit = round_fit();
  miss(fit, [](double) { return 0; });
  const auto checks = checked(fit, compared(round_body, {.turned_deg = 3.6}));
  EXPECT_EQ(named(checks, "turn").verdict, CheckVerdict::not_verifiable);
  EXPECT_FALSE(named(checks, "turn").value);
  EXPECT_EQ(named(checks, "closure").verdict, CheckVerdict::passed);
  fit.report.model = SurfaceModel::general;
  const auto general = checked(fit, compared(freeform, {.profiles = 60}));
  for (const char* name : {"closure", "turn", "harmonic_1", "harmonic_2"}) {
    EXPECT_EQ(named(general, name).verdict, CheckVerdict::not_verifiable) << name;
    EXPECT_NE(named(general, name).note, "") << name;
  }
}

TEST(SelfChecks, AWrongTurnIsNamedInDegrees) {
  RangeFit fit = round_fit();
  miss(fit, [](double) { return 0; });
  const auto checks = checked(fit, compared(freeform, {.turned_deg = 3.6}));
  const SelfCheck& turn = named(checks, "turn");
  EXPECT_EQ(turn.verdict, CheckVerdict::failed);
  EXPECT_EQ(turn.unit, "deg/turn");
  EXPECT_NEAR(*turn.value, 3.6, 0.02);
  EXPECT_NE(turn.cause.find("1.00 %"), std::string::npos) << turn.cause;
  // A camera that was moved is no wrong turn.
  const auto moved = checked(fit, compared(freeform, {.shifted_mm = 0.5}));
  EXPECT_EQ(named(moved, "closure").verdict, CheckVerdict::failed);
  EXPECT_EQ(named(moved, "turn").verdict, CheckVerdict::not_verifiable);
}

// A circle beside the axis has nearly one slope over the few degrees that are seen twice.
TEST(SelfChecks, WhatATurnAndAShiftExplainAlikeIsToldAsEither) {
  RangeFit fit = round_fit();
  miss(fit, [](double) { return 0; });
  const Body beside = [](double t, double) { return 25 + 6.7 * std::cos(t + 1.4); };
  const auto checks = checked(fit, compared(beside, {.turned_deg = -0.36}));
  EXPECT_EQ(named(checks, "closure").verdict, CheckVerdict::failed);
  EXPECT_NE(named(checks, "closure").cause.find("look alike"), std::string::npos) << named(checks, "closure").cause;
  EXPECT_EQ(named(checks, "turn").verdict, CheckVerdict::not_verifiable);
  EXPECT_NE(named(checks, "turn").note.find("look alike"), std::string::npos) << named(checks, "turn").note;
}

TEST(SelfChecks, LasersAreJudgedWhereTheyWereCompared) {
  RangeFit fit = round_fit();
  miss(fit, [](double) { return 0; });
  const OverlapResult overlap = compared(round_body, {});
  const auto one = checked(fit, overlap);
  EXPECT_TRUE(std::none_of(one.begin(), one.end(), [](const auto& c) { return c.name == "laser_agreement"; }));
  const auto agreed = checked(fit, overlap, 0.005, differing(0.004, 0.012));
  EXPECT_EQ(named(agreed, "laser_agreement").verdict, CheckVerdict::passed);
  EXPECT_EQ(named(agreed, "laser_scatter").verdict, CheckVerdict::passed);
  const auto plane = checked(fit, overlap, 0.005, differing(0.1, 0.1));
  EXPECT_EQ(named(plane, "laser_agreement").verdict, CheckVerdict::failed);
  EXPECT_NE(named(plane, "laser_agreement").cause.find("the plane of laser 0 or 1"), std::string::npos);
  // No difference on average, and yet: 3 hypot(0.01, 0.005 sqrt(2)) = 0.0367
  AgreementError moved = differing(0, 0.038);
  moved.shift = 0.05;
  const auto object = checked(fit, overlap, 0.005, moved);
  EXPECT_EQ(named(object, "laser_agreement").verdict, CheckVerdict::passed);
  EXPECT_EQ(named(object, "laser_scatter").verdict, CheckVerdict::failed);
  EXPECT_NE(named(object, "laser_scatter").cause.find("the object moved"), std::string::npos);
  EXPECT_NEAR(*named(object, "laser_scatter").limit, 0.03674, 1e-5);
}

// What lasers differ by is told by their own check; beside holes the surface errs by itself.
TEST(SelfChecks, LasersAndHolesAreNoShaking) {
  RangeFit fit = round_fit();
  miss(fit, [](double theta) { return std::fmod(theta, 0.2) < 0.1 ? 0.05 : -0.05; });
  const OverlapResult overlap = compared(round_body, {});
  EXPECT_EQ(named(checked(fit, overlap), "steadiness").verdict, CheckVerdict::failed);
  const auto two = checked(fit, overlap, 0.005, differing(0.1, 0.1));
  EXPECT_EQ(named(two, "steadiness").verdict, CheckVerdict::not_verifiable);
  EXPECT_EQ(named(two, "laser_agreement").verdict, CheckVerdict::failed);
  fit.report.coverage = 0.9;
  EXPECT_EQ(named(checked(fit, overlap), "steadiness").verdict, CheckVerdict::not_verifiable);
}

TEST(SelfChecks, JsonComesBack) {
  const std::vector<SelfCheck> checks{
      {"turn", "deg/turn", 3.6, 0.01, 0.04, CheckVerdict::failed, "noted", "a belt", "tighten it"},
      {"closure", "mm", {}, {}, {}, CheckVerdict::not_verifiable, "why", {}, {}}};
  const auto json = nlohmann::json::parse(to_json(checks).dump());
  EXPECT_EQ(json[0]["verdict"], "failed");
  EXPECT_EQ(json[1]["verdict"], "not verifiable");
  EXPECT_TRUE(json[1]["value"].is_null());
  const auto back = self_checks_from_json(json);
  ASSERT_EQ(back.size(), 2u);
  EXPECT_EQ(to_json(back), to_json(checks));
  EXPECT_EQ(sentence_of(back[0]),
            "turn: 3.6 deg/turn (standard uncertainty 0.01 deg/turn, limit 0.04 deg/turn): a belt; tighten it.");
  auto wrong = json;
  wrong[0]["verdict"] = "fine";
  EXPECT_THROW(self_checks_from_json(wrong), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
