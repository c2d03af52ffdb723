#include "fitting/constraints.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include "fitting/active_values.h"
#include "fitting/fit_ladder.h"
#include "fitting/fit_report.h"
#include "fitting/knot_selection.h"
#include "fitting/noise_correlation.h"

namespace celadon {
namespace {

constexpr double kSteepest_rad = 89 * std::numbers::pi / 180;
// Heights closer than this share of the larger one are one height; rows of constraints that depend on others to this
// share of their length say nothing new, or the contrary.
constexpr double kSame = 1e-9;
// Steps that bring the constraints from what the iteration leaves to rounding.
constexpr int kCorrections = 2;

// One condition on every function around: row . (free coefficients along u) = value.
struct Condition {
  HeldConstraint told;
  double z_mm = 0;
  int derivative = 0;
  double value = 0;  // mm, or mm per mm
  Eigen::RowVectorXd row{};
};

std::vector<Condition> conditions_of(const Constraints& constraints, double z_start_mm, double z_end_mm) {
  std::vector<Condition> all;
  for (const FixedRadius& at : constraints.radii)
    all.push_back({{text("radius %.6g mm at z = %.6g mm", at.radius_mm, at.z_mm), false, at.radius_mm},
                   at.z_mm,
                   0,
                   at.radius_mm});
  const auto add_angle = [&](const std::optional<double>& angle_rad, double z, const char* rim) {
    if (angle_rad)
      all.push_back(
          {{text("angle %.6g degrees at the %s rim", *angle_rad * 180 / std::numbers::pi, rim), true, *angle_rad},
           z,
           1,
           std::tan(*angle_rad)});
  };
  add_angle(constraints.angle_start_rad, z_start_mm, "lower");
  add_angle(constraints.angle_end_rad, z_end_mm, "upper");
  return all;
}

// Values, or first derivatives, of the free functions at a place.
Eigen::RowVectorXd functions_at(const RangeSpace& space, double z, int derivative) {
  const ActiveValues values(space, z, derivative);
  Eigen::RowVectorXd row = Eigen::RowVectorXd::Zero(space.free_count());
  for (std::size_t a = 0; a < values.count; ++a) row[values.index[a]] = values.value[a];
  return row;
}

// The conditions that are left when those that follow from others are dropped; nullopt: they contradict each other in
// this space.
std::optional<std::vector<Condition>> independent(std::vector<Condition> conditions, const RangeSpace& space) {
  std::vector<Condition> kept;
  std::vector<std::pair<Eigen::RowVectorXd, double>> basis;  // orthonormal rows, with the values that they ask for
  for (Condition& c : conditions) {
    c.row = functions_at(space, c.z_mm, c.derivative);
    Eigen::RowVectorXd rest = c.row;
    double value = c.value, size = std::abs(c.value);
    for (int twice = 0; twice < 2; ++twice)
      for (const auto& [direction, asked] : basis) {
        const double share = rest.dot(direction);
        rest -= share * direction;
        value -= share * asked;
        size = std::max(size, std::abs(share * asked));
      }
    const double band = space.breaks().back() - space.breaks().front();
    const double length = rest.norm(), whole = c.derivative == 0 ? 1 : 1 / band;
    if (length <= kSame * std::max(whole, c.row.norm())) {
      if (std::abs(value) > kSame * std::max(size, whole)) return std::nullopt;
      continue;
    }
    basis.emplace_back(rest / length, value / length);
    kept.push_back(std::move(c));
  }
  return kept;
}

// x - S^-1 C' (C S^-1 C')^-1 (C x - d), S = A + mu E, C one block `row` of each condition for every function around.
bool project(const std::vector<Condition>& conditions, LadderFit& fit, double noise_variance,
             const Inflation& inflation, std::vector<HeldConstraint>& told) {
  const NormalEquations& equations = *fit.equations;
  const Eigen::Index around = fit.free.cols(), count = static_cast<Eigen::Index>(conditions.size());
  Eigen::MatrixXd rows(count, fit.free.rows());
  Eigen::VectorXd asked(count);
  for (Eigen::Index k = 0; k < count; ++k) {
    rows.row(k) = conditions[static_cast<std::size_t>(k)].row;
    asked[k] = conditions[static_cast<std::size_t>(k)].value;
  }
  const bool bridged = equations.empty_cells() > 0 && fit.smoothing <= 0;
  NormalSolver solver(equations, bridged ? kVanishingWeight : fit.smoothing, {.direct = bridged});
  if (!solver.solve()) return false;

  Eigen::MatrixXd inner(count * around, count * around);  // C S^-1 C'
  for (Eigen::Index j = 0; j < around; ++j)
    for (Eigen::Index k = 0; k < count; ++k) {
      Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(fit.free.rows(), around);
      unit.col(j) = rows.row(k).transpose();
      const auto answer = solver.apply_inverse(unit);
      if (!answer) return false;
      const Eigen::MatrixXd seen = rows * *answer;
      inner.col(j * count + k) = Eigen::Map<const Eigen::VectorXd>(seen.data(), seen.size());
    }
  const auto missing = [&] { return Eigen::MatrixXd((rows * fit.free).colwise() - asked); };
  const Eigen::MatrixXd alone = missing();
  const double correlated = noise_variance * inflation.mean(fit.parameters, equations.matrix().count_v());
  for (Eigen::Index k = 0; k < count; ++k) {
    double variance = 0;
    for (Eigen::Index i = 0; i < around; ++i)
      for (Eigen::Index j = 0; j < around; ++j) variance += inner(i * count + k, j * count + k);
    const double n = static_cast<double>(around);
    HeldConstraint here = conditions[static_cast<std::size_t>(k)].told;
    const double value = asked[k] + alone.row(k).mean(), sd = std::sqrt(std::max(variance, 0.0) * correlated) / n;
    const bool radius = conditions[static_cast<std::size_t>(k)].derivative == 0;
    here.alone = radius ? value : std::atan(value);
    here.alone_sd = radius ? sd : sd / (1 + value * value);
    told.push_back(std::move(here));
  }

  const Eigen::LDLT<Eigen::MatrixXd> multipliers(Eigen::MatrixXd((inner + inner.transpose()) / 2));
  for (int step = 0; step < kCorrections; ++step) {
    const Eigen::MatrixXd error = missing();
    const Eigen::VectorXd lambda = multipliers.solve(Eigen::Map<const Eigen::VectorXd>(error.data(), error.size()));
    const Eigen::MatrixXd pull = rows.transpose() * Eigen::Map<const Eigen::MatrixXd>(lambda.data(), count, around);
    const auto change = solver.apply_inverse(pull);
    if (!change) return false;
    fit.free -= *change;
  }
  fit.free -= rows.transpose() * (rows * rows.transpose()).ldlt().solve(missing());
  for (const Condition& c : conditions) fit.held.push_back({c.z_mm, c.derivative});
  fit.parameters -= static_cast<double>(count * around);
  fit.residual_square = equations.residual_square(fit.free);
  return fit.free.allFinite();
}

}  // namespace

std::optional<FitError> refuse(const Constraints& constraints) {
  const auto& radii = constraints.radii;
  for (std::size_t i = 0; i < radii.size(); ++i) {
    if (!(radii[i].radius_mm > 0) || !std::isfinite(radii[i].radius_mm) || !std::isfinite(radii[i].z_mm))
      return FitError{text("a radius of %.6g mm at z = %.6g mm cannot be held; name one above 0", radii[i].radius_mm,
                           radii[i].z_mm)};
    for (std::size_t j = 0; j < i; ++j) {
      const double size = std::max(std::abs(radii[i].z_mm), std::abs(radii[j].z_mm));
      if (std::abs(radii[i].z_mm - radii[j].z_mm) <= kSame * size && radii[i].radius_mm != radii[j].radius_mm)
        return FitError{text("the radius at z = %.6g mm cannot be both %.6g and %.6g mm; leave one of them out",
                             radii[i].z_mm, radii[j].radius_mm, radii[i].radius_mm)};
    }
  }
  for (const auto& angle : {constraints.angle_start_rad, constraints.angle_end_rad})
    if (angle && !(std::abs(*angle) <= kSteepest_rad))
      return FitError{text("an angle of %.6g degrees between wall and axis cannot be held; name one within 89",
                           *angle * 180 / std::numbers::pi)};
  return std::nullopt;
}

tl::expected<std::vector<HeldConstraint>, FitError> hold(const Constraints& constraints, const FitLadder& ladder,
                                                         double z_start_mm, double z_end_mm, double noise_variance,
                                                         const Inflation& inflation, LadderFit& fit,
                                                         Variation& variation) {
  for (const FixedRadius& at : constraints.radii)
    if (at.z_mm < z_start_mm || at.z_mm > z_end_mm)
      return tl::unexpected(FitError{text(
          "a radius of %.6g mm at z = %.6g mm cannot be held: the surface goes from z = %.6g to %.6g mm; name a height "
          "on it",
          at.radius_mm, at.z_mm, z_start_mm, z_end_mm)});
  const auto wanted = conditions_of(constraints, z_start_mm, z_end_mm);
  auto conditions = independent(wanted, fit.equations->space().u);
  while (!conditions) {
    if (!variation.along_u) {
      variation.along_u = true;
      fit.levels.u = ladder.levels_u() - 1;
    } else if (fit.levels.u > 0) {
      --fit.levels.u;
    } else {
      std::string names;
      for (const Condition& c : wanted) names += (names.empty() ? "" : ", ") + c.told.what;
      return tl::unexpected(
          FitError{"no surface with these samples holds all of: " + names + "; leave one out, or scan more finely"});
    }
    auto finer = solve_member(ladder, fit.levels, variation);
    if (finer) {
      fit = std::move(*finer);
      conditions = independent(wanted, fit.equations->space().u);
    }
  }
  std::vector<HeldConstraint> told;
  if (!project(*conditions, fit, noise_variance, inflation, told))
    return tl::unexpected(FitError{
        "the samples and the constraints together do not determine the surface; leave a constraint out, or take more "
        "samples"});
  return told;
}

}  // namespace celadon
