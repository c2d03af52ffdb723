// Cylinders whose rims are not plane, against closed forms and the NURBS surface's own derivatives.
#include "fitting/rims.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <numbers>
#include <random>

#include "fitting/common_knots.h"
#include "fitting/nurbs_surface.h"
#include "fitting/solid_properties.h"
#include "tests/fitting/spline_tools.h"

namespace celadon {
namespace {

using std::numbers::pi;

// Heights that wave by a few millimetres about 10 and 70, on random knots.
std::shared_ptr<const RangeFunction> random_heights(std::mt19937_64& random, int degree) {
  const RangeSpace around = test::random_space_v(random, degree);
  Eigen::MatrixXd rims(2, around.extraction().rows());
  for (int row : {0, 1}) {
    const Eigen::VectorXd free = Eigen::VectorXd::NullaryExpr(
        around.free_count(), [&] { return (row == 0 ? 10 : 70) + test::uniform(random, -5, 5); });
    rims.row(row) = (around.extraction() * free).transpose();
  }
  BaseSurface base;
  base.band_start = -1;
  base.band_end = 3;
  return std::make_shared<const RangeFunction>(base, 1, degree, std::vector<double>{0, 0, 1, 1}, around.knots(), rims);
}

RangeFunction random_between_rims(std::mt19937_64& random) {
  const int q = std::uniform_int_distribution<int>(1, 5)(random), p = std::uniform_int_distribution<int>(0, 5)(random);
  BaseSurface base;
  base.heights = random_heights(random, q);
  base.band_start = test::uniform(random, -1, 0);
  base.band_end = test::uniform(random, 2, 3);
  base.X_WB = test::random_placement(random);
  return test::random_function(random, test::random_space_u(random, p),
                               test::random_space_v(random, random() % 3 == 0 ? 0 : q), base, 6);
}

RC_GTEST_PROP(CommonKnots, ChangeNoFunction, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int q = std::uniform_int_distribution<int>(1, 5)(random);
  const auto some = [&](int degree) {
    const RangeSpace space = test::random_space_v(random, degree);
    return SplineRows{degree, space.knots(), Eigen::MatrixXd::Random(2, space.extraction().rows())};
  };
  SplineRows a = some(random() % 4 == 0 ? 0 : q), b = some(q);
  const SplineRows before[] = {a, b};
  share_knots(a, b);
  RC_ASSERT(a.degree == q);
  RC_ASSERT(a.knots == b.knots);
  const auto at = [](const SplineRows& f, double v) {
    BaseSurface base;
    const RangeFunction r(base, 1, f.degree, {0, 0, 1, 1}, f.knots, f.coefficients);
    return Eigen::Vector2d(r(base.arcs.theta_of_v(v), 0), r(base.arcs.theta_of_v(v), 1));
  };
  for (int k = 0; k < 20; ++k) {
    const double v = test::uniform(random, 0, 4);
    RC_ASSERT((at(a, v) - at(before[0], v)).norm() < 1e-12);
    RC_ASSERT((at(b, v) - at(before[1], v)).norm() < 1e-12);
  }
}

// Z^w = W(v) (zs(v) + u (ze(v) - zs(v))): the surface is the range between its rims, at the degrees of plane ones.
RC_GTEST_PROP(Rims, TheProductIsTheRangeBetweenTheRims, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const RangeFunction f = random_between_rims(random);
  const BaseSurface& base = f.base();
  const NurbsSurface s = symbolic_product(f);
  RC_ASSERT(s.degree_u == std::max(f.degree_u(), 1));
  RC_ASSERT(s.degree_v == base.heights->degree_v() + 2);
  for (int k = 0; k < 40; ++k) {
    const double u = test::uniform(random, 0, 1), v = test::uniform(random, 0, 4), theta = base.arcs.theta_of_v(v);
    const double along = base.band_start + u * (base.band_end - base.band_start), r = f(theta, along);
    const double share = (along + 1) / 4,
                 z = (1 - share) * (*base.heights)(theta, -1) + share * (*base.heights)(theta, 3);
    const Eigen::Vector3d truth = base.X_WB * Eigen::Vector3d(r * std::cos(theta), r * std::sin(theta), z);
    RC_ASSERT((s.evaluate(u, v) - truth).norm() < 1e-10);
    RC_ASSERT(std::abs(base.along_at(theta, z) - along) < 1e-12);
    RC_ASSERT(std::abs(base.along_of(base.X_WB.inverse() * truth) - along) < 1e-11);
  }
}

// Normals, curvatures and distances by the chain rule, against the fundamental forms of the NURBS surface.
RC_GTEST_PROP(Rims, NormalsCurvaturesAndDistances, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const RangeFunction f = random_between_rims(random);
  const BaseSurface& base = f.base();
  const NurbsSurface s = symbolic_product(f);
  for (int k = 0; k < 20; ++k) {
    const double u = test::uniform(random, 0, 1), v = test::uniform(random, 0, 4), theta = base.arcs.theta_of_v(v);
    const double along = base.band_start + u * (base.band_end - base.band_start);
    const SurfaceDerivatives d = s.derivatives(u, v);
    const Eigen::Vector3d n = d.S_v.cross(d.S_u).normalized();
    const SurfacePoint point = f.surface_point(theta, along);
    RC_ASSERT((point.p_W - d.S).norm() < 1e-10);
    RC_ASSERT((point.normal_W - n).norm() < 1e-9);
    Eigen::Matrix2d first, second;
    first << d.S_u.dot(d.S_u), d.S_u.dot(d.S_v), d.S_u.dot(d.S_v), d.S_v.dot(d.S_v);
    second << d.S_uu.dot(n), d.S_uv.dot(n), d.S_uv.dot(n), d.S_vv.dot(n);
    const Eigen::Matrix2d shape = -first.inverse() * second;
    const double size = 1 + std::abs(point.curvature_max) + std::abs(point.curvature_min);
    RC_ASSERT(std::abs(shape.trace() - point.curvature_max - point.curvature_min) < 1e-8 * size);
    RC_ASSERT(std::abs(shape.determinant() - point.curvature_max * point.curvature_min) < 1e-8 * size * size);
    // e_p cos(psi) of a point a little outside along its ray.
    const Eigen::Vector3d axis = base.X_WB.linear().col(2);
    Eigen::Vector3d ray = d.S - base.X_WB.translation();
    ray = (ray - axis * axis.dot(ray)).normalized();
    const auto off = f.membership(d.S + 1e-3 * ray);
    RC_ASSERT(std::abs(off.ray_mm - 1e-3) < 1e-10);
    RC_ASSERT(std::abs(off.signed_distance_mm - 1e-3 * ray.dot(n)) < 1e-10);
  }
}

TEST(Rims, SamplesAreCarriedWithTheirCovariances) {
  std::mt19937_64 random(7);
  const auto heights = random_heights(random, 3);
  Profile profile;
  profile.r_mm = {30, 31, 30};
  profile.theta_rad = {1.1, 4.2, 2};
  profile.z_mm = {30, 50, 200};
  profile.covariance.assign(3, {.rr = 4e-4f, .rt = 1e-5f, .rz = 1e-4f, .tt = 1e-6f, .tz = 2e-5f, .zz = 9e-4f});
  profile.row = {1, 2, 3};
  for (const bool angle : {false, true}) {  // samples without numbers, which are nowhere
    profile.r_mm.push_back(30);
    profile.theta_rad.push_back(angle ? std::nan("") : 1);
    profile.z_mm.push_back(angle ? 30 : std::nan(""));
    profile.covariance.push_back(profile.covariance.front());
    profile.row.push_back(4);
  }
  class One : public ProfileStream {
   public:
    explicit One(const Profile& p) : profile_(p) {}
    void rewind() override { read_ = false; }
    const Profile* next() override { return std::exchange(read_, true) ? nullptr : &profile_; }

   private:
    const Profile& profile_;
    bool read_ = false;
  } from(profile);
  RimmedStream stream(from, heights);
  const Profile* const p = stream.next();
  ASSERT_EQ(p->size(), 2u);
  EXPECT_EQ(stream.beyond(), 1u);
  EXPECT_EQ(p->row[1], 2);
  BaseSurface base;
  base.heights = heights;
  for (std::size_t k = 0; k < 2; ++k) {
    const auto along = [&](double theta, double z) { return base.along_at(theta, z); };
    const double theta = profile.theta_rad[k], z = profile.z_mm[k], h = 1e-5;
    EXPECT_NEAR(p->z_mm[k], along(theta, z), 1e-12);
    Eigen::Matrix3d J = Eigen::Matrix3d::Identity(), C;
    J(2, 1) = (along(theta + h, z) - along(theta - h, z)) / (2 * h);
    J(2, 2) = (along(theta, z + h) - along(theta, z - h)) / (2 * h);
    C << 4e-4, 1e-5, 1e-4, 1e-5, 1e-6, 2e-5, 1e-4, 2e-5, 9e-4;
    const Eigen::Matrix3d expected = J * C * J.transpose();
    const SampleCovariance& c = p->covariance[k];
    EXPECT_NEAR(c.rz, expected(0, 2), 1e-6 * std::abs(expected(0, 2)) + 1e-10);
    EXPECT_NEAR(c.tz, expected(1, 2), 1e-6 * std::abs(expected(1, 2)) + 1e-10);
    EXPECT_NEAR(c.zz, expected(2, 2), 1e-6 * expected(2, 2) + 1e-10);
  }
}

// Samples in any order between two rims.
struct Wall {
  double (*radius)(double t, double z);
  double (*lower)(double t);
  double (*upper)(double t);
};

class Samples : public ProfileStream {
 public:
  Samples(const Wall& wall, int n, double sigma, double stray_share = 0) {
    std::mt19937_64 random(11);
    std::normal_distribution<double> normal(0, 1);
    profile_.order = ProfileOrder::scattered;
    for (int k = 0; k < n; ++k) {
      const double t = test::uniform(random, 0, 2 * pi), low = wall.lower(t), high = wall.upper(t);
      const bool stray = test::uniform(random, 0, 1) < stray_share;
      const double z = stray ? test::uniform(random, -10, 90) : test::uniform(random, low, high);
      profile_.theta_rad.push_back(t);
      profile_.z_mm.push_back(z);
      profile_.r_mm.push_back(stray ? test::uniform(random, 5, 60) : wall.radius(t, z) + sigma * normal(random));
    }
  }
  void rewind() override { read_ = false; }
  const Profile* next() override { return std::exchange(read_, true) ? nullptr : &profile_; }
  Profile& profile() { return profile_; }

