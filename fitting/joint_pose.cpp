#include "fitting/joint_pose.h"

#include <Eigen/Dense>
#include <algorithm>
#include <bit>
#include <cmath>
#include <vector>

#include "fitting/cell_polynomials.h"
#include "fitting/fit_report.h"
#include "fitting/moment_grid.h"
#include "fitting/moved_stream.h"
#include "fitting/normal_solver.h"
#include "fitting/residual_pass.h"
#include "fitting/robust_least_squares.h"

namespace celadon {
namespace {

constexpr int kMostIterations = 25;
constexpr double kDone = 0.01;  // of a standard deviation
constexpr int kMostAlong = 128, kMostPerArc = 32;
// Moments count positive values only: slopes are summed with this added, and steeper places are left out.
constexpr double kOffset = 64;
// A direction that the surface absorbs to this share moves nothing.
constexpr double kAbsorbed = 1e-6;
// The scale of misfits before the poses fit, in their means; in each step it is half of what it was, down to the noise.
constexpr double kFirstScales = 4;
constexpr double kLeastScale = 1e-9;

std::vector<int> columns_of(PoseFreedom freedom, bool round) {
  if (freedom == PoseFreedom::along_axis) return {2};
  if (freedom == PoseFreedom::along_about) return round ? std::vector<int>{2} : std::vector<int>{2, 5};
  return round ? std::vector<int>{0, 1, 2, 3, 4} : std::vector<int>{0, 1, 2, 3, 4, 5};
}

GridSpecification grid_of(const RangeFunction& wall) {
  const BaseSurface& base = wall.base();
  GridSpecification grid;
  grid.z_start_mm = base.band_start;
  grid.z_end_mm = base.band_end;
  const auto power = [](Eigen::Index count, int most) {
    return std::clamp(static_cast<int>(std::bit_ceil(static_cast<unsigned>(count))), 4, most);
  };
  grid.z_intervals = power(wall.coefficients().rows(), kMostAlong);
  grid.intervals_per_arc =
      wall.degree_v() == 0 ? 1 : power(wall.coefficients().cols() / base.arcs.count(), kMostPerArc);
  grid.arcs = base.arcs;
  return grid;
}

double mean_misfit(const RangeFunction& wall, ProfileStream& second, const GridSpecification& grid) {
  const CellPolynomials F(wall);
  Residuals to_wall;
  double sum = 0, count = 0;
  for (ResidualPass pass(second, grid.arcs); const Profile* p = pass.next();) {
    pass.compare(F, to_wall, false);
    for (std::size_t k = 0; k < p->size(); ++k)
      if (pass.usable(k, grid.z_start_mm, grid.z_end_mm)) sum += std::abs(to_wall.residual[k]), ++count;
  }
  return count > 0 ? sum / count : 0;
}

// Sums of one step: all samples, and of the second ones those of 1 and of each slope as the range.
struct Sums {
  MomentGrid all, ones;
  std::vector<MomentGrid> slopes;
  Eigen::MatrixXd D;     // sum of w J J'
  Eigen::VectorXd by_r;  // sum of w J r
  double count = 0;      // of second samples with weight
  Sums(const GridSpecification& grid, std::size_t unknowns)
      : all(grid), ones(grid), slopes(unknowns, MomentGrid(grid)) {
    D.setZero(static_cast<Eigen::Index>(unknowns), static_cast<Eigen::Index>(unknowns));
    by_r.setZero(D.rows());
  }
};

void add_first(Sums& sums, ProfileStream& first, const GridSpecification& grid, const CellPolynomials& F,
               double scale) {
  Residuals to_wall;
  std::vector<double> weight;
  for (ResidualPass pass(first, grid.arcs); const Profile* p = pass.next();) {
    pass.compare(F, to_wall, false);
    weight.assign(p->size(), 0);
    for (std::size_t k = 0; k < p->size(); ++k)
      if (pass.usable(k, grid.z_start_mm, grid.z_end_mm)) weight[k] = tukey_weight(to_wall.residual[k], scale);
    sums.all.add_synchronised(p->r_mm, pass.v(), p->z_mm, weight);
  }
}

void add_second(Sums& sums, ProfileStream& second, const GridSpecification& grid, const CellPolynomials& F,
                const std::vector<int>& columns, double length_mm, double scale) {
  Residuals to_wall;
  std::vector<double> weight, one;
  std::vector<std::vector<double>> slope(columns.size());
  Eigen::VectorXd J(static_cast<Eigen::Index>(columns.size()));
  for (ResidualPass pass(second, grid.arcs); const Profile* p = pass.next();) {
    pass.compare(F, to_wall, true);
    weight.assign(p->size(), 0);
    one.assign(p->size(), 1);
    for (auto& of : slope) of.assign(p->size(), kOffset);
    for (std::size_t k = 0; k < p->size(); ++k) {
      if (!pass.usable(k, grid.z_start_mm, grid.z_end_mm)) continue;
      const double r = p->r_mm[k], t = p->theta_rad[k], c = std::cos(t), s = std::sin(t);
      // Gradient of r - F.
      const double across = -to_wall.r_theta[k] / r;
      const Eigen::Vector3d g(c - across * s, s + across * c, -to_wall.r_z[k]);
      const Eigen::Vector3d turned = Eigen::Vector3d(r * c, r * s, p->z_mm[k]).cross(g) / length_mm;
      for (std::size_t a = 0; a < columns.size(); ++a)
        J[static_cast<Eigen::Index>(a)] = columns[a] < 3 ? g[columns[a]] : turned[columns[a] - 3];
      if (!(J.cwiseAbs().maxCoeff() < kOffset)) continue;
      weight[k] = tukey_weight(to_wall.residual[k], scale);
      if (weight[k] <= 0) continue;
      for (std::size_t a = 0; a < columns.size(); ++a) slope[a][k] = kOffset + J[static_cast<Eigen::Index>(a)];
      sums.D += weight[k] * J * J.transpose();
      sums.by_r += weight[k] * r * J;
      sums.count += 1;
    }
    sums.all.add_synchronised(p->r_mm, pass.v(), p->z_mm, weight);
    sums.ones.add_synchronised(one, pass.v(), p->z_mm, weight);
    for (std::size_t a = 0; a < columns.size(); ++a)
      sums.slopes[a].add_synchronised(slope[a], pass.v(), p->z_mm, weight);
  }
}

}  // namespace

tl::expected<JointPose, FitError> refine_pose(const RangeFunction& wall, ProfileStream& first, ProfileStream& second,
                                              PoseFreedom freedom, double noise_mm) {
  require_cylinder(wall, "refine_pose");
  const GridSpecification grid = grid_of(wall);
  const std::vector<int> columns = columns_of(freedom, wall.degree_v() == 0);
  const auto unknowns = static_cast<Eigen::Index>(columns.size());
  const double length_mm = wall.coefficients().maxCoeff();  // by which turns are made lengths
  std::vector<double> breaks;
  for (int i = 0; i <= grid.z_intervals; ++i)
    breaks.push_back(grid.z_start_mm + (grid.z_end_mm - grid.z_start_mm) * i / grid.z_intervals);
  const FitSpace space{RangeSpace::open(grid.degree_u, breaks),
                       wall.degree_v() == 0 ? RangeSpace::constant({0, static_cast<double>(grid.arcs.count())})
                                            : RangeSpace::over(grid.degree_v, grid.arcs, grid.intervals_per_arc)};

  JointPose result;
  RangeFunction surface = wall;
  const double least = std::max(noise_mm, kLeastScale * length_mm);
  double scale = std::max(least, kFirstScales * mean_misfit(wall, second, grid));
  for (;; ++result.iterations) {
    Sums sums(grid, columns.size());
    const CellPolynomials F(surface);
    MovedStream moved(second, result.X_12);
    add_first(sums, first, grid, F, scale);
    add_second(sums, moved, grid, F, columns, length_mm, scale);
    const NormalEquations equations(sums.all, space);
    NormalSolver solver(equations, 1e-9, {.direct = true});
    const auto free = sums.count > 0 ? solver.solve() : std::nullopt;
    if (!free)
      return tl::unexpected(
          FitError{"the two sets of samples have too little of the wall in common; scan more of it in both"});
    surface = range_function(equations, *free);

    const NormalEquations of_ones(sums.ones, space);
    const Eigen::MatrixXd none = Eigen::MatrixXd::Zero(free->rows(), free->cols()), ones = of_ones.gradient(none);
    std::vector<Eigen::MatrixXd> B;
    for (const MomentGrid& slopes : sums.slopes)
      B.emplace_back(NormalEquations(slopes, space).gradient(none) - kOffset * ones);
    Eigen::MatrixXd schur = sums.D;
    Eigen::VectorXd gradient(unknowns);
    for (Eigen::Index a = 0; a < unknowns; ++a) {
      gradient[a] = sums.by_r[a] - B[static_cast<std::size_t>(a)].cwiseProduct(*free).sum();
      const auto absorbed = solver.apply_inverse(B[static_cast<std::size_t>(a)]);
      for (Eigen::Index b = 0; b < unknowns; ++b)
        schur(a, b) -= absorbed->cwiseProduct(B[static_cast<std::size_t>(b)]).sum();
    }
    schur = (schur + schur.transpose()).eval() / 2;
    const Eigen::VectorXd unit = sums.D.diagonal().cwiseSqrt();
    const Eigen::MatrixXd relative = unit.cwiseInverse().asDiagonal() * schur * unit.cwiseInverse().asDiagonal();
    if (!(unit.minCoeff() > 0) ||
        !(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(relative).eigenvalues()[0] > kAbsorbed))
      return tl::unexpected(
          FitError{"the wall that both sets of samples see slides along itself: how the second lies does not show; "
                   "name its pose "
                   "exactly, or scan more of what both see"});
    const Eigen::LDLT<Eigen::MatrixXd> solved(schur);
    const Eigen::VectorXd step = solved.solve(-gradient);
    const Eigen::MatrixXd covariance = solved.solve(Eigen::MatrixXd::Identity(unknowns, unknowns)) * (least * least);

    Eigen::Vector3d shift = Eigen::Vector3d::Zero(), turn = shift;
    bool done = scale <= least;
    for (std::size_t a = 0; a < columns.size(); ++a) {
      const auto at = static_cast<Eigen::Index>(a);
      const bool turns = columns[a] >= 3;
      (turns ? turn[columns[a] - 3] : shift[columns[a]]) = step[at] / (turns ? length_mm : 1);
      const double sd = std::sqrt(covariance(at, at));
      if (columns[a] == 2) result.shift_sd_mm = sd;
      if (columns[a] == 5) result.turn_sd_rad = sd / length_mm;
      done = done && std::abs(step[at]) < kDone * sd;
    }
    Eigen::Isometry3d by = Eigen::Isometry3d::Identity();
    if (turn.norm() > 0) by.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
    by.translation() = shift;
    result.X_12 = by * result.X_12;
    scale = std::max(least, scale / 2);
    if (done) return result;
    if (result.iterations == kMostIterations)
      return tl::unexpected(FitError{text(
          "the pose of the second set of samples did not settle in %d steps; name it more exactly", kMostIterations)});
  }
}

}  // namespace celadon
