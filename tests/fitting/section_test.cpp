// Sections against circles in closed form, the surface's own points, polygons, dense samples and the solid's volume.
#include "fitting/section.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <numbers>
#include <random>

#include "fitting/knots.h"
#include "fitting/solid_properties.h"
#include "tests/fitting/solid_tools.h"

namespace celadon {
namespace {

using std::numbers::pi;

TEST(Section, OfACylinderIsItsCircle) {
  BaseSurface base = test::band(-10, 30);
  base.X_WB.translation() << 3, -4, 100;
  const RangeFunction f(base, 0, 0, {0, 1}, {0, 4}, Eigen::MatrixXd::Constant(1, 1, 25));
  for (const double z : {-10.0, 7.5, 30.0}) {
    const Section s = section(f, z);
    EXPECT_EQ(s.degree, 2);
    EXPECT_EQ(s.control_points.cols(), 9);
    EXPECT_NEAR(s.perimeter_mm, 50 * pi, 1e-12);
    EXPECT_NEAR(s.area_mm2, 625 * pi, 1e-11);
    EXPECT_LT((s.centroid_mm - Eigen::Vector3d(3, -4, 100 + z)).norm(), 1e-13);
    EXPECT_EQ(s.largest_radius.value_mm, 25);
    EXPECT_EQ(s.smallest_radius.value_mm, 25);
    for (int k = 0; k < 100; ++k) {
      const Eigen::Vector3d p = s.point(k / 25.0);
      EXPECT_NEAR((p - Eigen::Vector3d(3, -4, 100 + z)).norm(), 25, 1e-13);
    }
  }
}

// r(theta) = d cos(theta - a) + sqrt(R^2 - d^2 sin^2(theta - a)), interpolated ever more finely: area, perimeter,
// centroid and radii converge to the circle's with the fourth power at least.
TEST(Section, OfAnOffCentreCylinderConvergesToItsCircle) {
  const double R = 20, d = 6, a = 0.7;
  double last = 0;
  for (const int m : {4, 8, 16}) {
    const RangeSpace space = RangeSpace::over(3, BaseArcs::full_circle(), m);
    const BaseArcs arcs = BaseArcs::full_circle();
    const int n = 64 * m;
    Eigen::VectorXd v(n), r(n);
    for (int k = 0; k < n; ++k) {
      const double t = 2 * pi * (k + 0.5) / n;
      v[k] = arcs.v_of_theta(t);
      r[k] = d * std::cos(t - a) + std::sqrt(R * R - std::pow(d * std::sin(t - a), 2));
    }
    const Eigen::VectorXd free = test::collocation(space, v).householderQr().solve(r);
    const RangeFunction f(test::band(0, 10), 0, 3, {0, 1}, space.knots(), (space.extraction() * free).transpose());
    const Section s = section(f, 5);
    const double misses[] = {std::abs(s.perimeter_mm / (2 * pi * R) - 1), std::abs(s.area_mm2 / (pi * R * R) - 1),
                             (s.centroid_mm - Eigen::Vector3d(d * std::cos(a), d * std::sin(a), 5)).norm() / R,
                             std::abs(s.largest_radius.value_mm - (R + d)) / R,
                             std::abs(s.smallest_radius.value_mm - (R - d)) / R};
    const double miss = *std::max_element(std::begin(misses), std::end(misses));
    if (m > 4) {
      EXPECT_LT(miss, last / 14) << m;
    }
    last = miss;
    EXPECT_NEAR(s.largest_radius.theta_rad, a, 0.01);
    EXPECT_NEAR(s.smallest_radius.theta_rad, a + pi, 0.01);
  }
  EXPECT_LT(last, 2e-7);
}

RC_GTEST_PROP(Section, IsTheSurfacesOwnCurve, (unsigned seed)) {
  std::mt19937_64 random(seed);
  BaseSurface base = test::band(-20, 60);
  base.X_WB = test::random_placement(random);
  const RangeFunction f = test::random_body(random, base);
  const NurbsSurface surface = symbolic_product(f);
  const double u = random() % 4 ? test::uniform(random, 0, 1) : static_cast<double>(random() % 2);
  const Section s = section(f, -20 + 80 * u);
  RC_ASSERT(s.degree == surface.degree_v);
  RC_ASSERT(s.knots == surface.knots_v);
  RC_ASSERT(s.control_points.leftCols<1>() == s.control_points.rightCols<1>());
  for (int k = 0; k < 50; ++k) {
    const double v = test::uniform(random, 0, 4);
    RC_ASSERT((s.point(v) - surface.evaluate(u, v)).norm() < 1e-11);
  }
}

// The circle through dense points: chords fall short as the square of their length, which one extrapolation takes off.
RC_GTEST_PROP(Section, AgreesWithPolygonsAndDenseSamples, (unsigned seed)) {
  std::mt19937_64 random(seed);
  BaseSurface base = test::band(-20, 60);
  base.X_WB = test::random_placement(random);
  const RangeFunction f = test::random_body(random, base);
  const double z = test::uniform(random, -20, 60);
  const Section s = section(f, z);
  const std::vector<double> breaks = breaks_of(s.knots).values;
  double perimeter[2] = {}, area[2] = {}, largest = 0, smallest = 1e9;
  Eigen::Vector2d first[2] = {Eigen::Vector2d::Zero(), Eigen::Vector2d::Zero()};
  const Eigen::Isometry3d X_BW = base.X_WB.inverse();
  for (std::size_t j = 0; j + 1 < breaks.size(); ++j)
    for (int level = 0; level < 2; ++level) {
      const int n = 200 << level;
      const auto at = [&](int k) -> Eigen::Vector2d {
        return (X_BW * s.point(breaks[j] + (breaks[j + 1] - breaks[j]) * k / n)).head<2>();
      };
      Eigen::Vector2d p = at(0);
      for (int k = 1; k <= n; ++k) {
        const Eigen::Vector2d next = at(k);
        const double triangle = (p.x() * next.y() - p.y() * next.x()) / 2;
        perimeter[level] += (next - p).norm();
        area[level] += triangle;
        first[level] += triangle * (p + next) / 3;
        p = next;
        largest = std::max(largest, p.norm());
        smallest = std::min(smallest, p.norm());
      }
    }
  const auto limit = [](const auto& level) { return level[1] + (level[1] - level[0]) / 3; };
  RC_ASSERT(std::abs(s.perimeter_mm / limit(perimeter) - 1) < 1e-8);
  RC_ASSERT(std::abs(s.area_mm2 / limit(area) - 1) < 1e-8);
  const Eigen::Vector2d centroid = (first[1] + (first[1] - first[0]) / 3) / limit(area);
  RC_ASSERT((X_BW * s.centroid_mm - Eigen::Vector3d(centroid.x(), centroid.y(), z)).norm() < 1e-6);
  RC_ASSERT(s.perimeter_error_mm < 1e-6);
  RC_ASSERT(s.largest_radius.value_mm > largest - 1e-11);
  RC_ASSERT(s.largest_radius.value_mm < largest + 1e-2);
  RC_ASSERT(s.smallest_radius.value_mm < smallest + 1e-11);
  RC_ASSERT(s.smallest_radius.value_mm > smallest - 1e-2);
  for (const Extremum& e : {s.largest_radius, s.smallest_radius}) {
    RC_ASSERT(std::abs(e.bound_mm - e.value_mm) < 1e-10);
    RC_ASSERT(std::abs(f(e.theta_rad, z) - e.value_mm) < 1e-11);
  }
}

// Cavalieri: areas over the height are the volume, their first moments the solid's. Polynomials of degree 2p between
// knots: Simpson's rule on polynomials would not do, Gauss with p + 1 points is exact.
RC_GTEST_PROP(Section, AreasOverTheHeightAreTheVolume, (unsigned seed)) {
  std::mt19937_64 random(seed);
  const RangeFunction f = test::random_body(random, test::band(-20, 60));
  const std::vector<double> breaks = breaks_of(f.knots_u()).values;
  static constexpr double kNodes[] = {0.0, 0.5384693101056831, 0.9061798459386640};
  static constexpr double kWeights[] = {0.5688888888888889, 0.4786286704993665, 0.2369268850561891};
  double volume = 0, height = 0;
  for (std::size_t i = 0; i + 1 < breaks.size(); ++i)
    for (int part = 0; part < 2; ++part)  // degree 10 with five points on halves is not exact: four digits less
      for (int k = -2; k <= 2; ++k) {
        const double width = 80 * (breaks[i + 1] - breaks[i]) / 4;
        const double z = -20 + 80 * breaks[i] + width * (2 * part + 1 + (k < 0 ? -1 : 1) * kNodes[std::abs(k)]);
        const double slice = section(f, z).area_mm2 * width * kWeights[std::abs(k)];
        volume += slice;
        height += slice * z;
      }
  const SolidProperties solid = solid_properties(symbolic_product(f));
  const double tolerance = f.degree_u() <= 4 ? 1e-13 : 1e-7;
  RC_ASSERT(std::abs(volume / solid.volume_mm3 - 1) < tolerance);
  RC_ASSERT(std::abs(height / volume - solid.centroid_mm.z()) < 100 * tolerance);
}

TEST(Section, OutsideTheBandAndOpenArcsAreRefused) {
  const RangeFunction f = test::polynomial_revolution({20, 3}, 50);
  EXPECT_THROW(section(f, -0.1), std::invalid_argument);
  EXPECT_THROW(section(f, 50.1), std::invalid_argument);
  EXPECT_THROW(section(f, std::nan("")), std::invalid_argument);
  BaseSurface base = test::band(0, 1);
  base.arcs = BaseArcs::open(0, 1);
  EXPECT_THROW(section({base, 0, 0, {0, 1}, {0, 1}, Eigen::MatrixXd::Ones(1, 1)}, 0.5), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
