// Parts that stand off the scanner's axis.

#include <gtest/gtest.h>

#include <random>

#include "fitting/own_frame.h"
#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using namespace test;

// Samples of a body r(theta, z), 0 <= z <= 80, that stands at X_SL, as the scanner sees them.
MemoryStream standing_at(const Eigen::Isometry3d& X_SL, const Shape& body, int count, double sigma, double outliers,
                         unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0, 1);
  MemoryStream stream;
  for (int k = 0; k < count; ++k) {
    if (k % 1024 == 0) {
      stream.profiles.emplace_back();
      stream.profiles.back().order = ProfileOrder::scattered;
    }
    const double theta = 2 * kPi * share(random), z = 80 * share(random);
    double r = body(theta, z) + sigma * normal(random);
    if (share(random) < outliers) r += 1 + 5 * share(random);
    const Eigen::Vector3d p = X_SL * Eigen::Vector3d(r * std::cos(theta), r * std::sin(theta), z);
    push(stream.profiles.back(), std::hypot(p.x(), p.y()), std::atan2(p.y(), p.x()), p.z());
  }
  return stream;
}

Eigen::Isometry3d placed(double x, double y, double tilt_rad) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.translation() << x, y, 0;
  X.linear() = Eigen::AngleAxisd(tilt_rad, Eigen::Vector3d(1, 2, 0).normalized()).toRotationMatrix();
  return X;
}

struct BothFits {
  SurfaceFit here;
  std::optional<OwnFrameFit> own;
};
BothFits fit_both(MemoryStream& samples, const RangeFitOptions& options = {}) {
  const auto grid = choose_grid(samples, options);
  MomentGrid sums(*grid);
  FirstLook look(sums);
  samples.rewind();
  while (const Profile* p = samples.next()) {
    sums.add(p->r_mm, p->theta_rad, p->z_mm);
    look.add(*p);
  }
  ProfileStream* const parts[] = {&samples};
  auto here = fit_surface(sums, look, parts, options);
  EXPECT_TRUE(here) << here.error().message;
  auto own = fit_in_own_frame(*here, look, parts, options);
  return {std::move(*here), std::move(own)};
}

double cylinder_25mm(double, double) {
  return 25;
}
double flared_vase(double, double z) {
  return 30 + 0.2 * z - 0.006 * z * z + 4e-5 * z * z * z;
}

TEST(OwnFrame, AnOffCentreCylinderIsACylinderAgain) {
  const Eigen::Isometry3d X_SL = placed(6, 3, 0);
  MemoryStream samples = standing_at(X_SL, cylinder_25mm, 40000, 0, 0, 1);
  const BothFits fit = fit_both(samples);
  EXPECT_NE(fit.here.fit.report.model, SurfaceModel::cylinder);
  ASSERT_TRUE(fit.own);
  const RangeFunction& f = fit.own->surface.fit.function;
  EXPECT_EQ(fit.own->surface.fit.report.model, SurfaceModel::cylinder);
  EXPECT_NEAR(f(0, 40), 25, 1e-9);
  EXPECT_LT((f.base().X_WB.translation() - X_SL.translation()).norm(), 1e-8);
  EXPECT_NEAR(f.base().X_WB.translation().z(), 0, 1e-12);
  // The exact surface stands there in the scanner's frame.
  const NurbsSurface& surface = fit.own->surface.fit.surface;
  for (int k = 0; k < 100; ++k) {
    const Eigen::Vector3d p = surface.evaluate(k / 100.0, 4 * k / 100.0);
    EXPECT_NEAR(std::hypot(p.x() - 6, p.y() - 3), 25, 1e-8);
  }
}

