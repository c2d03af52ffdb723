// A known object against its certificate: hand-worked uncertainties, surfaces in closed form.

#include "daemon/checks/reference_check.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "daemon/checks/self_check.h"

namespace celadon {
namespace {

using nlohmann::json;

TEST(Reference, ReadsACertificate) {
  const auto plain = parse_reference("cylinder:D=100,u=0.005");
  ASSERT_TRUE(plain) << plain.error();
  EXPECT_EQ(plain->shape, ReferenceShape::cylinder);
  EXPECT_EQ(plain->diameter_mm, 100);
  EXPECT_EQ(plain->u_mm, 0.005);
  EXPECT_EQ(plain->diameter_then_mm(), 100);
  const auto warm = parse_reference("sphere:U=0.008,D=50,a=1.15e-5,T=24,uT=0.5,form=0.001");
  ASSERT_TRUE(warm) << warm.error();
  EXPECT_EQ(warm->shape, ReferenceShape::sphere);
  EXPECT_EQ(warm->u_mm, 0.004);
  EXPECT_EQ(warm->form_mm, 0.001);
  EXPECT_NEAR(warm->diameter_then_mm(), 50.0023, 1e-12);
  EXPECT_NEAR(warm->u_then_mm(), std::hypot(0.004, 50 * 1.15e-5 * 0.5), 1e-15);
}

TEST(Reference, SaysWhatIsWrong) {
  const std::pair<const char*, const char*> wrong[] = {
      {"", "neither a cylinder nor a sphere"},
      {"cube:D=3,u=0", "neither a cylinder nor a sphere"},
      {"cylinder", "no diameter"},
      {"cylinder:", "none of"},
      {"cylinder:u=0.1", "no diameter"},
      {"cylinder:D=100", "needs its uncertainty once"},
      {"cylinder:D=100,u=0.1,U=0.2", "needs its uncertainty once"},
      {"cylinder:D=100,D=101,u=0.1", "twice"},
      {"cylinder:D=1e9,u=0.1", "1 to 1000 mm"},
      {"cylinder:D=nan,u=0.1", "1 to 1000 mm"},
      {"cylinder:D=100mm,u=0.1", "1 to 1000 mm"},
      {"cylinder:D=100,u=-0.1", "0 to 10 mm"},
      {"cylinder:D=100,u=0.1,T=22", "without its coefficient"},
      {"cylinder:D=100,u=0.1,x=2", "none of"},
  };
  for (const auto& [text, words] : wrong) {
    const auto refused = parse_reference(text);
    ASSERT_FALSE(refused) << text;
    EXPECT_NE(refused.error().find(words), std::string::npos) << refused.error();
  }
}

/// A wall of this radius below and above, on an axis that leans and stands aside.
SurfaceFile wall(double below_mm, double above_mm, double sd_mm = 0.001) {
  BaseSurface base;
  base.band_start = 10;
  base.band_end = 70;
  base.X_WB.translation() << 6, 3, 1;
  base.X_WB.linear() = Eigen::AngleAxisd(0.1, Eigen::Vector3d(1, 2, 0).normalized()).toRotationMatrix();
  Eigen::MatrixXd c(2, 1);
  c << below_mm, above_mm;
  const RangeFunction f(base, 1, 0, {0, 0, 1, 1}, {0, 4}, c);
  return {
      {{f, symbolic_product(f), DeviationMap({10, 70}, {0, 4}, Eigen::MatrixXd::Constant(2, 2, sd_mm))}}, "", "", true};
}

SurfaceFile ball(double radius_mm) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_start = 0.2;
  base.band_end = 1.6;
  base.X_WB.translation() << 1, -2, 40;
  const RangeFunction f(base, 0, 0, {0.2, 1.6}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, radius_mm));
  return {{{f, symbolic_product(f), DeviationMap({0.2, 1.6}, {0, 4}, Eigen::MatrixXd::Constant(2, 2, 0.001))}},
          "",
          "",
          true};
}

json report(double systematic_mm = 0.004, double scale_u = 1e-5) {
  return {{"name", "reference"},
          {"date", "2026-01-02T03:04:05Z"},
          {"simulated", true},
          {"calibration", {{"date", "2026-01-01"}, {"systematic_mm", systematic_mm}, {"scale_u", scale_u}}},
          {"checks", json::array()}};
}

TEST(ReferenceCheck, MeasuresWhatIsThere) {
  const auto cylinder = measure_round(wall(30, 30), ReferenceShape::cylinder);
  ASSERT_TRUE(cylinder) << cylinder.error();
  EXPECT_NEAR(cylinder->diameter_mm, 60, 1e-8);
  EXPECT_NEAR(cylinder->form_mm, 0, 1e-8);
  EXPECT_NEAR(cylinder->fit_u_mm, 0.001, 1e-9);
  // A cone of 0.1 mm: its mean radius, and what 39 of 40 steps of it make.
  const auto cone = measure_round(wall(30, 30.1), ReferenceShape::cylinder);
  ASSERT_TRUE(cone) << cone.error();
  EXPECT_NEAR(cone->diameter_mm, 60.1, 1e-6);
  EXPECT_NEAR(cone->form_mm, 0.1 * 39 / 40, 1e-6);
  const auto sphere = measure_round(ball(25), ReferenceShape::sphere);
  ASSERT_TRUE(sphere) << sphere.error();
  EXPECT_NEAR(sphere->diameter_mm, 50, 1e-8);
  EXPECT_FALSE(measure_round(ball(25), ReferenceShape::cylinder));
  SurfaceFile unknown = wall(30, 30);
  unknown.pieces.front().deviation.reset();
  EXPECT_FALSE(measure_round(unknown, ReferenceShape::cylinder));
}

