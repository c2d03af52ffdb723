#pragma once
// The virtual camera's projection: pinhole and Brown-Conrady distortion, in this folder's own code, so that an error in
// the scanner's model of its camera can not cancel itself.

#include <Eigen/Geometry>
#include <array>
#include <optional>

namespace celadon::sim {

struct CameraIntrinsics {
  int width_px = 0, height_px = 0;
  double fx_px = 0, fy_px = 0, cx_px = 0, cy_px = 0;  ///< pixel centres at whole numbers
  double k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0;      ///< Brown-Conrady
};

class VirtualCamera {
 public:
  /// X_CW: the scanner frame in the camera frame (z along the view, x along rows, y down).
  VirtualCamera(const CameraIntrinsics& intrinsics, const Eigen::Isometry3d& X_CW);

  const CameraIntrinsics& intrinsics() const { return in_; }
  const Eigen::Isometry3d& X_CW() const { return X_CW_; }
  Eigen::Vector3d centre_W() const { return centre_W_; }

  /// Pixel of a point of the scanner frame.
  /// @pre the point lies in front of the camera
  Eigen::Vector2d project(const Eigen::Vector3d& p_W) const;
  /// Direction in the scanner frame of the ray through a pixel, by Newton's method to 1e-12 of the image plane.
  Eigen::Vector3d ray_W(double x_px, double y_px) const;

 private:
  CameraIntrinsics in_;
  Eigen::Isometry3d X_CW_;
  Eigen::Matrix3d R_WC_;
  Eigen::Vector3d centre_W_;
};

}  // namespace celadon::sim
