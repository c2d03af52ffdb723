// Artefacts measured in synthetic samples: against closed forms, with false certificates, and with parts missing.

#include "daemon/checks/acceptance.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <numeric>

#include "tests/acquisition/test_calibration.h"
#include "tests/daemon/synthetic_artefact.h"

namespace celadon {
namespace {

using Eigen::Vector3d;

/// Without a joint covariance: a scale and a shift of all radii are not known.
Calibration calibrated(double scale_u, double systematic_mm) {
  Calibration c = test_calibration();
  c.scale = {1, scale_u};
  c.systematic_mm = systematic_mm;
  return c;
}

/// The points for which `keep` says so.
ScannedPoints only(const ScannedPoints& points, const std::function<bool(const Vector3d&)>& keep) {
  ScannedPoints out;
  std::vector<Eigen::Index> kept;
  for (Eigen::Index i = 0; i < points.p_mm.cols(); ++i) {
    if (!keep(points.p_mm.col(i))) continue;
    kept.push_back(i);
    out.table_angle_rad.push_back(points.table_angle_rad[static_cast<std::size_t>(i)]);
    out.laser.push_back(0);
  }
  out.p_mm = points.p_mm(Eigen::all, kept);
  return out;
}

Vector3d stands_at(const Stand& stand, const Vector3d& p) {
  return Eigen::AngleAxisd(stand.turn_rad, Vector3d::UnitZ()) * p + stand.shift_mm;
}

/// Generous for the synthetic noise.
void permit(Artefact& artefact) {
  for (const Characteristic c : kCharacteristics) artefact.permissible.of(c) = 0.15;
}

const AcceptanceItem& item_of(const Acceptance& acceptance, Characteristic what, const std::string& where) {
  return *std::find_if(acceptance.items.begin(), acceptance.items.end(),
                       [&](const AcceptanceItem& i) { return i.what == what && i.where == where; });
}

Acceptance judged(const Artefact& artefact, const ScannedPoints& points,
                  const Calibration& calibration = calibrated(1e-4, 0.005)) {
  const auto measured = measure_artefact(artefact, points, calibration);
  if (!measured) throw std::runtime_error(measured.error());
  return judge_acceptance(artefact, *measured);
}

std::string all_findings(const Acceptance& acceptance) {
  return std::accumulate(acceptance.findings.begin(), acceptance.findings.end(), std::string(),
                         [](const std::string& a, const std::string& b) { return a + b + "\n"; });
}

// Without noise sizes, spacings and forms are exact, wherever it stands.
TEST(Acceptance, ExactSamplesAreExact) {
  Random random(1);
  for (int seed = 0; seed < 12; ++seed) {
    const Artefact artefact = random_artefact(random, 2 + seed % 3);
    const Stand stand = random_stand(random);
    const Acceptance acceptance = judged(artefact, samples_of(artefact, stand, random, {0, 0}));
    for (const AcceptanceItem& item : acceptance.items) {
      ASSERT_EQ(item.verdict, AcceptanceVerdict::not_judged) << item.where << ": " << item.note;
      EXPECT_NEAR(item.error(), 0, 1e-6) << to_string(item.what) << " " << item.where;
    }
    EXPECT_TRUE(acceptance.findings.empty()) << all_findings(acceptance);
    EXPECT_TRUE(acceptance.passed());
    for (std::size_t i = 0; i < artefact.spheres.size(); ++i) {
      EXPECT_NEAR(
          (acceptance.measurement.spheres[i].centre_mm - stands_at(stand, artefact.spheres[i].centre_mm)).norm(), 0,
          1e-6);
    }
    EXPECT_NEAR((acceptance.measurement.placement.shift_mm - stand.shift_mm).norm(), 0, 1e-6);
  }
}

// 120 artefacts, placements, certificates and calibrations, each with its own errors: how often U holds them.
TEST(Acceptance, TheStatedUncertaintyCoversSizesAndSpacings) {
  Random random(2);
  std::normal_distribution<double> normal;
  constexpr double kScale = 2e-4, kSystematic_mm = 0.004, kCertificate_mm = 0.003;
  int covered = 0, all = 0;
  for (int seed = 0; seed < 120; ++seed) {
    const Artefact truth = random_artefact(random);
    ScannedPoints points = samples_of(truth, random_stand(random), random, {0.02, 0.02});
    const double scale = 1 + kScale * normal(random), shift_mm = kSystematic_mm * normal(random);
    for (Eigen::Index i = 0; i < points.p_mm.cols(); ++i) {
      Vector3d p = points.p_mm.col(i);
      p.head<2>() *= 1 + shift_mm / p.head<2>().norm();
      points.p_mm.col(i) = scale * p;
    }
    Artefact certified = truth;
    for (CertifiedSphere& sphere : certified.spheres) {
      sphere.diameter = {sphere.diameter.value + kCertificate_mm * normal(random), kCertificate_mm};
    }
    for (CertifiedSpacing& spacing : certified.spacings) {
      spacing.distance = {spacing.distance.value + kCertificate_mm * normal(random), kCertificate_mm};
    }
    for (const AcceptanceItem& item : judged(certified, points, calibrated(kScale, kSystematic_mm)).items) {
      if (item.what != Characteristic::size && item.what != Characteristic::spacing) continue;
      ASSERT_NE(item.verdict, AcceptanceVerdict::not_verifiable) << item.note;
      covered += std::abs(item.error()) <= item.U();
      ++all;
    }
  }
  EXPECT_EQ(all, 720);
  const double share = static_cast<double>(covered) / all;
  RecordProperty("covered_percent", std::to_string(100 * share));
  std::printf("U (k = 2) covers %.1f %% of %d errors of size and spacing\n", 100 * share, all);
  EXPECT_GT(share, 0.92);
  EXPECT_LT(share, 0.98);
}

// Forms are widths of the noise: 95 % of normal errors lie within 3.92 standard deviations.
TEST(Acceptance, FormsAreWidthsOfTheNoise) {
  Random random(3);
  const Artefact artefact = random_artefact(random);
  const Acceptance acceptance = judged(artefact, samples_of(artefact, random_stand(random), random, {0.02, 0}));
  // The noise lies along the rays; perpendicular to the flat, which faces them, nearly all of it shows.
  const AcceptanceItem& flat95 = item_of(acceptance, Characteristic::flatness95, "flat");
  EXPECT_NEAR(flat95.measured, 3.92 * 0.02, 0.01);
  EXPECT_GT(item_of(acceptance, Characteristic::flatness, "flat").measured, 5 * 0.02);
  EXPECT_GT(flat95.u_scatter, 0.0002);
  EXPECT_LT(flat95.u_scatter, 0.01);
  const AcceptanceItem& form95 = item_of(acceptance, Characteristic::form95, "A");
  EXPECT_LT(form95.measured, 3.92 * 0.02);
  EXPECT_GT(form95.measured, 2 * 0.02);
  EXPECT_GT(item_of(acceptance, Characteristic::form, "A").measured, form95.measured);
}

// A dent of 0.3 mm shows in the form of all points, and hardly in that of 95 %.
TEST(Acceptance, ADentShows) {
  Random random(4);
  Artefact artefact = random_artefact(random);
  permit(artefact);
  const Stand stand = random_stand(random);
  ScannedPoints points = samples_of(artefact, stand, random, {0.01, 0});
  const Vector3d centre = stands_at(stand, artefact.spheres[1].centre_mm);
  const Vector3d outward = Vector3d(centre.x(), centre.y(), 0).normalized();
  for (Eigen::Index i = 0; i < points.p_mm.cols(); ++i) {
    const Vector3d n = (points.p_mm.col(i) - centre).normalized();
    if ((points.p_mm.col(i) - centre).norm() < 20 && n.dot(outward) > 0.97) points.p_mm.col(i) -= 0.3 * n;
  }
  const Acceptance acceptance = judged(artefact, points);
  EXPECT_EQ(item_of(acceptance, Characteristic::form, "B").verdict, AcceptanceVerdict::does_not_conform)
      << acceptance_text(acceptance);
  EXPECT_EQ(item_of(acceptance, Characteristic::form95, "B").verdict, AcceptanceVerdict::conforms);
  EXPECT_EQ(item_of(acceptance, Characteristic::form, "A").verdict, AcceptanceVerdict::conforms);
  EXPECT_FALSE(acceptance.passed());
}

TEST(Acceptance, FalseCertificatesAreNamed) {
  Random random(5);
  for (int seed = 0; seed < 10; ++seed) {
    Artefact artefact = random_artefact(random);
    permit(artefact);
    const ScannedPoints points = samples_of(artefact, random_stand(random), random, {0.01, 0.01});
    const Acceptance good = judged(artefact, points);
    EXPECT_TRUE(good.passed()) << acceptance_text(good);
    EXPECT_TRUE(good.findings.empty()) << all_findings(good);

    Artefact wrong = artefact;
    wrong.spheres[1].diameter.value += 0.2;
    const Acceptance of_size = judged(wrong, points);
    for (const AcceptanceItem& item : of_size.items) {
      const bool is_wrong = item.what == Characteristic::size && item.where == "B";
      EXPECT_EQ(item.verdict, is_wrong ? AcceptanceVerdict::does_not_conform : AcceptanceVerdict::conforms)
          << to_string(item.what) << " " << item.where;
    }
    ASSERT_EQ(of_size.findings.size(), 1u) << all_findings(of_size);
    EXPECT_NE(of_size.findings[0].find("ball B stands apart from the others by -"), std::string::npos)
        << of_size.findings[0];

    wrong = artefact;
    wrong.spacings[2].distance.value -= 0.2;
    const Acceptance of_spacing = judged(wrong, points);
    EXPECT_EQ(item_of(of_spacing, Characteristic::spacing, "B-C").verdict, AcceptanceVerdict::does_not_conform);
    EXPECT_EQ(item_of(of_spacing, Characteristic::spacing, "A-B").verdict, AcceptanceVerdict::conforms);
    ASSERT_EQ(of_spacing.findings.size(), 1u) << all_findings(of_spacing);
    EXPECT_NE(of_spacing.findings[0].find("B-C stands apart from the others by +"), std::string::npos)
        << of_spacing.findings[0];
  }
}

TEST(Acceptance, AWrongScaleIsNamedAndNotTheBalls) {
  Random random(6);
  for (const double scale : {1.003, 0.997}) {
    Artefact artefact = random_artefact(random);
    permit(artefact);
    ScannedPoints points = samples_of(artefact, random_stand(random), random, {0.01, 0.01});
    points.p_mm *= scale;
    const Acceptance acceptance = judged(artefact, points);
    EXPECT_FALSE(acceptance.passed());
    ASSERT_EQ(acceptance.findings.size(), 1u) << all_findings(acceptance);
    EXPECT_NE(acceptance.findings[0].find("calibration's scale"), std::string::npos);
    EXPECT_NE(acceptance.findings[0].find(scale > 1 ? "too long" : "too short"), std::string::npos);
    for (const AcceptanceItem& item : acceptance.items) {
      if (item.what != Characteristic::spacing) continue;
      EXPECT_NEAR(item.error() / item.certified, scale - 1, 3e-4);
    }
  }
}

TEST(Acceptance, BallsThatAreExchangedAreNamed) {
  Random random(7);
  for (int seed = 0; seed < 10; ++seed) {
    Artefact truth = random_artefact(random);
    truth.spheres[0].diameter.value = 22;
    truth.spheres[1].diameter.value = 30;
    truth.spheres[2].diameter.value = 26;
    permit(truth);
    Artefact exchanged = truth;
    std::swap(exchanged.spheres[0].diameter, exchanged.spheres[2].diameter);
    const Acceptance acceptance = judged(exchanged, samples_of(truth, random_stand(random), random, {0.01, 0}));
    EXPECT_EQ(item_of(acceptance, Characteristic::size, "A").verdict, AcceptanceVerdict::does_not_conform);
    EXPECT_EQ(item_of(acceptance, Characteristic::size, "C").verdict, AcceptanceVerdict::does_not_conform);
    EXPECT_EQ(item_of(acceptance, Characteristic::size, "B").verdict, AcceptanceVerdict::conforms);
    EXPECT_EQ(item_of(acceptance, Characteristic::spacing, "A-C").verdict, AcceptanceVerdict::conforms);
    EXPECT_NE(all_findings(acceptance).find("that is the diameter of C"), std::string::npos)
        << all_findings(acceptance);
    EXPECT_NE(all_findings(acceptance).find("that is the diameter of A"), std::string::npos);
  }
}

// What is not there, or hidden, is never passed; the rest is judged.
TEST(Acceptance, WhatIsNotSeenIsNotVerifiable) {
  Random random(8);
  for (int seed = 0; seed < 6; ++seed) {
    Artefact artefact = random_artefact(random);
    permit(artefact);
    const Stand stand = random_stand(random);
    const ScannedPoints points = samples_of(artefact, stand, random, {0.01, 0});
    const Vector3d centre = stands_at(stand, artefact.spheres[2].centre_mm);
    const double reach = artefact.spheres[2].diameter.value / 2 + 1;
    const auto expect_without_ball = [&](const ScannedPoints& left) {
      const Acceptance acceptance = judged(artefact, left);
      for (const AcceptanceItem& item : acceptance.items) {
        const bool gone = item.where.find('C') != std::string::npos;
        EXPECT_EQ(item.verdict, gone ? AcceptanceVerdict::not_verifiable : AcceptanceVerdict::conforms)
            << to_string(item.what) << " " << item.where << " " << item.note;
        EXPECT_EQ(item.note.empty(), !gone);
      }
      EXPECT_FALSE(acceptance.passed());
      EXPECT_NE(acceptance_text(acceptance).find("not verifiable"), std::string::npos);
    };
    expect_without_ball(only(points, [&](const Vector3d& p) { return (p - centre).norm() > reach; }));
    // A cap of a tenth of its surface.
    expect_without_ball(only(points, [&](const Vector3d& p) {
      return (p - centre).norm() > reach || p.z() - centre.z() > 0.8 * (reach - 1);
    }));

    const Vector3d flat = stands_at(stand, artefact.flat->centre_mm);
    const Acceptance hidden = judged(
        artefact, only(points, [&](const Vector3d& p) { return (p - flat).norm() > 30 || p.z() < flat.z() - 8; }));
    EXPECT_EQ(item_of(hidden, Characteristic::flatness, "flat").verdict, AcceptanceVerdict::not_verifiable);
    EXPECT_EQ(item_of(hidden, Characteristic::flatness95, "flat").verdict, AcceptanceVerdict::not_verifiable);
    EXPECT_FALSE(hidden.passed());
  }
}

// Two balls that no height and no distance tells apart: exchanged certificates could not be seen.
TEST(Acceptance, AnArtefactThatLooksTheSameTwiceIsRefused) {
  Random random(9);
  Artefact artefact = random_artefact(random, 2);
  artefact.flat.reset();
  artefact.spheres[0].centre_mm = {35, 0, 40};
  artefact.spheres[1].centre_mm = {-35, 0, 40};
  artefact.spheres[0].diameter.value = artefact.spheres[1].diameter.value = 25;
  artefact.spacings = {{0, 1, {70, 0}}};
  const auto measured = measure_artefact(artefact, samples_of(artefact, random_stand(random), random, {0.01, 0}),
                                         calibrated(1e-4, 0.005));
  ASSERT_FALSE(measured);
  EXPECT_NE(measured.error().find("two placements"), std::string::npos) << measured.error();
}

TEST(Acceptance, AnEmptyTableShowsNothing) {
  Random random(10);
  Artefact artefact = random_artefact(random);
  Artefact nothing = artefact;
  nothing.spheres.clear();
  nothing.flat.reset();
  const auto measured = measure_artefact(artefact, samples_of(nothing, {}, random, {0.01, 0}), calibrated(1e-4, 0.005));
  if (!measured) return;  // every placement is as good
  for (const AcceptanceItem& item : judge_acceptance(artefact, *measured).items) {
    EXPECT_EQ(item.verdict, AcceptanceVerdict::not_verifiable) << to_string(item.what) << " " << item.where;
  }
}

// ISO 14253-1: within the limit by U conforms, beyond it by U does not, between them nothing is decided.
TEST(Acceptance, UncertaintyCountsAgainstWhoClaims) {
  Artefact artefact;
  artefact.spheres = {{"A", {0, 0, 0}, {20, 0.01}, 0}, {"B", {50, 0, 0}, {20, 0}, 0}};
  artefact.permissible.of(Characteristic::size) = 0.1;
  ArtefactMeasurement measured;
  measured.spheres.resize(2);
  const auto verdict_at = [&](double error) {
    measured.spheres[0].diameter = {20 + error, 0.006, 0.008};  // with the certificate u = 0.0141
    measured.spheres[1].diameter = {20, 0, 0};
    return item_of(judge_acceptance(artefact, measured), Characteristic::size, "A").verdict;
  };
  for (const double side : {-1.0, 1.0}) {
    EXPECT_EQ(verdict_at(side * 0.071), AcceptanceVerdict::conforms);
    EXPECT_EQ(verdict_at(side * 0.073), AcceptanceVerdict::undecided);
    EXPECT_EQ(verdict_at(side * 0.127), AcceptanceVerdict::undecided);
    EXPECT_EQ(verdict_at(side * 0.129), AcceptanceVerdict::does_not_conform);
  }
}

// It lies anywhere within what is certified: a rectangular distribution of that half width.
TEST(Acceptance, TheArtefactsOwnFormIsUncertain) {
  Artefact artefact;
  artefact.spheres = {{"A", {0, 0, 0}, {20, 0}, 0.012}, {"B", {50, 0, 0}, {20, 0}, 0}};
  ArtefactMeasurement measured;
  measured.spheres.resize(2);
  const Acceptance acceptance = judge_acceptance(artefact, measured);
  for (const Characteristic what : {Characteristic::form, Characteristic::form95}) {
    EXPECT_NEAR(item_of(acceptance, what, "A").u_certificate, 0.0069282, 1e-7);
    EXPECT_EQ(item_of(acceptance, what, "B").u_certificate, 0);
  }
}

TEST(Acceptance, TheReportHasWhatIsJudged) {
  Random random(11);
  Artefact artefact = random_artefact(random);
  artefact.permissible.of(Characteristic::spacing) = 0.2;
  const Acceptance acceptance = judged(artefact, samples_of(artefact, random_stand(random), random, {0.01, 0}));
  LogHeader scan;
  scan.machine = "bench";
  scan.simulated = true;
  const auto json = nlohmann::json::parse(format_acceptance(acceptance, scan, "2026-01-02"));
  EXPECT_EQ(json["format"], "celadon-acceptance");
  EXPECT_EQ(json["version"], 1);
  EXPECT_EQ(json["simulated"], true);
  EXPECT_EQ(json["calibration_date"], "2026-01-02");
  EXPECT_NE(json["manner"].get<std::string>().find("not a certificate"), std::string::npos);
  EXPECT_EQ(json["items"].size(), 14u);  // 3 (form, form95, size), 3 spacings, flat twice
  EXPECT_EQ(json["verdict"], "conforms");
  EXPECT_GT(json["seen"]["A"]["share"], 0.25);
  EXPECT_NE(acceptance_text(acceptance).find("not a certificate"), std::string::npos);
}

}  // namespace
}  // namespace celadon
