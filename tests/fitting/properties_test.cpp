// What holds for every knot vector, degree, range and frame: random ones, each against what it says of itself.

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "fitting/bspline_basis.h"
#include "fitting/nurbs_surface.h"
#include "tests/fitting/solid_tools.h"
#include "tests/fitting/sphere_tools.h"
#include "tests/fitting/spline_tools.h"

namespace celadon {
namespace {

using test::kPi;
using test::uniform;

int whole(std::mt19937_64& random, int lo, int hi) {
  return std::uniform_int_distribution<int>(lo, hi)(random);
}

// Clamped, with interior knots of any multiplicity.
std::vector<double> random_knots(std::mt19937_64& random, int degree) {
  std::vector<double> knots(static_cast<std::size_t>(degree) + 1, 0.0);
  double at = 0;
  for (int k = whole(random, 0, 6); k > 0; --k) {
    at += uniform(random, 0.01, 1);
    knots.insert(knots.end(), static_cast<std::size_t>(whole(random, 1, degree)), at);
  }
  knots.insert(knots.end(), static_cast<std::size_t>(degree) + 1, at + uniform(random, 0.01, 1));
  return knots;
}

BaseArcs random_arcs(std::mt19937_64& random) {
  if (whole(random, 0, 1) == 0) return BaseArcs::full_circle();
  return BaseArcs::open(uniform(random, -3, 3), uniform(random, 0.5, 2 * kPi));
}

Eigen::Isometry3d random_frame(std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  const auto any = [&] { return normal(random); };
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.linear() = Eigen::Quaterniond(any(), any(), any(), any()).normalized().toRotationMatrix();
  X.translation() = 50 * Eigen::Vector3d(any(), any(), any());
  return X;
}

RC_GTEST_PROP(Properties, FunctionsSumToOneAndAreNotNegative, (std::uint64_t seed)) {
  std::mt19937_64 random(seed);
  const int degree = whole(random, 1, 7);
  const auto knots = random_knots(random, degree);
  for (int k = 0; k < 20; ++k) {
    const double t = uniform(random, knots.front(), knots.back());
    const int span = find_span(knots, degree, t);
    const auto N = basis_values(knots, degree, span, t);
    const auto D = basis_derivatives(knots, degree, span, t);
    double sum = 0, slope = 0, size = 1;
    for (int a = 0; a <= degree; ++a) {
      const auto at = static_cast<std::size_t>(a);
      RC_ASSERT(N[at] >= 0);
      sum += N[at];
      slope += D[1][at];
      size = std::max(size, std::abs(D[1][at]));
    }
    RC_ASSERT(std::abs(sum - 1) < 1e-13);
    RC_ASSERT(std::abs(slope) < 1e-12 * size);
  }
}

// Control points moved, turned, sheared and scaled are the surface of points moved, turned, sheared and scaled.
RC_GTEST_PROP(Properties, SurfacesAreAffineInvariant, (std::uint64_t seed)) {
  std::mt19937_64 random(seed);
  NurbsSurface surface;
  surface.degree_u = whole(random, 1, 7);
  surface.degree_v = whole(random, 1, 7);
  surface.knots_u = random_knots(random, surface.degree_u);
  surface.knots_v = random_knots(random, surface.degree_v);
  surface.control_points.resize(4, surface.count_u() * surface.count_v());
  for (Eigen::Index k = 0; k < surface.control_points.cols(); ++k) {
    const double w = uniform(random, 0.3, 3);
    surface.control_points.col(k) << w * uniform(random, -9, 9), w * uniform(random, -9, 9), w * uniform(random, -9, 9),
        w;
  }
  Eigen::Affine3d X = Eigen::Affine3d::Identity();
  for (double& x : X.linear().reshaped()) x = uniform(random, -2, 2);
  X.translation() << uniform(random, -9, 9), uniform(random, -9, 9), uniform(random, -9, 9);
  NurbsSurface moved = surface;
  moved.control_points = X.matrix() * surface.control_points;
  for (int k = 0; k < 20; ++k) {
    const double u = uniform(random, 0, surface.knots_u.back()), v = uniform(random, 0, surface.knots_v.back());
    RC_ASSERT((moved.evaluate(u, v) - X * surface.evaluate(u, v)).norm() < 1e-11);
  }
}

// A random member of a random space, sampled without noise, is what comes back: over cylinders and spheres, whole
// turns and open ranges, every degree.
RC_GTEST_PROP(Properties, RandomMembersComeBack, (std::uint64_t seed)) {
  std::mt19937_64 random(seed);
  const bool sphere = whole(random, 0, 1) == 1;
  const BaseArcs arcs = sphere ? BaseArcs::full_circle() : random_arcs(random);
  const int p = whole(random, 1, 5), q = whole(random, 1, 5), m = 1 << whole(random, 0, 2);
  // A band of the sphere that leaves both poles open.
  const double lo = sphere ? 0.25 : uniform(random, -50, 0), hi = sphere ? 1.75 : uniform(random, 20, 100);
  const GridSpecification grid{
      sphere ? 0.0 : lo, sphere ? 2.0 : hi, 8, m, p, q, arcs, sphere ? BaseKind::sphere : BaseKind::cylinder};
  std::vector<double> breaks;
  for (int i = sphere ? 1 : 0; i <= (sphere ? 7 : 8); ++i)
    breaks.push_back(grid.z_start_mm + (grid.z_end_mm - grid.z_start_mm) * i / 8);
  const FitSpace space{sphere ? RangeSpace::over(p, BaseSurface::meridian(), breaks, JointContinuity::curvature)
                              : RangeSpace::open(p, breaks),
                       RangeSpace::over(q, arcs, m)};
  Eigen::MatrixXd free(space.u.free_count(), space.v.free_count());
  for (double& c : free.reshaped()) c = 30 + uniform(random, -2, 2);
  BaseSurface base;
  base.kind = grid.base;
  base.arcs = arcs;
  base.band_start = lo;
  base.band_end = hi;
  std::vector<double> knots_u = space.u.knots();
  if (!sphere)
    for (double& k : knots_u) k = std::clamp((k - lo) / (hi - lo), 0.0, 1.0);
  const RangeFunction truth(base, p, q, knots_u, space.v.knots(),
                            space.u.extraction() * free * Eigen::MatrixXd(space.v.extraction().transpose()));
  MomentGrid sums(grid);
  std::vector<double> r, theta, z;
  for (int k = 0; k < 30 * static_cast<int>(free.size()); ++k) {
    theta.push_back(arcs.theta_of_v(uniform(random, 0, arcs.count())));
    z.push_back(uniform(random, lo, hi));
    r.push_back(truth(theta.back(), z.back()));
  }
  sums.add(r, theta, z);
  const NormalEquations equations(sums, space);
  const auto solved = NormalSolver(equations).solve();
  RC_ASSERT(solved.has_value());
  RC_ASSERT((*solved - free).cwiseAbs().maxCoeff() < 1e-7);
}

// Exactly, and no more general than that, whatever the size and wherever it lies.
RC_GTEST_PROP(Properties, RoundBodiesAreExact, (std::uint64_t seed)) {
  std::mt19937_64 random(seed);
  const double R = std::exp(uniform(random, -2, 6)), height = R * uniform(random, 0.3, 5),
               low = R * uniform(random, -3, 3);
  const int p = whole(random, 1, 5), kind = whole(random, 0, 2);
  RangeFitOptions options;
  options.degree_u = p;
  options.degree_v = whole(random, 1, 5);
  if (kind == 2) {
    test::MemoryStream stream =
        test::scattered_body([&](double, double) { return R; }, {.samples = 4000, .centre_z = low, .seed = 3});
    const auto fit = test::fit_sphere(stream, options, low);
    RC_ASSERT(fit.has_value());
    RC_ASSERT(fit->report.degree_u == 2);
    RC_ASSERT(fit->report.degree_v == 2);
    RC_ASSERT(std::abs(fit->function(0.3, 1) - R) < 1e-9 * R);
    return;
  }
  const double slope = kind == 0 ? 0 : uniform(random, -0.15, 0.5) * R / height;
  test::MemoryStream stream;
  for (int i = 0; i < 48; ++i) {
    Profile profile;
    for (int j = 0; j < 64; ++j)
      test::push(profile, R + slope * height * j / 63, 2 * kPi * (i + 0.3) / 48, low + height * j / 63);
    stream.profiles.push_back(std::move(profile));
  }
  const auto fit = test::fit(stream, options);
  RC_ASSERT(fit.has_value());
  RC_ASSERT(fit->report.model == (kind == 0 ? SurfaceModel::cylinder : SurfaceModel::revolution) ||
            std::abs(slope) * height < 1e-6 * R);
  RC_ASSERT(fit->report.degree_v == 2);
  RC_ASSERT(fit->report.degree_u == (kind == 0 ? 1 : std::max(p, 1)));
  for (int k = 0; k < 20; ++k) {
    const double z = uniform(random, fit->report.z_start_mm, fit->report.z_end_mm);
    RC_ASSERT(std::abs(fit->function(uniform(random, 0, 6), z) - (R + slope * (z - low))) < 1e-9 * R);
  }
}

// A body in any frame has there the surface that it has in its own.
RC_GTEST_PROP(Properties, SurfacesMoveWithTheirFrame, (std::uint64_t seed)) {
  std::mt19937_64 random(seed);
  const Eigen::Isometry3d X = random_frame(random);
  BaseSurface base = test::band(-10, 30);
  const RangeSpace space = RangeSpace::over(whole(random, 1, 5), base.arcs, whole(random, 1, 4));
  Eigen::MatrixXd free(2, space.free_count());
  for (double& c : free.reshaped()) c = uniform(random, 20, 25);
  const auto in = [&](const Eigen::Isometry3d& frame) {
    base.X_WB = frame;
    return RangeFunction(base, 1, space.degree(), {0, 0, 1, 1}, space.knots(),
                         free * Eigen::MatrixXd(space.extraction().transpose()));
  };
  const RangeFunction own = in(Eigen::Isometry3d::Identity()), there = in(X);
  const NurbsSurface own_surface = symbolic_product(own), there_surface = symbolic_product(there);
  for (int k = 0; k < 20; ++k) {
    const double t = uniform(random, 0, 2 * kPi), z = uniform(random, -10, 30), u = uniform(random, 0, 1),
                 v = uniform(random, 0, 4);
    const SurfacePoint a = own.surface_point(t, z), b = there.surface_point(t, z);
    RC_ASSERT((X * a.p_W - b.p_W).norm() < 1e-11);
    RC_ASSERT((X.linear() * a.normal_W - b.normal_W).norm() < 1e-11);
    RC_ASSERT(std::abs(a.curvature_max - b.curvature_max) < 1e-12);
    RC_ASSERT((X * own_surface.evaluate(u, v) - there_surface.evaluate(u, v)).norm() < 1e-10);
    const Eigen::Vector3d p = X * Eigen::Vector3d(30 * std::cos(t), 30 * std::sin(t), z);
    RC_ASSERT(std::abs(there.membership(p).ray_mm - (30 - own(t, z))) < 1e-10);
  }
}

// However samples are dealt out to machines, what they sum up to is the same.
RC_GTEST_PROP(Properties, MergedSumsAreThoseOfAll, (std::uint64_t seed)) {
  std::mt19937_64 random(seed);
  const GridSpecification grid{-5,
                               60,
                               1 << whole(random, 1, 4),
                               1 << whole(random, 0, 3),
                               whole(random, 1, 5),
                               whole(random, 1, 5),
                               random_arcs(random),
                               BaseKind::cylinder};
  const int machines = whole(random, 2, 5);
  MomentGrid all(grid), merged(grid);
  std::vector<MomentGrid> part(static_cast<std::size_t>(machines), MomentGrid(grid));
  for (int profile = 0; profile < 30; ++profile) {
    std::vector<double> r, theta, z;
    for (int k = whole(random, 0, 40); k > 0; --k) {
      r.push_back(uniform(random, -1, 40));
      theta.push_back(uniform(random, -7, 7));
      z.push_back(uniform(random, -10, 65));
    }
    all.add(r, theta, z);
    part[static_cast<std::size_t>(whole(random, 0, machines - 1))].add(r, theta, z);
  }
  for (const MomentGrid& one : part) merged.merge(one);
  RC_ASSERT(merged.samples() == all.samples());
  RC_ASSERT(merged.rejected() == all.rejected());
  std::vector<double> a(all.packed_size()), b(a.size());
  for (int j = 0; j < all.v_cells(); ++j)
    for (int i = 0; i < all.z_cells(); ++i) {
      all.pack(i, j, a.data());
      merged.pack(i, j, b.data());
      for (std::size_t k = 0; k < a.size(); ++k)
        RC_ASSERT(std::abs(a[k] - b[k]) <= 1e-12 * (1 + 1600 * all.cell_weight(i, j)));
    }
}

}  // namespace
}  // namespace celadon