TEST(OwnFrame, ALeaningVaseUnderNoiseAndStraysIsARevolutionAgain) {
  const Eigen::Isometry3d X_SL = placed(-4, 2, 0.06);
  MemoryStream samples = standing_at(X_SL, flared_vase, 150000, 0.02, 0.02, 2);
  BothFits fit = fit_both(samples, {.form_tolerance_mm = 0.003});
  EXPECT_EQ(fit.here.fit.report.model, SurfaceModel::general);
  ASSERT_TRUE(fit.own);
  const RangeFunction& f = fit.own->surface.fit.function;
  EXPECT_EQ(fit.own->surface.fit.report.model, SurfaceModel::revolution);
  EXPECT_LT(f.coefficients().size(), fit.here.fit.function.coefficients().size() / 10);
  EXPECT_LT(f.base().X_WB.linear().col(2).cross(X_SL.linear().col(2)).norm(), 2e-5);
  double worst = 0;
  for (double z = 5; z < 76; z += 0.5)
    for (double theta = 0.1; theta < 6.2; theta += 0.3)
      worst = std::max(worst, std::abs(f.membership(X_SL * Eigen::Vector3d(flared_vase(0, z) * std::cos(theta),
                                                                           flared_vase(0, z) * std::sin(theta), z))
                                           .ray_mm));
  EXPECT_LT(worst, 0.004);
  RangeFit measured = measure_errors(std::move(fit.own->surface), fit.own->samples.streams());
  EXPECT_NEAR(measured.report.geometric_mm.rms, 0.02, 0.002);
  EXPECT_NEAR(static_cast<double>(measured.report.rejected), 0.02 * 150000, 300);
}

TEST(OwnFrame, BodiesThatAreNotRoundStay) {
  MemoryStream freeform_body = standing_at(
      placed(0, 0, 0), [](double t, double z) { return freeform(t, 1.4 * z); }, 60000, 0.02, 0, 3);
  EXPECT_FALSE(fit_both(freeform_body).own);
  MemoryStream squeezed = standing_at(
      placed(3, 1, 0),
      [](double t, double z) { return flared_vase(t, z) / std::hypot(std::cos(t), std::sin(t) / 0.75); }, 60000, 0.02,
      0, 4);
  EXPECT_FALSE(fit_both(squeezed).own);
}

TEST(OwnFrame, RoundBodiesOnTheAxisAndNamedModelsStay) {
  MemoryStream centred = standing_at(placed(0, 0, 0), flared_vase, 40000, 0.02, 0, 5);
  EXPECT_FALSE(fit_both(centred).own);
  MemoryStream off = standing_at(placed(6, 3, 0), cylinder_25mm, 40000, 0.02, 0, 6);
  EXPECT_FALSE(fit_both(off, {.model = SurfaceModel::general}).own);
}

// Covariances turn with their samples: the scatter of moved samples is what the moved covariance says.
TEST(MovedStream, CarriesSamplesAndCovariances) {
  const Eigen::Isometry3d X_LS = placed(6, 3, 0.4).inverse();
  Eigen::Matrix3d L;
  L << 0.05, 0, 0, 1e-3, 5e-4, 0, 0.02, -0.01, 0.03;  // of r, theta, z
  const Eigen::Matrix3d cov = L * L.transpose();
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  MemoryStream stream;
  stream.profiles.emplace_back();
  const auto f = [](double x) { return static_cast<float>(x); };
  for (int k = 0; k < 20000; ++k) {
    const Eigen::Vector3d e = L * Eigen::Vector3d(normal(random), normal(random), normal(random));
    push(stream.profiles.back(), 25 + e[0], 1 + e[1], 40 + e[2]);
    stream.profiles.back().covariance.push_back(
        {f(cov(0, 0)), f(cov(0, 1)), f(cov(0, 2)), f(cov(1, 1)), f(cov(1, 2)), f(cov(2, 2))});
  }
  MovedStream moved(stream, X_LS);
  moved.rewind();
  const Profile* p = moved.next();
  ASSERT_NE(p, nullptr);
  Eigen::MatrixX3d values(20000, 3);
  for (std::size_t k = 0; k < p->size(); ++k) {
    values.row(static_cast<Eigen::Index>(k)) << p->r_mm[k], p->theta_rad[k], p->z_mm[k];
    EXPECT_GE(p->theta_rad[k], 0);
  }
  const Eigen::Vector3d at = X_LS * Eigen::Vector3d(25 * std::cos(1.0), 25 * std::sin(1.0), 40);
  EXPECT_NEAR(values.col(0).mean(), at.head<2>().norm(), 0.002);
  EXPECT_NEAR(values.col(2).mean(), at.z(), 0.002);
  const Eigen::MatrixX3d centred = values.rowwise() - values.colwise().mean();
  const Eigen::Matrix3d scatter = centred.transpose() * centred / 20000;
  const SampleCovariance& c = p->covariance.front();
  Eigen::Matrix3d said;
  said << c.rr, c.rt, c.rz, c.rt, c.tt, c.tz, c.rz, c.tz, c.zz;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      EXPECT_NEAR(said(i, j), scatter(i, j), 0.06 * std::sqrt(scatter(i, i) * scatter(j, j))) << i << j;
}

}  // namespace
}  // namespace celadon
