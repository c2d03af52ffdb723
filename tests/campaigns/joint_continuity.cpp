// What the curvature-continuous range space is worth, against simple knots: largest fit errors of a smooth section over
// the number of coefficients, and the curvature jump at the four meridians from evaluated points of the exact surface.
// Writes joint_continuity.csv into the folder given (default: the current one).
#include <Eigen/Dense>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <string>

#include "fitting/nurbs_surface.h"
#include "fitting/range_function.h"
#include "fitting/range_space.h"
#include "tests/fitting/meridian_curvature.h"
#include "tests/fitting/spline_tools.h"

namespace {

using celadon::JointContinuity;
using celadon::RangeSpace;

const celadon::BaseArcs kCircle = celadon::BaseArcs::full_circle();

struct Fit {
  RangeSpace space;
  Eigen::VectorXd free;
  double largest_error = 0;
};

// Dense least squares on equal angles, at least 8000 and 40 an interval.
Fit fit(int degree, int intervals_per_arc, JointContinuity continuity) {
  RangeSpace space = RangeSpace::over(degree, kCircle, intervals_per_arc, continuity);
  const int n = std::max(8000, 160 * intervals_per_arc);
  Eigen::VectorXd v(n), r(n);
  for (int i = 0; i < n; ++i) {
    const double theta = (i + 0.5) / n * 2 * std::numbers::pi;
    v[i] = kCircle.v_of_theta(theta);
    r[i] = celadon::test::wavy_radius(theta);
  }
  const Eigen::MatrixXd A = celadon::test::collocation(space, v);
  const Eigen::LLT<Eigen::MatrixXd> gram(A.transpose() * A);
  Eigen::VectorXd free = gram.solve(A.transpose() * r);
  free += gram.solve(A.transpose() * (r - A * free));  // one refinement: errors near rounding are wanted
  const double error = (A * free - r).cwiseAbs().maxCoeff();
  return {std::move(space), std::move(free), error};
}

celadon::NurbsSurface surface_of(const Fit& fit) {
  celadon::BaseSurface base;
  base.band_end = 50;
  return celadon::symbolic_product(
      {base, 0, fit.space.degree(), {0, 1}, fit.space.knots(), (fit.space.extraction() * fit.free).transpose()});
}

const char* name(JointContinuity continuity) {
  return continuity == JointContinuity::curvature ? "curvature" : "thesis";
}

}  // namespace

int main(int argc, char** argv) {
  const std::string path = std::string(argc > 1 ? argv[1] : ".") + "/joint_continuity.csv";
  std::FILE* csv = std::fopen(path.c_str(), "w");
  if (!csv) {
    std::fprintf(stderr, "joint_continuity: cannot write %s; give a folder that exists\n", path.c_str());
    return 2;
  }
  std::fprintf(csv, "space,degree,coefficients,largest_error_mm\n");
  std::printf("Largest error of the least squares fit to r = 30 + 3cos(2t+.3) + 1.5cos(5t+1) + .8sin(3t) mm\n");
  std::printf("%-10s %6s %12s %12s %6s\n", "space", "degree", "coefficients", "error (mm)", "order");
  for (const auto continuity : {JointContinuity::thesis, JointContinuity::curvature}) {
    for (int degree = 3; degree <= 5; ++degree) {
      double count_before = 0, error_before = 0;
      for (int m = 2; m <= 64; m *= 2) {
        const Fit result = fit(degree, m, continuity);
        const double count = result.space.free_count(), error = result.largest_error;
        std::fprintf(csv, "%s,%d,%d,%.6e\n", name(continuity), degree, result.space.free_count(), error);
        std::printf("%-10s %6d %12d %12.2e", name(continuity), degree, result.space.free_count(), error);
        if (count_before > 0) std::printf(" %6.1f", std::log(error_before / error) / std::log(count / count_before));
        std::printf("\n");
        count_before = count, error_before = error;
      }
    }
  }
  if (std::fclose(csv) != 0) {
    std::fprintf(stderr, "joint_continuity: writing %s failed; is there space left?\n", path.c_str());
    return 4;
  }

  // Both sides of a meridian by one-sided differences of S(u, v); the same differences in the middle of a knot
  // interval, where the surface is analytic, show what they resolve.
  std::printf(
      "\nCurvature jump (1/mm) across meridians, by finite differences of evaluated points, 16 intervals an arc\n");
  std::printf("%-10s %6s %12s %12s %12s %12s %14s\n", "space", "degree", "0 deg", "90 deg", "180 deg", "270 deg",
              "inside an arc");
  for (const auto continuity : {JointContinuity::thesis, JointContinuity::curvature}) {
    for (int degree = 3; degree <= 5; ++degree) {
      const celadon::NurbsSurface surface = surface_of(fit(degree, 16, continuity));
      const double step = 1.0 / 512;
      std::printf("%-10s %6d", name(continuity), degree);
      for (int j = 0; j < 4; ++j)
        std::printf(" %12.1e", std::abs(celadon::test::curvature_jump(surface, 0.5, j, step)));
      std::printf(" %14.1e\n", std::abs(celadon::test::curvature_jump(surface, 0.5, 0.5 + 0.5 / 16, step)));
    }
  }
  std::printf("\nwrote %s\n", path.c_str());
  return 0;
}
