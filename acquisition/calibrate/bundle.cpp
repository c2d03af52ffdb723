#include "acquisition/calibrate/bundle.h"

#include <ceres/ordered_groups.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <cmath>
#include <map>
#include <memory>
#include <set>

#include "acquisition/calibrate/residual_terms.h"

namespace celadon::calibrate {
namespace {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Residuals of a term at its parameters, and their derivatives by each block.
struct Linearised {
  explicit Linearised(const Term& term) : residuals(term.cost->num_residuals()) {
    std::vector<double*> targets;
    for (int size : term.cost->parameter_block_sizes()) jacobians.emplace_back(Rows::Zero(residuals.size(), size));
    for (Rows& jacobian : jacobians) targets.push_back(jacobian.data());
    valid = term.cost->Evaluate(term.blocks.data(), residuals.data(), targets.data());
  }
  Eigen::VectorXd residuals;
  std::vector<Rows> jacobians;
  bool valid = false;
};

/// Runs of one group are added at once.
void add_to(Grouping& groups, int kind, const std::vector<Origin>& origins, const Rows& J,
            const Eigen::VectorXd& residuals) {
  const auto group_of = [&](std::size_t row) { return origins[row].group[static_cast<std::size_t>(kind)]; };
  for (std::size_t begin = 0, end = 0; begin < origins.size(); begin = end) {
    while (end < origins.size() && group_of(end) == group_of(begin)) ++end;
    const auto first = static_cast<Eigen::Index>(begin), count = static_cast<Eigen::Index>(end - begin);
    GroupSums& sums = groups[group_of(begin)];
    if (sums.score.size() == 0) {
      sums.score = Eigen::VectorXd::Zero(J.cols());
      sums.information = Eigen::MatrixXd::Zero(J.cols(), J.cols());
    }
    sums.score += J.middleRows(first, count).transpose() * residuals.segment(first, count);
    sums.information += J.middleRows(first, count).transpose() * J.middleRows(first, count);
  }
}

bool finite(const Estimate& estimate) {
  for (double value : estimate.camera) {
    if (!std::isfinite(value)) return false;
  }
  for (const auto& X_CB : estimate.X_CB) {
    if (!X_CB.matrix().allFinite()) return false;
  }
  for (const PlaneEstimate& plane : estimate.planes) {
    if (!plane.normal_C.allFinite() || !std::isfinite(plane.distance_mm)) return false;
  }
  if (estimate.elevation && !(estimate.elevation->direction_C.allFinite() && estimate.elevation->point_C.allFinite() &&
                              std::isfinite(estimate.elevation->scale))) {
    return false;
  }
  if (estimate.lift && !(estimate.lift->direction_C.allFinite() && std::isfinite(estimate.lift->scale))) return false;
  return estimate.camera[0] > 0 && estimate.camera[1] > 0 && estimate.pitch.allFinite() &&
         estimate.sag_mm.allFinite() &&
         (!estimate.axis || (estimate.axis->direction_C.allFinite() && estimate.axis->point_C.allFinite() &&
                             estimate.axis->once_a_turn_rad.allFinite()));
}

}  // namespace

tl::expected<Estimate, std::string> solve_bundle(const Observations& observations, const Estimate& start) {
  Parameters parameters(start);
  std::vector<Term> terms = terms_of(observations, start, parameters);
  ceres::Problem::Options ownership;
  ownership.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(ownership);
  for (const Term& term : terms) problem.AddResidualBlock(term.cost.get(), nullptr, term.blocks);

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;  // sums in one order, whatever the machine
  options.max_num_iterations = 50;
  // Nearly Gauss and Newton's steps from the start: the scale is held by the prior alone and damping would delay it.
  options.initial_trust_region_radius = 1e10;
  options.function_tolerance = 1e-12;
  options.parameter_tolerance = 1e-13;
  options.gradient_tolerance = 1e-16;
  options.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  const std::size_t first_poses = parameters.poses.size();
  std::set<const double*> own;
  for (std::size_t i = 0; i < first_poses; ++i) own.insert(parameters.poses[i].data());
  std::vector<double*> blocks;
  problem.GetParameterBlocks(&blocks);
  bool any_pose = false;
  for (double* block : blocks) {
    any_pose = any_pose || own.count(block) > 0;
    options.linear_solver_ordering->AddElementToGroup(block, own.count(block) > 0 ? 0 : 1);
  }
  if (!any_pose) return tl::unexpected(std::string("no view of the board is left to solve with; take new views"));
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  const Estimate out = parameters.moved(start);
  if (!summary.IsSolutionUsable() || !finite(out)) {
    return tl::unexpected(
        std::string("the views of the board contradict each other or say too little: the joint "
                    "adjustment finds no camera; take new views, tilted in all directions"));
  }
  return out;
}

SharedLayout::SharedLayout(const Estimate& estimate) {
  size = 14;
  if (estimate.axis) {
    axis = size;
    turn = size + 4;
    size += 7;
  }
  for (std::size_t i = 0; i < estimate.planes.size(); ++i, size += 3) planes.push_back(size);
  if (estimate.platter) {
    platter = size;
    size += 3;
  }
  if (estimate.elevation) {
    elevation = size;
    size += 5;
  }
  if (estimate.lift) {
    lift = size;
    size += 3;
  }
}

SharedInformation shared_information(const Observations& observations, const Estimate& estimate) {
  Parameters parameters(estimate);
  const SharedLayout layout(estimate);
  std::map<const double*, int> column;
  column[parameters.camera.data()] = layout.camera;
  column[parameters.print.data()] = layout.print;
  if (layout.axis >= 0) column[parameters.axis.data()] = layout.axis;
  if (layout.turn >= 0) column[parameters.turn.data()] = layout.turn;
  if (layout.platter >= 0) column[parameters.platter.data()] = layout.platter;
  if (layout.elevation >= 0) column[parameters.elevation.data()] = layout.elevation;
  if (layout.lift >= 0) column[parameters.lift.data()] = layout.lift;
  for (std::size_t i = 0; i < parameters.planes.size(); ++i) column[parameters.planes[i].data()] = layout.planes[i];

  struct PoseBlock {
    Eigen::Matrix<double, 6, 6> own = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::MatrixXd shared;  // 6 x layout.size
  };
  std::map<const double*, PoseBlock> poses;
  SharedInformation out;
  Eigen::MatrixXd N = Eigen::MatrixXd::Zero(layout.size, layout.size);
  int rows = 0;
  const std::vector<Term> terms = terms_of(observations, estimate, parameters);
  for (const Term& term : terms) {
    const Linearised at(term);
    if (!at.valid) continue;
    const auto& jacobians = at.jacobians;
    const auto& sizes = term.cost->parameter_block_sizes();
    rows += static_cast<int>(at.residuals.size());
    out.chi_square += at.residuals.squaredNorm();
    PoseBlock* pose = nullptr;
    std::size_t pose_at = 0;
    for (std::size_t i = 0; i < term.blocks.size(); ++i) {
      if (column.count(term.blocks[i]) > 0) continue;
      pose = &poses[term.blocks[i]];
      pose_at = i;
      if (pose->shared.size() == 0) pose->shared = Eigen::MatrixXd::Zero(6, layout.size);
      pose->own += jacobians[i].transpose() * jacobians[i];
    }
    for (std::size_t i = 0; i < term.blocks.size(); ++i) {
      if (pose != nullptr && i == pose_at) continue;
      const int first = column.at(term.blocks[i]);
      if (pose != nullptr) pose->shared.middleCols(first, sizes[i]) += jacobians[pose_at].transpose() * jacobians[i];
      for (std::size_t k = 0; k < term.blocks.size(); ++k) {
        if (pose != nullptr && k == pose_at) continue;
        N.block(first, column.at(term.blocks[k]), sizes[i], sizes[k]) += jacobians[i].transpose() * jacobians[k];
      }
    }
  }
  for (const auto& [block, pose] : poses) N -= pose.shared.transpose() * pose.own.ldlt().solve(pose.shared);
  std::map<const double*, Eigen::MatrixXd> followed;  // what a pose does when a shared parameter moves, negative
  for (const auto& [block, pose] : poses) followed[block] = pose.own.ldlt().solve(pose.shared);
  out.groupings.resize(Origin::kGroupings);
  for (const Term& term : terms) {
    if (term.origins.empty()) continue;
    const Linearised at(term);
    if (!at.valid) continue;
    Rows J = Rows::Zero(at.residuals.size(), layout.size);
    for (std::size_t i = 0; i < term.blocks.size(); ++i) {
      const auto shared = column.find(term.blocks[i]);
      if (shared != column.end()) {
        J.middleCols(shared->second, at.jacobians[i].cols()) += at.jacobians[i];
      } else {
        J -= at.jacobians[i] * followed.at(term.blocks[i]);
      }
    }
    for (int kind = 0; kind < Origin::kGroupings; ++kind)
      add_to(out.groupings[static_cast<std::size_t>(kind)], kind, term.origins, J, at.residuals);
  }
  out.degrees_of_freedom = rows - layout.size - 6 * static_cast<int>(poses.size());

  // The parameters' sizes differ by orders of magnitude: the inverse is taken of the matrix with a unit diagonal.
  constexpr double kUndetermined = 1e-13;
  Eigen::VectorXd unit = N.diagonal();
  for (double& value : unit) value = value > 0 ? 1 / std::sqrt(value) : 1;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(unit.asDiagonal() * N * unit.asDiagonal());
  Eigen::VectorXd values = solver.eigenvalues();
  out.determined = values.minCoeff() > kUndetermined;
  values = values.cwiseMax(kUndetermined).cwiseInverse();
  const Eigen::MatrixXd inverse = solver.eigenvectors() * values.asDiagonal() * solver.eigenvectors().transpose();
  out.covariance = unit.asDiagonal() * inverse * unit.asDiagonal();
  return out;
}

}  // namespace celadon::calibrate
