// Range functions over a sphere, their poles and their fits, against closed forms and dense linear algebra.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "fitting/bending_energy.h"
#include "fitting/fit_ladder.h"
#include "fitting/nurbs_surface.h"
#include "fitting/pole_jets.h"
#include "fitting/range_function.h"
#include "fitting/solid_properties.h"
#include "tests/fitting/sphere_tools.h"
#include "tests/fitting/spline_tools.h"

namespace celadon {
namespace {

using test::Body;
using test::fit_sphere;
using test::kPi;
using test::MemoryStream;
using test::miss_sphere;
using test::off_centre_sphere;
using test::scattered_body;

BaseSurface sphere(double start = 0, double end = 2) {
  BaseSurface base;
  base.kind = BaseKind::sphere;
  base.band_start = start;
  base.band_end = end;
  return base;
}

Eigen::Vector3d direction(double phi, double theta) {
  return {std::sin(phi) * std::cos(theta), std::sin(phi) * std::sin(theta), std::cos(phi)};
}

// Breaks over part of the meridian, its joint among them where it lies inside.
std::vector<double> random_meridian_breaks(std::mt19937_64& random) {
  double lo = 0, hi = 2;
  if (random() % 2) lo = test::uniform(random, 0, 0.9);
  if (random() % 2) hi = test::uniform(random, 1.1, 2);
  if (random() % 4 == 0) lo = 0.2, hi = 0.9;
  std::vector<double> breaks{lo};
  const int m = std::uniform_int_distribution<int>(3, 8)(random);
  for (int k = 1; k < m; ++k) {
    const double at = lo + (hi - lo) * k / m;
    if (breaks.back() < 1 && at > 1) breaks.push_back(1);
    breaks.push_back(at);
  }
  if (breaks.back() < 1 && hi > 1) breaks.push_back(1);
  breaks.push_back(hi);
  return breaks;
}

RangeFunction random_sphere_function(std::mt19937_64& random, int p, int q) {
  const std::vector<double> breaks = random_meridian_breaks(random);
  const RangeSpace u = p == 0 ? RangeSpace::constant({breaks.front(), breaks.back()})
                              : RangeSpace::over(p, BaseSurface::meridian(), breaks, JointContinuity::curvature);
  BaseSurface base = sphere(breaks.front(), breaks.back());
  if (random() % 2) base.X_WB = test::random_placement(random);
  return test::random_function(random, u, test::random_space_v(random, q), base, 8);
}

RC_GTEST_PROP(SphereProduct, IsTheRangeFunctionTimesTheUnitSphere_3_8, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int p = std::uniform_int_distribution<int>(0, 5)(random), q = std::uniform_int_distribution<int>(0, 5)(random);
  const RangeFunction f = random_sphere_function(random, p, q);
  const NurbsSurface s = symbolic_product(f);
  RC_ASSERT(s.degree_u == p + 2);
  RC_ASSERT(s.degree_v == q + 2);
  RC_ASSERT(s.control_points.row(3).minCoeff() > 0);
  const double lo = f.base().band_start, hi = f.base().band_end;
  for (int k = 0; k < 60; ++k) {
    const double w = test::uniform(random, lo, hi), v = test::uniform(random, 0, 4);
    const double phi = BaseSurface::meridian().theta_of_v(w), theta = f.base().arcs.theta_of_v(v);
    const Eigen::Vector3d truth = f.base().X_WB * (f(theta, w) * direction(phi, theta));
    RC_ASSERT((s.evaluate(w, v) - truth).norm() < 1e-10);
  }
  for (int i = 0; i < s.count_u(); ++i) RC_ASSERT(s.control_point(i, 0) == s.control_point(i, s.count_v() - 1));
}

TEST(SphereProduct, AConstantIsTheExactSphereOfDegreeTwoTwo) {
  const RangeFunction f(sphere(), 0, 0, {0, 2}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25));
  const NurbsSurface s = symbolic_product(f);
  EXPECT_EQ(s.degree_u, 2);
  EXPECT_EQ(s.degree_v, 2);
  EXPECT_EQ(s.count_u(), 5);
  EXPECT_EQ(s.count_v(), 9);
  for (double u = 0; u <= 2; u += 0.05)
    for (double v = 0; v <= 4; v += 0.05) EXPECT_NEAR(s.evaluate(u, v).norm(), 25, 1e-13 * 25);
  for (int j = 0; j < s.count_v(); ++j) {  // the poles, to the bit
    EXPECT_EQ(s.evaluate(0, 0), Eigen::Vector3d(0, 0, 25));
    EXPECT_EQ(s.control_point(0, j).head(2).norm(), 0);
    EXPECT_EQ(s.control_point(4, j).head(2).norm(), 0);
  }
  const SurfaceDerivatives d = s.derivatives(0.7, 1.3);
  EXPECT_GT(d.S_u.cross(d.S_v).dot(d.S), 0);  // outward
}

RC_GTEST_PROP(SphereSpace, TheRangeIsCurvatureContinuousInPhiAcrossTheEquator, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const int p = std::uniform_int_distribution<int>(3, 5)(random);
  RangeFunction f = random_sphere_function(random, p, 3);
  if (!(f.base().band_start < 0.99 && f.base().band_end > 1.01)) return;
  const double h = 1e-10, theta = test::uniform(random, 0, 6);
  const auto second = [&](double w) {
    const RangeDerivatives r = f.derivatives(theta, w);
    double phi_w = 1, phi_ww = 0;
    BaseSurface::meridian().theta_derivatives(w, phi_w, phi_ww);
    return Eigen::Vector2d(r.r_z / phi_w, (r.r_z_z - r.r_z * phi_ww / phi_w) / (phi_w * phi_w));
  };
  const Eigen::Vector2d below = second(1 - h), above = second(1 + h);
  RC_ASSERT(std::abs(below[0] - above[0]) < 1e-5);
  RC_ASSERT(std::abs(below[1] - above[1]) < 1e-3);  // 2 h times third derivatives of up to some 1e6
}

// Position, normal and curvatures against finite differences of the NURBS.
RC_GTEST_PROP(SphereSurfacePoint, AgreesWithTheSurface, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const RangeFunction f = random_sphere_function(random, 3, 3);
  const NurbsSurface s = symbolic_product(f);
  for (int k = 0; k < 10; ++k) {
    const double w = test::uniform(random, std::max(0.05, f.base().band_start), std::min(1.95, f.base().band_end)),
                 v = test::uniform(random, 0, 4);
    const SurfacePoint point = f.surface_point(f.base().arcs.theta_of_v(v), w);
    const SurfaceDerivatives d = s.derivatives(w, v);
    const Eigen::Vector3d n = d.S_u.cross(d.S_v).normalized();
    RC_ASSERT((point.p_W - d.S).norm() < 1e-10);
    RC_ASSERT((point.normal_W - n).norm() < 1e-9);
    const double E = d.S_u.dot(d.S_u), F = d.S_u.dot(d.S_v), G = d.S_v.dot(d.S_v);
    const double L = -d.S_uu.dot(n), M = -d.S_uv.dot(n), N = -d.S_vv.dot(n);
    const double K = (L * N - M * M) / (E * G - F * F), H = (E * N - 2 * F * M + G * L) / (2 * (E * G - F * F));
    RC_ASSERT(std::abs(point.curvature_max * point.curvature_min - K) < 1e-6 * (1 + std::abs(K)));
    RC_ASSERT(std::abs(point.curvature_max + point.curvature_min - 2 * H) < 1e-6 * (1 + std::abs(H)));
  }
}

TEST(SphereSurfacePoint, OnAnyMeridianOfASphereOffItsCentre) {
  // Closed form derivatives of rho along theta and w: by differences of the exact function.
  const Eigen::Vector3d centre(3, 1, 2);
  const Body body = off_centre_sphere(25, centre);
  const auto derivatives = [&](double theta, double w) {
    const double h = 1e-4;
    const auto f = [&](double t, double u) { return body(BaseSurface::meridian().theta_of_v(u), t); };
    RangeDerivatives r;
    r.r_mm = f(theta, w);
    r.r_theta = (f(theta + h, w) - f(theta - h, w)) / (2 * h);
    r.r_z = (f(theta, w + h) - f(theta, w - h)) / (2 * h);
    r.r_theta_theta = (f(theta + h, w) - 2 * r.r_mm + f(theta - h, w)) / (h * h);
    r.r_z_z = (f(theta, w + h) - 2 * r.r_mm + f(theta, w - h)) / (h * h);
    r.r_theta_z = (f(theta + h, w + h) - f(theta + h, w - h) - f(theta - h, w + h) + f(theta - h, w - h)) / (4 * h * h);
    return r;
  };
  for (double w = 0.1; w < 2; w += 0.17)
    for (double theta = 0; theta < 6.2; theta += 0.7) {
      const SurfacePoint p = surface_point(sphere(), theta, w, derivatives(theta, w));
      EXPECT_NEAR((p.p_W - centre).norm(), 25, 1e-10);
      EXPECT_LT((p.normal_W - (p.p_W - centre) / 25).norm(), 1e-6);
      EXPECT_NEAR(p.curvature_max, 1 / 25.0, 1e-6);
      EXPECT_NEAR(p.curvature_min, 1 / 25.0, 1e-6);
      EXPECT_NEAR(cos_psi(sphere(), theta, w, derivatives(theta, w).r_mm, derivatives(theta, w).r_theta,
                          derivatives(theta, w).r_z),
                  p.normal_W.dot(p.p_W.normalized()), 1e-7);
    }
  // At the poles the meridians' slopes are one-sided: theta.phi = a cos(theta) + b sin(theta) beyond the pole is the
  // meridian opposite.
  for (const double w : {0.0, 2.0}) {
    RangeDerivatives along[3];
    for (int k = 0; k < 3; ++k) {
      const double h = 1e-4, theta = k * kPi / 4, side = w == 0 ? 1 : -1;
      const auto f = [&](double step) { return body(BaseSurface::meridian().theta_of_v(w + side * step), theta); };
      along[k].r_mm = f(0);
      along[k].r_z = side * (-3 * f(0) + 4 * f(h) - f(2 * h)) / (2 * h);
      along[k].r_z_z = (2 * f(0) - 5 * f(h) + 4 * f(2 * h) - f(3 * h)) / (h * h);
    }
    const SurfacePoint p = pole_point(sphere(), w, along);
    EXPECT_NEAR((p.p_W - centre).norm(), 25, 1e-10);
    EXPECT_LT((p.normal_W - (p.p_W - centre) / 25).norm(), 1e-5);
    EXPECT_NEAR(p.curvature_max, 1 / 25.0, 1e-4);
    EXPECT_NEAR(p.curvature_min, 1 / 25.0, 1e-4);
  }
}

GridSpecification sphere_grid(int along, int per_arc, int p = 3, int q = 3) {
  GridSpecification grid;
  grid.base = BaseKind::sphere;
  grid.z_start_mm = 0;
  grid.z_end_mm = 2;
  grid.z_intervals = along;
  grid.intervals_per_arc = per_arc;
  grid.degree_u = p;
  grid.degree_v = q;
  return grid;
}

// The bordered solution is the least squares solution over x = P y, by dense algebra over the samples.
TEST(PoleSolver, IsLeastSquaresAmongWhatTheJetsAllow) {
  for (const Poles poles : {Poles{true, false}, Poles{false, true}, Poles{true, true}})
    for (const auto& [p, q] : {std::pair{3, 3}, {2, 3}, {4, 2}, {1, 1}, {5, 5}}) {
      if (p == 5 && !(poles.start && poles.end)) continue;  // the samples at an open pole are too few for it
      MemoryStream cylindrical = scattered_body(off_centre_sphere(25, {2, 1, 1}), {.samples = 4000, .sigma = 0.05});
      SphericalStream stream(cylindrical, 0);
      MomentGrid sums(sphere_grid(16, 2, p, q));
      std::vector<double> v, w, rho;
      stream.rewind();
      while (const Profile* profile = stream.next()) {
        sums.add(profile->r_mm, profile->theta_rad, profile->z_mm);
        for (std::size_t k = 0; k < profile->size(); ++k) {
          rho.push_back(profile->r_mm[k]);
          w.push_back(profile->z_mm[k]);
          v.push_back(BaseArcs::full_circle().v_of_theta(profile->theta_rad[k]));
        }
      }
      const FitLadder ladder(sums, {0, 16, poles}, p, q, JointContinuity::curvature);
      const NormalEquations equations = ladder.equations(0, 0);
      ASSERT_NE(equations.jets(), nullptr);
      const PoleJets& jets = *equations.jets();
      EXPECT_EQ(jets.unknowns(), ladder.unknowns(0, 0)) << p << q;
      EXPECT_EQ(equations.supported_unknowns(), jets.unknowns());
      const auto free = NormalSolver(equations).solve();
      ASSERT_TRUE(free);

      const Eigen::MatrixXd all = test::design(equations.space(), v, w);
      const int nu = jets.count_u(), nv = jets.count_v();
      Eigen::MatrixXd P = Eigen::MatrixXd::Zero(nu * nv, jets.unknowns());
      int column = 0;
      for (int i = jets.first_row(); i < jets.last_row(); ++i)
        for (int j = 0; j < nv; ++j) P(j * nu + i, column++) = 1;
      for (int k = 0; k < jets.parameters(); ++k)
        P.col(column++) = Eigen::Map<const Eigen::VectorXd>(jets.column(k).data(), nu * nv);
      EXPECT_LT((P.transpose() * P - Eigen::MatrixXd::Identity(column, column)).norm(), 1e-12);
      const Eigen::MatrixXd D = all * P;
      const Eigen::VectorXd y =
          D.householderQr().solve(Eigen::Map<const Eigen::VectorXd>(rho.data(), static_cast<Eigen::Index>(rho.size())));
      const Eigen::VectorXd x = P * y;
      const Eigen::Map<const Eigen::VectorXd> mine(free->data(), nu * nv);
      EXPECT_LT((mine - x).cwiseAbs().maxCoeff(), 1e-8) << p << q << poles.start << poles.end;
    }
}

// Of spherical harmonics of order l, by Bochner's formula: (l^2 (l + 1)^2 - l (l + 1)) times the integral of the
// square.
TEST(SphericalEnergy, IsThatOfTheHarmonics) {
  const RangeSpace u = RangeSpace::over(5, BaseSurface::meridian(), 16, JointContinuity::curvature),
                   v = RangeSpace::over(5, BaseArcs::full_circle(), 16, JointContinuity::curvature);
  const BendingEnergy energy = spherical_energy(u, v, BaseArcs::full_circle());
  const auto free = [](const RangeSpace& space, const BaseArcs& arcs, const std::function<double(double)>& f) {
    const Eigen::Index n = 4000;
    Eigen::VectorXd t(n), y(n);
    for (Eigen::Index k = 0; k < n; ++k) {
      t[k] = (static_cast<double>(k) + 0.5) / static_cast<double>(n) * arcs.count();
      y[k] = f(arcs.theta_of_v(t[k]));
    }
    const Eigen::MatrixXd A = test::collocation(space, t);
    return Eigen::VectorXd((A.transpose() * A).ldlt().solve(A.transpose() * y));
  };
  struct Case {
    std::function<double(double)> along, around;
    double energy;
  };
  const Case cases[] = {
      {[](double) { return 1; }, [](double) { return 1; }, 0},
      {[](double p) { return std::cos(p); }, [](double) { return 1; }, 2 * 4 * kPi / 3},
      {[](double p) { return std::sin(p); }, [](double t) { return std::cos(t); }, 2 * 4 * kPi / 3},
      {[](double p) { return 3 * std::pow(std::cos(p), 2) - 1; }, [](double) { return 1; }, 30 * 16 * kPi / 5},
      {[](double p) { return std::pow(std::sin(p), 2); }, [](double t) { return std::cos(2 * t); }, 30 * 16 * kPi / 15},
      {[](double p) { return std::pow(std::sin(p), 3); }, [](double t) { return std::sin(3 * t); },
       (144 - 12) * 32 * kPi / 35}};
  for (const Case& c : cases) {
    const Eigen::VectorXd a = free(u, BaseSurface::meridian(), c.along), b = free(v, BaseArcs::full_circle(), c.around);
    double sum = 0;
    for (std::size_t k = 0; k < 3; ++k)
      sum += (k == 1 ? 2 : 1) * a.dot(energy.along_u[2 - k] * a) * b.dot(energy.along_v[k] * b);
    EXPECT_NEAR(sum, c.energy, 1e-4 * (1 + c.energy));
  }
}

// A spline with closed poles has one tangent plane and one curvature there, seen from every meridian.
TEST(PoleJets, EveryMeridianSeesTheSameTangentPlaneAndCurvature) {
  for (const int per_arc : {4, 8, 16}) {
    const RangeSpace u = RangeSpace::over(3, BaseSurface::meridian(), 8, JointContinuity::curvature),
                     v = RangeSpace::over(3, BaseArcs::full_circle(), per_arc, JointContinuity::curvature);
    const PoleJets jets(u, v, BaseArcs::full_circle(), {true, true});
    std::mt19937_64 random(7);
    for (int trial = 0; trial < 3; ++trial) {
      Eigen::MatrixXd free = Eigen::MatrixXd::Zero(u.free_count(), v.free_count());
      for (int i = jets.first_row(); i < jets.last_row(); ++i)
        for (int j = 0; j < v.free_count(); ++j) free(i, j) = test::uniform(random, 24, 26);
      for (int k = 0; k < jets.parameters(); ++k) free += test::uniform(random, 20, 30) * jets.column(k);
      const RangeFunction f(sphere(), 3, 3, u.knots(), v.knots(), u.extraction() * free * v.extraction().transpose());
      const double tolerance = std::pow(4.0 / per_arc, 3);  // the splines' own cosines and sines
      for (const double w : {0.0, 2.0}) {
        double phi_w = 1, phi_ww = 0;
        BaseSurface::meridian().theta_derivatives(w, phi_w, phi_ww);
        Eigen::MatrixXd modes(24, 6);
        Eigen::VectorXd value(24), slope(24), second(24);
        for (int k = 0; k < 24; ++k) {
          const double theta = 2 * kPi * (k + 0.3) / 24;
          const RangeDerivatives r = f.derivatives(theta, w);
          modes.row(k) << 1, std::cos(theta), std::sin(theta), 1, std::cos(2 * theta), std::sin(2 * theta);
          value[k] = r.r_mm;
          slope[k] = r.r_z / phi_w;
          second[k] = (r.r_z_z - r.r_z * phi_ww / phi_w) / (phi_w * phi_w);
        }
        EXPECT_LT(value.maxCoeff() - value.minCoeff(), 1e-11);
        const auto left = [](const Eigen::MatrixXd& of, const Eigen::VectorXd& y) {
          return (y - of * of.colPivHouseholderQr().solve(y)).cwiseAbs().maxCoeff() / (1 + y.cwiseAbs().maxCoeff());
        };
        EXPECT_LT(left(modes.middleCols(1, 2), slope), 0.02 * tolerance) << per_arc;
        EXPECT_LT(left(modes.rightCols(3), second), 0.2 * tolerance) << per_arc;
      }
    }
  }
}

TEST(SphereFit, NoiseFreeSphereComesBackExactly) {
  MemoryStream stream = scattered_body([](double, double) { return 25; }, {.centre_z = 40});
  const auto f = fit_sphere(stream, {}, 40);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_EQ(f->report.model, SurfaceModel::cylinder);
  EXPECT_THAT(f->report.decided_by, testing::StartsWith("sphere accepted"));
  EXPECT_EQ(f->surface.degree_u, 2);
  EXPECT_EQ(f->surface.degree_v, 2);
  EXPECT_EQ(f->surface.count_u(), 5);
  for (double u = 0; u <= 2; u += 0.1)
    for (double v = 0; v <= 4; v += 0.1) EXPECT_NEAR(f->surface.evaluate(u, v).norm(), 25, 1e-9);
}

// An egg of revolution about z: degrees (p + 2, 2), poles closed.
TEST(SphereFit, RevolutionIsFoundWithClosedPoles) {
  const Body egg = [](double phi, double) { return 25 + 4 * std::cos(phi) + 2 * std::cos(2 * phi); };
  MemoryStream stream = scattered_body(egg, {.samples = 200000, .sigma = 0.02});
  const auto f = fit_sphere(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_EQ(f->report.model, SurfaceModel::revolution) << f->report.decided_by;
  EXPECT_EQ(f->surface.degree_u, 5);
  EXPECT_EQ(f->surface.degree_v, 2);
  EXPECT_EQ(f->function.base().band_start, 0);
  EXPECT_EQ(f->function.base().band_end, 2);
  EXPECT_LT(miss_sphere(f->function, egg).rms, 1e-3);
  EXPECT_NEAR(f->report.noise_mm, 0.02, 0.001);
}

TEST(SphereFit, FreeformBodyWithClosedPoles) {
  const Body body = [](double phi, double theta) {
    const double s = std::sin(phi);
    return 25 + 2 * s * s * std::cos(2 * theta) + s * s * s * std::sin(3 * theta) + 3 * std::cos(phi) +
           s * std::cos(theta);
  };
  MemoryStream stream = scattered_body(body, {.samples = 200000, .sigma = 0.02});
  const auto f = fit_sphere(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_EQ(f->report.model, SurfaceModel::general);
  EXPECT_LT(miss_sphere(f->function, body).rms, 2e-3);
  EXPECT_NEAR(f->report.noise_mm, 0.02, 0.001);
  EXPECT_NEAR(f->report.geometric_mm.rms / f->report.residual_mm.rms, 1, 0.05);
  EXPECT_NEAR(f->report.coverage, 1, 0.005);
  // One point, normal and curvature at the pole from every side.
  const SurfacePoint pole = f->function.surface_point(0, 0);
  for (double theta = 0; theta < 6; theta += 1) {
    const SurfacePoint near = f->function.surface_point(theta, 1e-6), beside = f->function.surface_point(theta, 0.02);
    EXPECT_LT((pole.p_W - near.p_W).norm(), 1e-4);
    EXPECT_LT((pole.normal_W - near.normal_W).norm(), 1e-4);
    EXPECT_NEAR(pole.curvature_max, beside.curvature_max, 3e-3);
    EXPECT_NEAR(pole.curvature_min, beside.curvature_min, 3e-3);
  }
}

// A hole at a pole that is no accident stays open; a gap between samples is closed.
TEST(SphereFit, AHoleAtAPoleStaysOpen) {
  const Body body = off_centre_sphere(25, {2, 1, 1});
  MemoryStream stream = scattered_body(body, {.samples = 60000, .sigma = 0.02, .phi_high = kPi - 0.5});
  const auto f = fit_sphere(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_EQ(f->function.base().band_start, 0);
  EXPECT_LT(f->function.base().band_end, 2);
  EXPECT_NEAR(BaseSurface::meridian().theta_of_v(f->function.base().band_end), kPi - 0.5, 0.01);
  EXPECT_LT(miss_sphere(f->function, body).max, 0.05);
}

// method.md: on a tilted tangent plane the errors fall as h^4.
TEST(SphereFit, ErrorsFallAsTheFourthPowerOnATiltedTangentPlane) {
  const Body body = off_centre_sphere(25, {3, 1, 2});
  std::vector<double> errors;
  for (const int intervals : {4, 8, 16}) {
    MemoryStream stream = scattered_body(body, {.samples = 200000});
    RangeFitOptions options;
    options.model = SurfaceModel::general;
    options.z_intervals = 2 * intervals;
    options.intervals_per_arc = intervals;
    options.robust = false;
    options.smoothing = false;
    const auto f = fit_sphere(stream, options);
    ASSERT_TRUE(f) << f.error().message;
    errors.push_back(miss_sphere(f->function, body).max);
    const Eigen::Vector3d n = f->function.surface_point(0, 0).normal_W, c(3, 1, 2);
    const Eigen::Vector3d truth = (Eigen::Vector3d(0, 0, body(0, 0)) - c) / 25;
    EXPECT_LT((n - truth).norm(), 5 * errors.back());
  }
  std::printf("largest error with 4, 8, 16 intervals an arc: %.2g %.2g %.2g mm\n", errors[0], errors[1], errors[2]);
  EXPECT_LT(errors[1], errors[0] / 10);
  EXPECT_LT(errors[2], errors[1] / 10);
  EXPECT_LT(errors[2], 1e-4);
}

// A level pole has its tangent plane for nothing where there is one; where it is tilted, no noise hides what that
// costs.
TEST(SphereFit, TheSamplesChooseHowPolesClose) {
  const test::Body level = [](double phi, double t) {
    const double s = std::sin(phi);
    return 25 + 8 * s * s * s * std::sin(3 * t);
  };
  const auto fit_of = [](const test::Body& body, double sigma, std::optional<PoleRule> rule) {
    test::MemoryStream stream =
        test::scattered_body(body, {.samples = 60000, .sigma = sigma, .phi_high = 0.7, .seed = 5});
    RangeFitOptions options;
    options.model = SurfaceModel::general;
    options.smoothing = false;
    options.pole_rule = rule;
    return test::fit_sphere(stream, options);
  };
  const auto chosen = fit_of(level, 0, {}), jet = fit_of(level, 0, PoleRule::jet);
  ASSERT_TRUE(chosen);
  EXPECT_EQ(chosen->report.poles.substr(0, 5), "level") << chosen->report.poles;
  EXPECT_LT(test::miss_sphere(chosen->function, level).rms, test::miss_sphere(jet->function, level).rms);
  EXPECT_TRUE(jet->report.poles.empty());
  const test::Body tilted = test::off_centre_sphere(25, {3, 1, 2});
  for (const double sigma : {0.0, 0.02}) {
    const auto fit = fit_of(tilted, sigma, {});
    ASSERT_TRUE(fit);
    EXPECT_EQ(fit->report.poles.substr(0, 5), "2-jet") << fit->report.poles;
    EXPECT_LT(test::miss_sphere(fit->function, tilted).rms,
              0.6 * test::miss_sphere(fit_of(tilted, sigma, PoleRule::level)->function, tilted).rms);
  }
}

TEST(SphereFit, VolumeAndInertiaOfASphereOffItsCentre) {
  MemoryStream stream = scattered_body(off_centre_sphere(25, {3, 1, 2}), {.samples = 200000, .centre_z = 10});
  const auto f = fit_sphere(stream, {}, 10);
  ASSERT_TRUE(f) << f.error().message;
  const SolidProperties solid = solid_properties(f->surface);
  EXPECT_FALSE(solid.v_cross_u_outward);
  const double volume = 4.0 / 3 * kPi * 25 * 25 * 25;
  EXPECT_NEAR(solid.volume_mm3 / volume, 1, 1e-6);
  EXPECT_LT((solid.centroid_mm - Eigen::Vector3d(3, 1, 2)).norm(), 1e-4);  // the base's frame: about its centre
  EXPECT_NEAR(solid.inertia_mm5(0, 0) / (0.4 * volume * 625), 1, 1e-5);
}

TEST(SphereFit, CentreOnTheAxisIsThatOfASphereOnIt) {
  MemoryStream stream = scattered_body([](double, double) { return 25; }, {.phi_high = 1.2, .centre_z = 33});
  EXPECT_NEAR(centre_on_axis_mm(stream), 33, 1e-9);
  MemoryStream level;
  level.profiles.emplace_back();
  for (int k = 0; k < 9; ++k) test::push(level.profiles.back(), 1 + k, k, 5);
  EXPECT_TRUE(std::isnan(centre_on_axis_mm(level)));
}

TEST(SphericalStream, CarriesCovariances) {
  Profile p;
  test::push(p, 20, 0.3, 50);
  p.covariance.push_back({.rr = 0.01f, .rt = 1e-5f, .rz = 0.002f, .tt = 1e-6f, .tz = 2e-6f, .zz = 0.004f});
  Profile s;
  to_spherical(p, 35, s);
  EXPECT_NEAR(s.r_mm[0], 25, 1e-12);
  EXPECT_NEAR(BaseSurface::meridian().theta_of_v(s.z_mm[0]), std::atan2(20, 15), 1e-12);
  // By differences of the map itself.
  const auto map = [](const Eigen::Vector3d& x) {
    const double z = x[2] - 35;
    return Eigen::Vector3d(std::hypot(x[0], z), x[1], BaseSurface::meridian().v_of_theta(std::atan2(x[0], z)));
  };
  const Eigen::Vector3d at(20, 0.3, 50);
  Eigen::Matrix3d J, C;
  for (int k = 0; k < 3; ++k) {
    Eigen::Vector3d step = Eigen::Vector3d::Zero();
    step[k] = 1e-5;
    J.col(k) = (map(at + step) - map(at - step)) / 2e-5;
  }
  const SampleCovariance c = p.covariance[0], m = s.covariance[0];
  C << c.rr, c.rt, c.rz, c.rt, c.tt, c.tz, c.rz, c.tz, c.zz;
  const Eigen::Matrix3d truth = J * C * J.transpose();
  EXPECT_NEAR(m.rr, truth(0, 0), 1e-8);
  EXPECT_NEAR(m.rt, truth(0, 1), 1e-10);
  EXPECT_NEAR(m.rz, truth(0, 2), 1e-9);
  EXPECT_NEAR(m.tt, truth(1, 1), 1e-12);
  EXPECT_NEAR(m.tz, truth(1, 2), 1e-12);
  EXPECT_NEAR(m.zz, truth(2, 2), 1e-9);
}

}  // namespace
}  // namespace celadon