 private:
  Profile profile_;
  bool read_ = false;
};

RangeFit fit_between(ProfileStream& samples, Rims& rims) {
  const auto found = find_rims(samples, {});
  EXPECT_TRUE(found) << (found ? "" : found.error().message);
  rims = *found;
  RimmedStream stream(samples, rims.heights);
  auto fit = fit_samples(stream);
  EXPECT_TRUE(fit) << (fit ? "" : fit.error().message);
  put_between_rims(*fit, rims.heights);
  return *fit;
}

double plain(double, double) {
  return 30;
}
double freeform(double t, double z) {
  return 30 + 3 * std::cos(2 * t) * std::sin(pi * z / 70) + 1.5 * std::cos(5 * t + 0.05 * z);
}
double scalloped(double t) {
  return 5 + 3 * std::cos(3 * t + 0.3);
}
double slanted(double t) {
  return 60 + 10 * std::cos(t - 0.5);
}
double level(double) {
  return 5;
}

// The surface ends within the samples, nowhere far from their ends.
TEST(Rims, FollowTheEndsOfTheSamples) {
  for (const int n : {3000, 20000, 200000}) {
    for (const double strays : {0.0, 0.05}) {
      if (strays > 0 && n < 20000) continue;
      Samples samples({freeform, scalloped, slanted}, n, 0.02, strays);
      Rims rims;
      const RangeFit fit = fit_between(samples, rims);
      const BaseSurface& base = fit.function.base();
      const double reach = n == 3000 ? 6 : n == 20000 ? 2.2 : 1.1, over = 0.5 * reach;
      for (double t = 0; t < 2 * pi; t += 0.05) {
        const double low = base.z_mm(t, base.band_start), high = base.z_mm(t, base.band_end);
        EXPECT_GT(low, scalloped(t) - over * 0.3) << n << " at " << t;
        EXPECT_LT(low, scalloped(t) + reach) << n << " at " << t;
        EXPECT_LT(high, slanted(t) + over * 0.3) << n << " at " << t;
        EXPECT_GT(high, slanted(t) - reach) << n << " at " << t;
      }
      EXPECT_LT(rims.share_beyond, n == 3000 ? 0.15 : 0.05 + strays) << n;
      if (n < 20000) continue;
      double worst = 0;
      for (double t = 0.01; t < 2 * pi; t += 0.05)
        for (int i = 0; i <= 20; ++i) {
          const double along = base.band_start + (base.band_end - base.band_start) * i / 20;
          worst = std::max(worst, std::abs(fit.function(t, along) - freeform(t, base.z_mm(t, along))));
        }
      EXPECT_LT(worst, n == 20000 ? 0.08 : 0.03) << n;
    }
  }
}

TEST(Rims, ACylinderCutSlantwiseStaysExact) {
  Samples samples({plain, level, slanted}, 50000, 0);
  Rims rims;
  const RangeFit fit = fit_between(samples, rims);
  EXPECT_EQ(fit.report.model, SurfaceModel::cylinder);
  EXPECT_EQ(fit.surface.degree_u, 1);
  const BaseSurface& base = fit.function.base();
  for (double u = 0; u <= 1; u += 0.125)
    for (double v = 0; v < 4; v += 0.1) EXPECT_NEAR(fit.surface.evaluate(u, v).head<2>().norm(), 30, 1e-9);
  // The volume between the rims: mean heights, since what varies around is no more than first harmonics.
  double mean = 0;
  for (int k = 0; k < 3600; ++k) {
    const double t = 2 * pi * k / 3600;
    mean += (base.z_mm(t, base.band_end) - base.z_mm(t, base.band_start)) / 3600;
  }
  const SolidProperties solid = solid_properties(fit.surface);
  EXPECT_NEAR(solid.volume_mm3 / (900 * pi * mean), 1, 2e-4);
  EXPECT_NEAR(mean, 55, 1.2);
  EXPECT_NEAR(solid.end_cap_area_mm2 / (900 * pi * std::hypot(1.0, 10.0 / 30)), 1, 0.01);
}

TEST(Rims, SayWhyThereAreNone) {
  const auto why = [](ProfileStream& samples) {
    const auto rims = find_rims(samples, {});
    return rims ? std::string("rims") : rims.error().message;
  };
  Samples few({plain, level, slanted}, 500, 0.02);
  EXPECT_NE(why(few).find("500 usable samples are too few"), std::string::npos) << why(few);
  Samples half({plain, level, slanted}, 20000, 0.02);
  for (double& t : half.profile().theta_rad) t /= 2;
  EXPECT_NE(why(half).find("angles only"), std::string::npos) << why(half);
  Samples crossing({plain, level, [](double t) { return 40 + 35.5 * std::cos(t); }}, 20000, 0.02);
  EXPECT_NE(why(crossing).find("let the rims be plane"), std::string::npos) << why(crossing);
}

}  // namespace
}  // namespace celadon
