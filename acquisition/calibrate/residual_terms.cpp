// Formulas: README.md, (1) to (7) and (12).
#include "acquisition/calibrate/residual_terms.h"

#include <ceres/normal_prior.h>

#include <cmath>

#include "acquisition/calibrate/line_distance.h"
#include "acquisition/calibrate/view_pose.h"

namespace celadon::calibrate {
namespace {

using Eigen::Vector3d;
using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using JacobianMap = Eigen::Map<Rows>;

/// The sizes of a term's blocks: its own, then those of the view's pose.
std::vector<int> with_pose_blocks(std::vector<int> sizes, const ViewPose& pose) {
  const std::vector<int> of_pose = pose.block_sizes();
  sizes.insert(sizes.end(), of_pose.begin(), of_pose.end());
  return sizes;
}

// Numbers of the groups that may err together: kinds are apart by a million.
constexpr int kKind = 1'000'000;
/// A corner of the print, by its place to the millimetre.
int place_of_corner(const Eigen::Vector2d& p_mm) {
  return static_cast<int>(std::lround(p_mm.x())) * 1000 + static_cast<int>(std::lround(p_mm.y()));
}
int part_of_picture(const Eigen::Vector2d& p_px) {
  constexpr double kPart_px = 160;
  return static_cast<int>(std::lround(p_px.x() / kPart_px)) * 1000 + static_cast<int>(std::lround(p_px.y() / kPart_px));
}
/// A part of a laser's fan, by where its line stands in the picture.
int place_on_sheet(int laser, const Eigen::Vector2d& p_px) {
  return (laser + 1) * kKind + part_of_picture(p_px);
}

/// Blocks: camera, print, those of the view's pose.
class CornerTerm final : public ceres::CostFunction {
 public:
  CornerTerm(const Estimate& estimate, const ViewObservation& view) : pose_(estimate, view) {
    for (const CornerObservation& corner : view.corners) {
      if (!(corner.weight > 0)) continue;
      corners_.push_back(corner);
      shapes_.push_back(sag_shape(corner.p_mm, estimate.board_radius_mm));
    }
    set_num_residuals(2 * static_cast<int>(corners_.size()));
    *mutable_parameter_block_sizes() = with_pose_blocks({9, 5}, pose_);
  }

  std::vector<Origin> origins(int view) const {
    std::vector<Origin> out;
    for (const CornerObservation& corner : corners_) {
      out.insert(out.end(), 2, {{view, place_of_corner(corner.p_mm), part_of_picture(corner.p_px)}});
    }
    return out;
  }

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const ViewPose::Value pose = pose_.at(blocks + 2);
    const Eigen::Index count = num_residuals();
    Rows by_pose(jacobians != nullptr ? count : 0, pose_.numbers());
    for (std::size_t i = 0; i < corners_.size(); ++i) {
      const CornerObservation& corner = corners_[i];
      const double x = blocks[1][0] * corner.p_mm.x(), y = blocks[1][1] * corner.p_mm.y();
      const double z = Eigen::Map<const Vector3d>(blocks[1] + 2).dot(shapes_[i]);
      const Vector3d p_C = pose.R * Vector3d(x, y, z) + pose.t;
      if (!(p_C.z() > 0)) return false;
      const double inverse_z = 1 / p_C.z(), a = p_C.x() * inverse_z, b = p_C.y() * inverse_z;
      const Projection at = project(blocks[0], a, b);
      const double per_sigma = std::sqrt(corner.weight) / corner.sigma_px;
      const auto row = 2 * static_cast<Eigen::Index>(i);
      Eigen::Map<Eigen::Vector2d>(residuals + row) = per_sigma * (at.p_px - corner.p_px);
      if (jacobians == nullptr) continue;
      Eigen::Matrix<double, 2, 3> by_point;
      by_point << inverse_z, 0, -a * inverse_z, 0, inverse_z, -b * inverse_z;
      by_point = (per_sigma * at.by_ray * by_point).eval();
      if (jacobians[0] != nullptr) JacobianMap(jacobians[0], count, 9).middleRows<2>(row) = per_sigma * at.by_camera;
      if (jacobians[1] != nullptr) {
        JacobianMap by_print(jacobians[1], count, 5);
        by_print.block<2, 1>(row, 0) = by_point * pose.R.col(0) * corner.p_mm.x();
        by_print.block<2, 1>(row, 1) = by_point * pose.R.col(1) * corner.p_mm.y();
        by_print.block<2, 3>(row, 2) = by_point * pose.R.col(2) * shapes_[i].transpose();
      }
      by_pose.middleRows<2>(row) = by_point * (x * pose.R_by.topRows<3>() + y * pose.R_by.middleRows<3>(3) +
                                               z * pose.R_by.bottomRows<3>() + pose.t_by);
    }
    if (jacobians != nullptr) pose_.spread(by_pose, jacobians + 2);
    return true;
  }

