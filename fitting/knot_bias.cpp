#include "fitting/knot_bias.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace celadon {
namespace {

constexpr int kReach = 2;  // intervals of a window on both sides

Variation variation_of(const LadderFit& member) {
  const FitSpace& space = member.equations->space();
  return {space.u.degree() > 0, space.v.degree() > 0};
}

// Interval of a space that holds the middle of each interval of another one.
std::vector<Eigen::Index> holders(const RangeSpace& intervals, const RangeSpace& space) {
  std::vector<Eigen::Index> result;
  for (int k = 0; k < intervals.intervals(); ++k) {
    const auto at = static_cast<std::size_t>(k);
    const double middle = (intervals.breaks()[at] + intervals.breaks()[at + 1]) / 2;
    const auto next = std::upper_bound(space.breaks().begin() + 1, space.breaks().end() - 1, middle);
    result.push_back(next - space.breaks().begin() - 1);
  }
  return result;
}

// Values on the intervals of one pair of spaces from those on another one's.
Eigen::MatrixXd spread_over(const FitSpace& space, const FitSpace& from, const Eigen::MatrixXd& values) {
  const auto u = holders(space.u, from.u), v = holders(space.v, from.v);
  Eigen::MatrixXd result(static_cast<Eigen::Index>(u.size()), static_cast<Eigen::Index>(v.size()));
  for (std::size_t j = 0; j < v.size(); ++j)
    for (std::size_t i = 0; i < u.size(); ++i)
      result(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) = values(u[i], v[j]);
  return result;
}

// Sums over windows around each interval.
Eigen::MatrixXd windows(const Eigen::MatrixXd& values, bool closed) {
  const Eigen::Index nu = values.rows(), nv = values.cols(), reach_v = std::min<Eigen::Index>(kReach, (nv - 1) / 2);
  Eigen::MatrixXd result = Eigen::MatrixXd::Zero(nu, nv);
  for (Eigen::Index j = 0; j < nv; ++j)
    for (Eigen::Index y = -reach_v; y <= reach_v; ++y) {
      const Eigen::Index k = closed ? (j + y + nv) % nv : j + y;
      if (k < 0 || k >= nv) continue;
      for (Eigen::Index i = 0; i < nu; ++i) {
        const Eigen::Index low = std::max<Eigen::Index>(0, i - kReach), high = std::min(nu - 1, i + kReach);
        result(i, j) += values.col(k).segment(low, high - low + 1).sum();
      }
    }
  return result;
}

// Mean square of what the coarse member misses and the fine one follows, on the intervals of the coarse one.
Eigen::MatrixXd missed(const MomentGrid& sums, const LadderFit& coarse, const LadderFit& fine, const LocalNoise& noise,
                       const Eigen::MatrixXd& ratios) {
  const FitSpace &space = coarse.equations->space(), &finer = fine.equations->space();
  const CellResiduals left = cell_residuals(sums, *coarse.equations, coarse.free),
                      left_finer = cell_residuals(sums, *fine.equations, fine.free);
  Eigen::MatrixXd excess = left.square;
  const auto u = holders(finer.u, space.u), v = holders(finer.v, space.v);
  for (std::size_t j = 0; j < v.size(); ++j)
    for (std::size_t i = 0; i < u.size(); ++i)
      excess(u[i], v[j]) -= left_finer.square(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
  // By chance each additional unknown takes away the variance of one sample times the inflation.
  const Eigen::MatrixXd& samples = left.weight;
  const double occupied = static_cast<double>((samples.array() > 0).count());
  const double around = (finer.v.free_count() - space.v.free_count()) / occupied,
               others = (fine.parameters - coarse.parameters) / occupied - around;
  const Inflation& inflation = noise.inflation;
  const double within = inflation.within, both = within + inflation.common;
  const auto expected = [&](const LadderFit& fit) {
    return inflation.mean(fit.parameters, fit.equations->matrix().count_v()) * fit.parameters / occupied;
  };
  const Eigen::MatrixXd variance = noise.variance * (samples.array() > 0).select(ratios.array(), 0.0).matrix();
  excess -= (expected(fine) - expected(coarse)) * variance;
  const Eigen::MatrixXd chance = 2 * (within * within * others + both * both * around) * variance.cwiseAbs2();

  const bool closed = space.v.periodic();
  const Eigen::ArrayXXd count = windows(samples, closed).array().max(1e-300);
  const Eigen::ArrayXXd local = windows(excess, closed).array() / count,
                        by_chance = windows(chance, closed).array() / count.square();
  const double mean = excess.sum() / samples.sum(), scatter = (local - mean).square().mean();
  const double share = scatter > by_chance.mean() ? 1 - by_chance.mean() / scatter : 0;
  return (mean + share * (local - mean)).max(0.0);
}

}  // namespace

Eigen::MatrixXd knot_bias(const FitLadder& ladder, const MomentGrid& sums, const LadderFit& member,
                          const LocalNoise& noise, double profiles, Variation knots) {
  const FitSpace& space = member.equations->space();
  const Variation variation = variation_of(member);
  Eigen::MatrixXd bias = Eigen::MatrixXd::Zero(space.u.free_count(), space.v.free_count());
  const auto plain = solve_member(ladder, member.levels, variation);
  if (!plain) return bias;
  const auto affordable = [&](LadderLevels at) {
    return kSamplesPerUnknown * ladder.unknowns(at.u, at.v, variation) <= static_cast<double>(sums.samples()) &&
           (!variation.around_v || kProfilesPerUnknown * ladder.unknowns(at.u, at.v, {false, true}) <= profiles);
  };

  // In each direction wanted that has a finer member; both at once if they can be.
  Eigen::MatrixXd square = Eigen::MatrixXd::Zero(space.u.intervals(), space.v.intervals());
  const LadderLevels own = member.levels;
  const bool along = variation.along_u && knots.along_u, around = variation.around_v && knots.around_v;
  bool u = along && own.u > 0 && affordable({own.u - 1, own.v}),
       v = around && own.v > 0 && affordable({own.u, own.v - 1});
  if (u && v && !affordable({own.u - 1, own.v - 1})) v = false;
  if (u || v)
    if (const auto finer = solve_member(ladder, {own.u - u, own.v - v}, variation))
      square += missed(sums, *plain, *finer, noise, noise.ratios);
  // In the others, what the next coarser one misses falls with the order of the spline.
  const auto from_coarser = [&](LadderLevels at, int degree) {
    const auto coarser = solve_member(ladder, at, variation);
    if (!coarser) return;
    const FitSpace& from = coarser->equations->space();
    const Eigen::MatrixXd of_coarser = missed(sums, *coarser, *plain, noise, spread_over(from, space, noise.ratios));
    square += std::pow(0.25, degree + 1) * spread_over(space, from, of_coarser);
  };
  if (along && !u && own.u + 1 < ladder.levels_u()) from_coarser({own.u + 1, own.v}, space.u.degree());
  if (around && !v && own.v + 1 < ladder.levels_v()) from_coarser({own.u, own.v + 1}, space.v.degree());

  Eigen::MatrixXd intervals = bias;  // under each function
  for (int J = 0; J < space.v.intervals(); ++J)
    for (int I = 0; I < space.u.intervals(); ++I)
      for (const int j : space.v.active(J))
        for (const int i : space.u.active(I)) {
          bias(i, j) += square(I, J);
          intervals(i, j) += 1;
        }
  return bias.cwiseQuotient(intervals).cwiseSqrt();
}

}  // namespace celadon
