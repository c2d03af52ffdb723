// Volume, area, centroid and inertia against closed forms, triangulations and what moving, scaling and cutting does.
#include "fitting/solid_properties.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "fitting/gauss_legendre.h"
#include "fitting/knots.h"
#include "tests/fitting/solid_tools.h"

namespace celadon {
namespace {

using std::numbers::pi;

void expect_relative(double value, double truth, double tolerance, const char* what) {
  EXPECT_NEAR(value / truth, 1, tolerance) << what << ": " << value << " for " << truth;
}

TEST(GaussLegendre, IsExactToItsDegreeAndNotBeyond) {
  for (int n = 1; n <= 32; ++n) {
    const GaussRule& rule = gauss_rule(n);
    for (int degree = 0; degree <= 2 * n; degree += 2) {
      double sum = 0;
      for (std::size_t k = 0; k < rule.nodes.size(); ++k) sum += rule.weights[k] * std::pow(rule.nodes[k], degree);
      const double miss = std::abs(sum - 2.0 / (degree + 1));
      if (degree < 2 * n) {
        EXPECT_LT(miss, 1e-15) << n << ", " << degree;
      } else if (n < 12) {  // the remainder of x^(2n): its leading coefficient's square
        EXPECT_GT(miss, 1e-8) << n;
      }
    }
    EXPECT_TRUE(std::is_sorted(rule.nodes.begin(), rule.nodes.end()));
  }
  EXPECT_THROW(gauss_rule(0), std::invalid_argument);
  EXPECT_THROW(gauss_rule(33), std::invalid_argument);
}

TEST(SolidProperties, Cylinder) {
  const double R = 25, h = 70;
  const SolidProperties s = solid_properties(symbolic_product(test::polynomial_revolution({R}, h)));
  const double V = pi * R * R * h;
  expect_relative(s.volume_mm3, V, 1e-14, "volume");
  expect_relative(s.lateral_area_mm2, 2 * pi * R * h, 1e-14, "lateral");
  expect_relative(s.start_cap_area_mm2, pi * R * R, 1e-14, "start");
  expect_relative(s.end_cap_area_mm2, pi * R * R, 1e-14, "end");
  EXPECT_LT((s.centroid_mm - Eigen::Vector3d(0, 0, h / 2)).norm(), 1e-13);
  const double across = V * (3 * R * R + h * h) / 12, axial = V * R * R / 2;
  EXPECT_LT((s.inertia_mm5 - Eigen::Vector3d(across, across, axial).asDiagonal().toDenseMatrix()).norm(),
            1e-14 * across);
  EXPECT_TRUE(s.v_cross_u_outward);
  EXPECT_LT(s.relative_error, 1e-13);
}

TEST(SolidProperties, Frustum) {
  const double a = 30, b = 12, h = 44;
  const SolidProperties s = solid_properties(symbolic_product(test::polynomial_revolution({a, b - a}, h)));
  const double V = pi * h / 3 * (a * a + a * b + b * b);
  expect_relative(s.volume_mm3, V, 1e-14, "volume");
  expect_relative(s.lateral_area_mm2, pi * (a + b) * std::hypot(a - b, h), 1e-14, "lateral");
  expect_relative(s.area_mm2(), pi * ((a + b) * std::hypot(a - b, h) + a * a + b * b), 1e-14, "all");
  expect_relative(s.centroid_mm.z(), h / 4 * (a * a + 2 * a * b + 3 * b * b) / (a * a + a * b + b * b), 1e-14, "z");
  expect_relative(s.inertia_mm5(2, 2), pi * h / 10 * (std::pow(a, 5) - std::pow(b, 5)) / (a - b), 1e-14, "axial");
}

// Meridians of every degree: sums of products of the coefficients.
TEST(SolidProperties, RevolutionsWithPolynomialMeridians) {
  const double h = 60;
  const std::vector<double> all{30, 8, -21, 16, 15, -9};
  for (std::size_t n = 1; n <= all.size(); ++n) {
    const std::vector<double> c(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(n));
    const auto square = [&](const std::vector<double>& a) {
      std::vector<double> b(2 * a.size() - 1);
      for (std::size_t i = 0; i < a.size(); ++i)
        for (std::size_t j = 0; j < a.size(); ++j) b[i + j] += a[i] * a[j];
      return b;
    };
    const auto integral = [&](const std::vector<double>& a, std::size_t power) {  // of a(z/h) z^power
      double sum = 0;
      for (std::size_t k = 0; k < a.size(); ++k) sum += a[k] / static_cast<double>(k + power + 1);
      return sum * std::pow(h, static_cast<double>(power + 1));
    };
    const auto r2 = square(c), r4 = square(r2);
    const double V = pi * integral(r2, 0), z = pi * integral(r2, 1) / V;
    const double axial = pi / 2 * integral(r4, 0);
    const double across = axial / 2 + pi * integral(r2, 2) - V * z * z;
    const int steps = 20000;
    double area = 0;  // Simpson
    for (int k = 0; k <= 2 * steps; ++k) {
      const double t = k / (2.0 * steps);
      double r = 0, slope = 0;
      for (std::size_t i = n; i-- > 0;) slope = slope * t + r, r = r * t + c[i];
      area += (k == 0 || k == 2 * steps ? 1 : k % 2 ? 4 : 2) * 2 * pi * r * std::hypot(1, slope / h) * h / (6 * steps);
    }
    const SolidProperties s = solid_properties(symbolic_product(test::polynomial_revolution(c, h)));
    expect_relative(s.volume_mm3, V, 2e-14, "volume");
    expect_relative(s.centroid_mm.z(), z, 2e-14, "z");
    expect_relative(s.inertia_mm5(2, 2), axial, 5e-14, "axial");
    expect_relative(s.inertia_mm5(0, 0), across, 5e-14, "across");
    expect_relative(s.inertia_mm5(1, 1), across, 5e-14, "across");
    expect_relative(s.lateral_area_mm2, area, 1e-12, "area");
    EXPECT_LT(s.relative_error, 1e-12);
  }
}

TEST(SolidProperties, SphereWithPolesAndItsSegments) {
  const double R = 17;
  const SolidProperties whole = solid_properties(test::sphere(R, -pi / 2, pi / 2));
  const double V = 4 * pi / 3 * R * R * R;
  expect_relative(whole.volume_mm3, V, 1e-14, "volume");
  expect_relative(whole.area_mm2(), 4 * pi * R * R, 1e-14, "area");
  EXPECT_EQ(whole.start_cap_area_mm2, 0);
  EXPECT_EQ(whole.end_cap_area_mm2, 0);
  EXPECT_LT(whole.centroid_mm.norm(), 1e-14 * R);
  EXPECT_LT((whole.inertia_mm5 - 0.4 * V * R * R * Eigen::Matrix3d::Identity()).norm(), 1e-14 * V * R * R);
  EXPECT_TRUE(whole.v_cross_u_outward);  // u from the south pole to the north

  const double a = -0.4, b = 1.1, z0 = R * std::sin(a), z1 = R * std::sin(b);  // a zone
  const SolidProperties zone = solid_properties(test::sphere(R, a, b));
  const double volume = pi * (R * R * (z1 - z0) - (z1 * z1 * z1 - z0 * z0 * z0) / 3);
  expect_relative(zone.volume_mm3, volume, 1e-14, "zone");
  expect_relative(zone.lateral_area_mm2, 2 * pi * R * (z1 - z0), 1e-14, "zone's area");
  expect_relative(zone.end_cap_area_mm2, pi * (R * R - z1 * z1), 1e-14, "zone's disc");
  const double first = pi * (R * R * (z1 * z1 - z0 * z0) / 2 - (std::pow(z1, 4) - std::pow(z0, 4)) / 4);
  expect_relative(zone.centroid_mm.z(), first / volume, 1e-13, "zone's centroid");
}

TEST(SolidProperties, TorusSegment) {
  const double R = 40, r = 11;
  for (const double angle : {0.3, 1.7, 4.5}) {
    const SolidProperties s = solid_properties(test::torus_segment(R, r, angle));
    expect_relative(s.volume_mm3, pi * r * r * R * angle, 2e-14, "volume");
    expect_relative(s.lateral_area_mm2, 2 * pi * r * R * angle, 2e-14, "area");
    expect_relative(s.start_cap_area_mm2, pi * r * r, 2e-14, "disc");
    expect_relative(s.end_cap_area_mm2, pi * r * r, 2e-14, "disc");
    const double out = (R + r * r / (4 * R)) * 2 * std::sin(angle / 2) / angle;
    EXPECT_LT((s.centroid_mm - out * Eigen::Vector3d(std::cos(angle / 2), std::sin(angle / 2), 0)).norm(), 1e-12);
    const double axial = s.volume_mm3 * (R * R + 0.75 * r * r - out * out);
    expect_relative(s.inertia_mm5(2, 2), axial, 1e-12, "axial");
  }
}

// The reverse of u, or of v, turns S_u x S_v around; the solid stays.
TEST(SolidProperties, SaysWhichNormalIsOutward) {
  NurbsSurface s = test::sphere(10, -0.5, 1.2);
  const SolidProperties before = solid_properties(s);
  const int rows = s.count_u(), columns = s.count_v();
  Eigen::Matrix4Xd turned(4, s.control_points.cols());
  for (int i = 0; i < rows; ++i)
    turned.middleCols(i * columns, columns) = s.control_points.middleCols((rows - 1 - i) * columns, columns);
  s.control_points = turned;
  const SolidProperties after = solid_properties(s);  // the knots are symmetric
  EXPECT_TRUE(before.v_cross_u_outward);
  EXPECT_FALSE(after.v_cross_u_outward);
  expect_relative(after.volume_mm3, before.volume_mm3, 1e-14, "volume");
  EXPECT_LT((after.inertia_mm5 - before.inertia_mm5).norm(), 1e-13 * before.inertia_mm5.norm());
  expect_relative(after.end_cap_area_mm2, before.start_cap_area_mm2, 1e-14, "disc");
}

// Weights of the circle's arcs changed by rational reparametrisation, up to 1:20 and 1:625: the same body, harder
// integrands.
TEST(SolidProperties, AParametrisationFarFromArcLengthChangesNothing) {
  NurbsSurface s = test::sphere(17, -pi / 2, pi / 2);
  const SolidProperties plain = solid_properties(s);
  const int columns = s.count_v();
  for (int i = 0; i < s.count_u(); ++i)
    for (int j = 0; j < columns; ++j)
      s.control_points.col(i * columns + j) *= std::pow(20.0, (j % 4) / 2.0 * (j % 4 == 3 ? 1.0 / 3 : 1));
  for (int i = 0; i < s.count_u(); ++i) s.control_points.middleCols(i * columns, columns) *= std::pow(5.0, i);
  const SolidProperties skewed = solid_properties(s);
  EXPECT_LT(std::abs(skewed.volume_mm3 / plain.volume_mm3 - 1), std::max(1e-13, skewed.relative_error));
  EXPECT_LT(std::abs(skewed.area_mm2() / plain.area_mm2() - 1), std::max(1e-13, skewed.relative_error));
  EXPECT_LT(skewed.relative_error, 1e-12);
}

TEST(SolidProperties, TriangulationsConvergeToItAsTheSquare) {
  std::mt19937_64 random(11);
  const NurbsSurface s = symbolic_product(test::random_function(
      random, RangeSpace::open(3, {0, 0.4, 1}), RangeSpace::over(3, BaseArcs::full_circle(), 2), test::band(5, 65), 5));
  const SolidProperties solid = solid_properties(s);
  Eigen::Vector3d last = Eigen::Vector3d::Zero();
  for (const int n : {40, 80, 160, 320}) {
    const test::MeshProperties mesh = test::triangulated(s, n);
    const Eigen::Vector3d miss(mesh.volume - solid.volume_mm3, mesh.area - solid.area_mm2(),
                               (mesh.first / mesh.volume - solid.centroid_mm).norm());
    if (n > 80) {
      EXPECT_NEAR(last[0] / miss[0], 4, 0.15) << n;
      EXPECT_NEAR(last[1] / miss[1], 4, 0.15) << n;
      EXPECT_NEAR(last[2] / miss[2], 4, 0.6) << n;
    }
    last = miss;
  }
  EXPECT_LT(std::abs(last[0] / solid.volume_mm3), 2e-3);
}

// Integral of F^2/2 over theta and z, by midpoints in theta and z of a smooth body.
TEST(SolidProperties, IsTheIntegralOfHalfTheSquaredRange) {
  std::mt19937_64 random(12);
  const RangeFunction f = test::random_function(
      random, RangeSpace::open(3, {0, 0.4, 1}),
      RangeSpace::over(3, BaseArcs::full_circle(), 2, JointContinuity::curvature), test::band(-5, 35), 5);
  const int n = 1000;
  double sum = 0;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      const double r = f(2 * pi * (i + 0.5) / n, -5 + 40 * (j + 0.5) / n);
      sum += r * r / 2;
    }
  sum *= 2 * pi / n * 40.0 / n;
  expect_relative(solid_properties(symbolic_product(f)).volume_mm3, sum, 1e-6, "volume");
}

RC_GTEST_PROP(SolidProperties, MovesAndScalesWithTheBody, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const NurbsSurface s = symbolic_product(test::random_body(random, test::band(-20, 30)));
  const SolidProperties here = solid_properties(s);
  const Eigen::Isometry3d X = test::random_placement(random);
  const double k = test::uniform(random, 0.01, 100);
  NurbsSurface moved = s;
  const Eigen::Matrix3Xd points = s.control_points.topRows<3>();
  moved.control_points.topRows<3>() = k * (X.linear() * points + X.translation() * s.control_points.row(3));
  const SolidProperties there = solid_properties(moved);
  RC_ASSERT(std::abs(there.volume_mm3 / (k * k * k * here.volume_mm3) - 1) < 1e-13);
  RC_ASSERT(std::abs(there.area_mm2() / (k * k * here.area_mm2()) - 1) < 1e-13);
  RC_ASSERT((there.centroid_mm - k * (X * here.centroid_mm)).norm() < 1e-12 * k * 60);
  const Eigen::Matrix3d turned = std::pow(k, 5) * X.linear() * here.inertia_mm5 * X.linear().transpose();
  RC_ASSERT((there.inertia_mm5 - turned).norm() < 1e-12 * turned.norm());
  RC_ASSERT(here.relative_error < 1e-11);
}

// A body cut at a height: volumes add up, moments too by the parallel axes; the cuts' discs are one and the same.
RC_GTEST_PROP(SolidProperties, PartsAddUpToTheWhole, (unsigned seed)) {
  std::mt19937_64 random(seed);
  BaseSurface base = test::band(-20, 60);
  base.X_WB = test::random_placement(random);
  const RangeFunction f = test::random_body(random, base);
  const double cut = test::uniform(random, -15, 55);
  const SolidProperties whole = solid_properties(symbolic_product(f));
  const SolidProperties low = solid_properties(symbolic_product(f.clipped(-20, cut)));
  const SolidProperties high = solid_properties(symbolic_product(f.clipped(cut, 60)));
  RC_ASSERT(std::abs((low.volume_mm3 + high.volume_mm3) / whole.volume_mm3 - 1) < 1e-13);
  RC_ASSERT(std::abs((low.lateral_area_mm2 + high.lateral_area_mm2) / whole.lateral_area_mm2 - 1) < 1e-12);
  RC_ASSERT(std::abs(low.end_cap_area_mm2 / high.start_cap_area_mm2 - 1) < 1e-12);
  const Eigen::Vector3d centroid =
      (low.volume_mm3 * low.centroid_mm + high.volume_mm3 * high.centroid_mm) / whole.volume_mm3;
  RC_ASSERT((centroid - whole.centroid_mm).norm() < 1e-11);
  Eigen::Matrix3d inertia = Eigen::Matrix3d::Zero();
  for (const SolidProperties* part : {&low, &high}) {
    const Eigen::Vector3d d = part->centroid_mm - whole.centroid_mm;
    inertia +=
        part->inertia_mm5 + part->volume_mm3 * (d.squaredNorm() * Eigen::Matrix3d::Identity() - d * d.transpose());
  }
  RC_ASSERT((inertia - whole.inertia_mm5).norm() < 1e-11 * whole.inertia_mm5.norm());
}

TEST(SolidProperties, WhatEnclosesNothingIsRefused) {
  NurbsSurface open = test::sphere(10, -0.5, 1.2);
  open.closed_v = false;
  EXPECT_THROW(solid_properties(open), std::invalid_argument);
  NurbsSurface weightless = test::sphere(10, -0.5, 1.2);
  weightless.control_points(3, 4) = 0;
  EXPECT_THROW(solid_properties(weightless), std::invalid_argument);
  NurbsSurface flat = test::sphere(10, -0.5, 1.2);
  flat.control_points.row(2).setZero();
  EXPECT_THROW(solid_properties(flat), std::invalid_argument);
  NurbsSurface short_of_points = test::sphere(10, -0.5, 1.2);
  short_of_points.control_points.conservativeResize(4, 20);
  EXPECT_THROW(solid_properties(short_of_points), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