 private:
  ViewPose pose_;
  std::vector<CornerObservation> corners_;
  std::vector<Vector3d> shapes_;
};

/// A point of a line with its weight.
struct WeightedPoint {
  Eigen::Vector2d p_px;
  double per_sigma;  ///< 1/px
};

/// Blocks: camera, plane, print, those of the view's pose. Where on the board a point lies, for its sag, is taken from
/// the estimate: it moves by micrometres.
class LineTerm final : public ceres::CostFunction {
 public:
  LineTerm(const Estimate& estimate, const ViewObservation& view, const LineObservation& line)
      : pose_(estimate, view), plane_(estimate.planes[static_cast<std::size_t>(line.plane)]) {
    const Eigen::Isometry3d X_CB = calibrate::pose_of(estimate, view);
    for (const PointObservation& point : line.points) {
      if (!(point.weight > 0)) continue;
      const LineOnBoard on_board = line_on_board(estimate, X_CB, point.p_px, plane_);
      if (!on_board.at.exists || !on_board.at.definite) continue;
      points_.push_back({point.p_px, std::sqrt(point.weight) / point.sigma_px});
      shapes_.push_back(on_board.shape);
    }
    set_num_residuals(static_cast<int>(points_.size()));
    *mutable_parameter_block_sizes() = with_pose_blocks({9, 3, 5}, pose_);
  }

  std::vector<Origin> origins(int view) const {
    std::vector<Origin> out;
    for (const WeightedPoint& point : points_) {
      out.push_back({{view, place_on_sheet(plane_.laser, point.p_px), part_of_picture(point.p_px)}});
    }
    return out;
  }

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const ViewPose::Value pose = pose_.at(blocks + 3);
    const MovedDirection normal = moved_direction(plane_.normal_C, plane_.tangents_C, blocks[1]);
    const double distance = normal.d.dot(plane_.anchor_C) + blocks[1][2];
    const Eigen::Map<const Vector3d> sag_mm(blocks[2] + 2);
    const Eigen::Index count = num_residuals();
    Rows by_pose(jacobians != nullptr ? count : 0, pose_.numbers());
    const Vector3d m = pose.R.col(2);
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const auto& [p_px, per_sigma] = points_[i];
      const LineDistance at =
          line_distance(blocks[0], p_px, m, m.dot(pose.t) + sag_mm.dot(shapes_[i]), normal.d, distance);
      if (!at.exists) return false;
      residuals[i] = per_sigma * at.distance_px;
      if (jacobians == nullptr) continue;
      const auto row = static_cast<Eigen::Index>(i);
      const double per_height = per_sigma / at.per_px;
      const Eigen::RowVector3d by_point = per_height * normal.d.transpose();
      if (jacobians[0] != nullptr) JacobianMap(jacobians[0], count, 9).row(row) = by_point * at.foot.by_camera;
      if (jacobians[1] != nullptr) {
        const Vector3d by_normal = at.foot.p_C - plane_.anchor_C;
        JacobianMap(jacobians[1], count, 3).row(row) << per_height * by_normal.transpose() * normal.by, -per_height;
      }
      const double by_distance = by_point * at.foot.by_distance;
      if (jacobians[2] != nullptr) {
        JacobianMap(jacobians[2], count, 5).row(row) << 0, 0, by_distance * shapes_[i].transpose();
      }
      const Eigen::RowVector3d by_m = by_point * at.foot.by_normal + by_distance * pose.t.transpose();
      by_pose.row(row) = by_m * pose.R_by.bottomRows<3>() + by_distance * m.transpose() * pose.t_by;
    }
    if (jacobians != nullptr) pose_.spread(by_pose, jacobians + 3);
    return true;
  }

 private:
  ViewPose pose_;
  PlaneEstimate plane_;
  std::vector<WeightedPoint> points_;
  std::vector<Vector3d> shapes_;
};