ReferenceCheck judged(const SurfaceFile& surface, const std::string& reference, const json& of) {
  const auto parsed = parse_reference(reference);
  EXPECT_TRUE(parsed);
  const auto check = check_reference(*parsed, surface, of);
  EXPECT_TRUE(check) << (check ? "" : check.error());
  return *check;
}

TEST(ReferenceCheck, NormalisedErrorIsThatOfHandWork) {
  const auto check = judged(wall(30.01, 30.01), "cylinder:D=60,u=0.003", report());
  // U = 2 * 2 * sqrt(0.001^2 + 0.004^2) = 0.016492; of the reference 0.006; together 0.017550
  EXPECT_NEAR(check.U_mm, 0.016492, 1e-6);
  EXPECT_NEAR(check.U_reference_mm, 0.006, 1e-12);
  EXPECT_NEAR(check.difference_mm, 0.02, 1e-7);
  EXPECT_NEAR(check.normalised_error, 0.02 / 0.017550, 1e-3);
  EXPECT_EQ(check.verdict, ReferenceVerdict::usable);
  ASSERT_EQ(check.findings.size(), 1u);
  EXPECT_NE(check.findings[0].find("+0.0200 mm"), std::string::npos) << check.findings[0];
  EXPECT_EQ(judged(wall(30.005, 30.005), "cylinder:D=60,u=0.003", report()).verdict, ReferenceVerdict::good);
  EXPECT_EQ(judged(wall(30.03, 30.03), "cylinder:D=60,u=0.003", report()).verdict, ReferenceVerdict::refused);
  EXPECT_EQ(judged(ball(25.1), "sphere:D=50,u=0.003", report()).verdict, ReferenceVerdict::refused);
  // A scale that is stated worse than the radius counts in its place: U = 4 sqrt(0.001^2 + 0.03^2)
  EXPECT_NEAR(judged(wall(30, 30), "cylinder:D=60,u=0.003", report(0.004, 1e-3)).U_mm, 0.12007, 1e-4);
  // A stated diameter knows better than both: U = 2 sqrt(0.002^2 + 0.01^2)
  json stated = report(0.004, 1e-3);
  stated["dimensions"] = {{{"name", "diameter"}, {"unit", "mm"}, {"value", 60.0}, {"of_calibration", 0.01}}};
  EXPECT_NEAR(judged(wall(30, 30), "cylinder:D=60,u=0.003", stated).U_mm, 0.020396, 1e-5);
}

TEST(ReferenceCheck, FormUncertaintyAndTheScansOwnChecksCount) {
  // Expected of a perfect cylinder: 6 * 0.001 + 2 * 0.004 = 0.014
  EXPECT_EQ(judged(wall(29.9905, 30.0095), "cylinder:D=60,u=0.003", report()).verdict, ReferenceVerdict::usable);
  EXPECT_EQ(judged(wall(29.9905, 30.0095), "cylinder:D=60,u=0.003,form=0.01", report()).verdict,
            ReferenceVerdict::good);
  EXPECT_EQ(judged(wall(29.95, 30.05), "cylinder:D=60,u=0.003", report()).verdict, ReferenceVerdict::refused);
  EXPECT_EQ(judged(wall(30, 30), "cylinder:D=60,u=0.003", report(0.03)).verdict, ReferenceVerdict::usable);
  EXPECT_EQ(judged(wall(30, 30), "cylinder:D=60,u=0.003", report(0.3)).verdict, ReferenceVerdict::refused);
  json failed = report();
  failed["checks"] =
      json::parse(to_json({{"turn", "deg/turn", 1, 0.1, 0.4, CheckVerdict::failed, "", "c", "r"}}).dump());
  const auto check = judged(wall(30, 30), "cylinder:D=60,u=0.003", failed);
  EXPECT_EQ(check.verdict, ReferenceVerdict::refused);
  EXPECT_NE(check.findings.at(0).find("turn"), std::string::npos);
  json old = report();
  old.erase("calibration");
  const auto refused = check_reference(*parse_reference("cylinder:D=60,u=0.003"), wall(30, 30), old);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().find("calibration"), std::string::npos);
}

TEST(ReferenceCheck, FileHoldsTheJudgement) {
  const auto text = format_check(judged(wall(30.03, 30.03), "cylinder:D=60,u=0.003", report()), report());
  const json file = json::parse(text);
  EXPECT_EQ(file["format"], "celadon-check");
  EXPECT_EQ(file["version"], 1);
  EXPECT_EQ(file["verdict"], "refused");
  EXPECT_EQ(file["simulated"], true);
  EXPECT_EQ(file["calibration_date"], "2026-01-01");
  EXPECT_NEAR(file["measured"]["diameter_mm"].get<double>(), 60.06, 1e-7);
  EXPECT_EQ(file["limits"]["normalised_error"], json({1.0, 1.5}));
  EXPECT_EQ(file["findings"].size(), 1u);
}

}  // namespace
}  // namespace celadon
