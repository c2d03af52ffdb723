#include "acquisition/calibrate/initial_camera.h"

#include <Eigen/Cholesky>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <optional>

namespace celadon::calibrate {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// What distortion may bend a board by, as a share of the picture's width.
constexpr double kLargestBend = 0.012;
constexpr double kLargestShareWrong = 0.4;
constexpr std::size_t kFewestForHomography = 8;

/// Board in mm to pixels from the picture's middle; by the least median, so that swapped corners do not count.
std::optional<Matrix3d> homography(ViewObservation& view, const Eigen::Vector2d& middle_px, double width_px) {
  std::vector<cv::Point2d> from, to;
  for (const CornerObservation& corner : view.corners) {
    from.emplace_back(corner.p_mm.x(), corner.p_mm.y());
    to.emplace_back(corner.p_px.x() - middle_px.x(), corner.p_px.y() - middle_px.y());
  }
  const cv::Mat found = cv::findHomography(from, to, cv::LMEDS);
  if (found.empty()) return std::nullopt;
  Matrix3d H;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) H(i, k) = found.at<double>(i, k);
  }
  std::size_t wrong = 0;
  for (CornerObservation& corner : view.corners) {
    const Vector3d p = H * corner.p_mm.homogeneous();
    const bool fits = (p.hnormalized() + middle_px - corner.p_px).norm() < kLargestBend * width_px;
    corner.weight = fits ? 1 : 0;
    wrong += !fits;
  }
  const auto total = static_cast<double>(view.corners.size());
  if (static_cast<double>(wrong) > kLargestShareWrong * total || view.corners.size() - wrong < kFewestForHomography) {
    return std::nullopt;
  }
  return H;
}

/// Zhang's two conditions on a homography of a camera with square pixels, each linear in q = 1/f^2; the middle of all
/// of them, weighted by what q counts in it.
std::optional<double> focal_length(const std::vector<std::optional<Matrix3d>>& homographies) {
  struct Vote {
    double q, weight;
  };
  std::vector<Vote> votes;
  double total = 0;
  for (const auto& H : homographies) {
    if (!H) continue;
    const Vector3d a = H->col(0), b = H->col(1);
    const auto across = [](const Vector3d& u, const Vector3d& v) { return u.x() * v.x() + u.y() * v.y(); };
    const double unit = std::sqrt(across(a, a) * across(b, b));
    const double count[2] = {a.z() * b.z(), a.z() * a.z() - b.z() * b.z()};
    const double constant[2] = {across(a, b), across(a, a) - across(b, b)};
    for (int i = 0; i < 2; ++i) {
      // constant q + count = 0. Where the board is hardly tilted both vanish.
      if (constant[i] == 0) continue;
      votes.push_back({-count[i] / constant[i], std::abs(constant[i]) / unit});
      total += votes.back().weight;
    }
  }
  std::sort(votes.begin(), votes.end(), [](const Vote& x, const Vote& y) { return x.q < y.q; });
  double sum = 0;
  for (const Vote& vote : votes) {
    sum += vote.weight;
    if (sum >= 0.5 * total) return vote.q > 0 ? std::optional(1 / std::sqrt(vote.q)) : std::nullopt;
  }
  return std::nullopt;
}

Eigen::Isometry3d pose_from(const Matrix3d& H, double focal_px) {
  Matrix3d A = H;
  A.topRows<2>() /= focal_px;
  A /= 0.5 * (A.col(0).norm() + A.col(1).norm());
  if (A(2, 2) < 0) A = -A;
  Matrix3d R;
  R << A.col(0), A.col(1), A.col(0).cross(A.col(1));
  const Eigen::JacobiSVD<Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Isometry3d X_CB = Eigen::Isometry3d::Identity();
  X_CB.linear() = svd.matrixU() * svd.matrixV().transpose();
  X_CB.translation() = A.col(2);
  return X_CB;
}

}  // namespace

tl::expected<Estimate, std::string> initial_camera(Observations& observations, int width_px, int height_px) {
  const Eigen::Vector2d middle(0.5 * (width_px - 1), 0.5 * (height_px - 1));
  std::vector<std::optional<Matrix3d>> homographies;
  int count = 0;
  for (ViewObservation& view : observations.views) {
    homographies.push_back(view.used ? homography(view, middle, width_px) : std::nullopt);
    view.used = homographies.back().has_value();
    count += view.used;
  }
  constexpr int kFewestViews = 3;
  if (count < kFewestViews) {
    return tl::unexpected("the board was found in " + std::to_string(count) +
                          " views that fit a plane, and a camera needs at least " + std::to_string(kFewestViews) +
                          ", better 25; show it in more poses, tilted in all directions");
  }
  // Without tilt the views say nothing of the focal length; the adjustment's uncertainty will tell.
  const double focal_px = focal_length(homographies).value_or(1.5 * width_px);
  Estimate out;
  out.camera = {focal_px, focal_px, middle.x(), middle.y(), 0, 0, 0, 0, 0};
  out.pitch = {observations.pitch_x.value, observations.pitch_y.value};
  out.board_radius_mm = observations.board_radius_mm;
  for (const auto& H : homographies) out.X_CB.push_back(H ? pose_from(*H, focal_px) : Eigen::Isometry3d::Identity());
  return out;
}

bool refine_pose(const Estimate& estimate, const ViewObservation& view, int half, Eigen::Isometry3d& X_CB) {
  constexpr int kMostSteps = 30;
  for (int iteration = 0; iteration < kMostSteps; ++iteration) {
    Eigen::Matrix<double, 6, 6> N = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> g = Eigen::Matrix<double, 6, 1>::Zero();
    for (const CornerObservation& corner : view.corners) {
      if (!(corner.weight > 0) || corner.half != half) continue;
      const Vector3d turned = X_CB.linear() * on_board(estimate, corner.p_mm);
      const Vector3d p = turned + X_CB.translation();
      if (!(p.z() > 0)) return false;
      const double a = p.x() / p.z(), b = p.y() / p.z();
      const Projection at = project(estimate.camera.data(), a, b);
      Eigen::Matrix<double, 2, 3> by_point;
      by_point << 1 / p.z(), 0, -a / p.z(), 0, 1 / p.z(), -b / p.z();
      by_point = (at.by_ray * by_point / corner.sigma_px).eval();
      Matrix3d cross;
      cross << 0, turned.z(), -turned.y(), -turned.z(), 0, turned.x(), turned.y(), -turned.x(), 0;
      Eigen::Matrix<double, 2, 6> J;
      J << by_point * cross, by_point;
      N += J.transpose() * J;
      g += J.transpose() * (at.p_px - corner.p_px) / corner.sigma_px;
    }
    const Eigen::Matrix<double, 6, 1> move = -N.ldlt().solve(g);
    if (!move.allFinite()) return false;
    const double angle = move.head<3>().norm();
    if (angle > 0) {
      X_CB.linear() =
          Eigen::Quaterniond(Eigen::AngleAxisd(angle, move.head<3>() / angle) * X_CB.linear()).normalized().matrix();
    }
    X_CB.translation() += move.tail<3>();
    if (angle < 1e-11 && move.tail<3>().norm() < 1e-9 * X_CB.translation().norm()) return true;
  }
  return false;
}

}  // namespace celadon::calibrate