/// Blocks: camera, plane, axis, platter.
class PlatterTerm final : public ceres::CostFunction {
 public:
  PlatterTerm(const Estimate& estimate, const LineObservation& line)
      : axis_(*estimate.axis), plane_(estimate.planes[static_cast<std::size_t>(line.plane)]) {
    const Vector3d up = axis_.direction_C - axis_.across_C * estimate.platter->slope;
    const double height = up.dot(axis_.point_C) + estimate.platter->height_mm;
    for (const PointObservation& point : line.points) {
      if (!(point.weight > 0)) continue;
      const LineDistance at =
          line_distance(estimate.camera.data(), point.p_px, plane_.normal_C, plane_.distance_mm, up, height);
      if (at.exists && at.definite) points_.push_back({point.p_px, std::sqrt(point.weight) / point.sigma_px});
    }
    set_num_residuals(static_cast<int>(points_.size()));
    *mutable_parameter_block_sizes() = {9, 3, 4, 3};
  }

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const MovedDirection normal = moved_direction(plane_.normal_C, plane_.tangents_C, blocks[1]);
    const double distance = normal.d.dot(plane_.anchor_C) + blocks[1][2];
    const MovedDirection direction = moved_direction(axis_.direction_C, axis_.across_C, blocks[2]);
    const Vector3d point_C = axis_.point_C + axis_.across_C * Eigen::Vector2d(blocks[2][2], blocks[2][3]);
    const Vector3d up = direction.d - axis_.across_C * Eigen::Vector2d(blocks[3][1], blocks[3][2]);
    const Eigen::Index count = num_residuals();
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const auto& [p_px, per_sigma] = points_[i];
      const LineDistance at = line_distance(blocks[0], p_px, normal.d, distance, up, up.dot(point_C) + blocks[3][0]);
      if (!at.exists) return false;
      residuals[i] = per_sigma * at.distance_px;
      if (jacobians == nullptr) continue;
      const auto row = static_cast<Eigen::Index>(i);
      const double per_height = per_sigma / at.per_px;
      const Vector3d from = at.foot.p_C - point_C;
      const Eigen::RowVector3d by_point = per_height * up.transpose();
      if (jacobians[0] != nullptr) JacobianMap(jacobians[0], count, 9).row(row) = by_point * at.foot.by_camera;
      if (jacobians[1] != nullptr) {
        const Eigen::Matrix3d by_normal = at.foot.by_normal + at.foot.by_distance * plane_.anchor_C.transpose();
        JacobianMap(jacobians[1], count, 3).row(row) << by_point * by_normal * normal.by,
            by_point * at.foot.by_distance;
      }
      if (jacobians[2] != nullptr) {
        JacobianMap(jacobians[2], count, 4).row(row) << per_height * from.transpose() * direction.by,
            -by_point * axis_.across_C;
      }
      if (jacobians[3] != nullptr) {
        JacobianMap(jacobians[3], count, 3).row(row) << -per_height, -per_height * from.transpose() * axis_.across_C;
      }
    }
    return true;
  }

 private:
  AxisEstimate axis_;
  PlaneEstimate plane_;
  std::vector<WeightedPoint> points_;
};

std::unique_ptr<ceres::CostFunction> prior(const Eigen::VectorXd& mean, const Eigen::VectorXd& sigma) {
  // A prior without uncertainty still needs a number to divide by: a ten-millionth of the pitch moves nothing.
  constexpr double kSurest = 1e-7;
  const Eigen::MatrixXd A = sigma.cwiseMax(kSurest).cwiseInverse().asDiagonal();
  return std::make_unique<ceres::NormalPrior>(A, mean);
}

}  // namespace

std::vector<Term> terms_of(const Observations& observations, const Estimate& estimate, Parameters& parameters) {
  std::vector<Term> terms;
  const auto add = [&](std::unique_ptr<ceres::CostFunction> cost, std::vector<double*> blocks,
                       std::vector<Origin> origins = {}) {
    if (cost->num_residuals() > 0) terms.push_back({std::move(cost), std::move(blocks), std::move(origins)});
  };
  for (const ViewObservation& view : observations.views) {
    if (!view.used) continue;
    const std::vector<double*> pose = ViewPose(estimate, view).blocks_of(parameters, view.pose);
    const auto with_pose = [&](std::vector<double*> blocks) {
      blocks.insert(blocks.end(), pose.begin(), pose.end());
      return blocks;
    };
    auto corners = std::make_unique<CornerTerm>(estimate, view);
    std::vector<Origin> origins = corners->origins(view.view);
    add(std::move(corners), with_pose({parameters.camera.data(), parameters.print.data()}), std::move(origins));
    for (const LineObservation& line : view.lines) {
      if (!line.used || line.plane < 0) continue;
      auto points = std::make_unique<LineTerm>(estimate, view, line);
      origins = points->origins(view.view);
      add(std::move(points),
          with_pose({parameters.camera.data(), parameters.planes[static_cast<std::size_t>(line.plane)].data(),
                     parameters.print.data()}),
          std::move(origins));
    }
  }
  if (estimate.platter) {
    for (const LineObservation& line : observations.platter) {
      if (!line.used || line.plane < 0) continue;
      add(std::make_unique<PlatterTerm>(estimate, line),
          {parameters.camera.data(), parameters.planes[static_cast<std::size_t>(line.plane)].data(),
           parameters.axis.data(), parameters.platter.data()});
    }
    // Of the height a prior says nothing.
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(2, 3);
    A(0, 1) = A(1, 2) = 1 / kPlatterSlopePrior;
    add(std::make_unique<ceres::NormalPrior>(A, Eigen::Vector3d::Zero()), {parameters.platter.data()});
  }
  if (estimate.axis) {
    // Of the scale a prior says nothing.
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(2, 3);
    A(0, 1) = A(1, 2) = 1 / kOnceATurnPrior_rad;
    add(std::make_unique<ceres::NormalPrior>(A, Eigen::Vector3d::Zero()), {parameters.turn.data()});
  }
  Eigen::Vector<double, 5> print, u_print;
  print << observations.pitch_x.value, observations.pitch_y.value, 0, 0, 0;
  u_print << observations.pitch_x.u, observations.pitch_y.u, kSagPrior_mm, kSagPrior_mm, kSagPrior_mm;
  add(prior(print, u_print), {parameters.print.data()});
  return terms;
}

}  // namespace celadon::calibrate
