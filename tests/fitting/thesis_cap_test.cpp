// The thesis's cap against closed forms: what it meets exactly, and where it ends.
#include "fitting/thesis_cap.h"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

#include "tests/fitting/sphere_tools.h"

namespace celadon {
namespace {

using test::kPi;

// A fit around a hole of half an arc.
RangeFunction around_hole(const test::Body& body) {
  const double hole = 0.25;
  test::MemoryStream stream = test::scattered_body(
      body, {.samples = 60000, .phi_low = BaseSurface::meridian().theta_of_v(hole), .phi_high = kPi});
  RangeFitOptions options;
  options.model = SurfaceModel::general;
  options.z_intervals = 32;
  options.intervals_per_arc = 8;
  options.robust = options.smoothing = false;
  options.reach_start = hole;
  const auto fit = test::fit_sphere(stream, options);
  EXPECT_TRUE(fit) << fit.error().message;
  return fit->function;
}

double angle(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

TEST(ThesisCap, EquationsD_11_And_3_24_CloseASphereOffItsCentre) {
  const Eigen::Vector3d centre(3, 1, 2);
  const RangeFunction around = around_hole(test::off_centre_sphere(25, centre));
  const ThesisCap cap = thesis_cap(around);
  EXPECT_EQ(cap.surface.degree_u, 5);
  EXPECT_EQ(cap.surface.degree_v, 5);
  // p* (3.20) lies on the sphere, n* (3.21) is its normal there; both as well as quintics follow half a radian of a
  // circle.
  EXPECT_NEAR((cap.point - centre).norm(), 25, 0.02);
  EXPECT_LT(angle(cap.normal, cap.point - centre), 5e-3);
  const NurbsSurface surface = symbolic_product(around);
  const double turn = surface.knots_v.back();
  for (int k = 0; k < 50; ++k) {
    const double v = turn * (k + 0.4) / 50;
    // One point, one tangent plane (3.12), and the surface's own rim, exactly.
    EXPECT_LT((cap.surface.evaluate(0, v) - cap.point).norm(), 1e-9);
    EXPECT_LT((cap.surface.evaluate(1, v) - surface.evaluate(surface.knots_u.front(), v)).norm(), 1e-9);
    for (const double u : {0.2, 0.5, 0.8}) EXPECT_NEAR((cap.surface.evaluate(u, v) - centre).norm(), 25, 0.03);
  }
  // The tangent plane is exact at the nodes and close to it between them.
  for (int k = 0; k < 50; ++k) {
    const auto d = cap.surface.derivatives(1e-6, turn * (k + 0.4) / 50);
    EXPECT_LT(std::abs(d.S_u.normalized().dot(cap.normal)), 2e-3);
  }
}

// A body of revolution leaves (D.11) open: the natural scale is taken, and the pole lies on the axis.
TEST(ThesisCap, RoundBodiesAreClosedOnTheirAxis) {
  const ThesisCap cap = thesis_cap(around_hole([](double, double) { return 20.0; }));
  EXPECT_LT(cap.point.head<2>().norm(), 1e-9);
  EXPECT_NEAR(cap.point.z(), 20, 0.05);
  EXPECT_LT(angle(cap.normal, Eigen::Vector3d::UnitZ()), 1e-9);
}

TEST(ThesisCap, RefusesWhatHasNoHole) {
  test::MemoryStream stream = test::scattered_body([](double, double) { return 20.0; }, {});
  const auto closed = test::fit_sphere(stream);
  ASSERT_TRUE(closed);
  EXPECT_THROW(thesis_cap(closed->function), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
