#pragma once
// Projection by OpenCV, which shares no code with acquisition.

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <opencv2/calib3d.hpp>
#include <vector>

#include "acquisition/calibration.h"

namespace celadon {

/// OpenCV's view of a calibration.
class ProjectionTruth {
 public:
  explicit ProjectionTruth(const Calibration& c)
      : camera_{c.camera_model.fx_px.value,
                0,
                c.camera_model.cx_px.value,
                0,
                c.camera_model.fy_px.value,
                c.camera_model.cy_px.value,
                0,
                0,
                1} {
    for (const Measured& k : c.camera_model.distortion) distortion_.push_back(k.value);
  }
  Eigen::Vector2d pixel(const Eigen::Vector3d& p_C) const {
    const std::vector<cv::Point3d> points{{p_C.x(), p_C.y(), p_C.z()}};
    std::vector<cv::Point2d> pixels;
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), camera_, distortion_, pixels);
    return {pixels[0].x, pixels[0].y};
  }
  /// The point of a plane that this pixel sees, by Newton's method on projectPoints.
  Eigen::Vector3d on_plane(const LaserPlane& plane, const Eigen::Vector2d& wanted, Eigen::Vector3d p_C) const {
    const Eigen::Vector3d s = plane.normal_C.unitOrthogonal(), t = plane.normal_C.cross(s);
    p_C += (plane.distance_mm - plane.normal_C.dot(p_C)) * plane.normal_C;
    for (int i = 0; i < 50; ++i) {
      const Eigen::Vector2d error = pixel(p_C) - wanted;
      if (error.norm() < 1e-11) break;
      const double h = 1e-3;
      Eigen::Matrix2d J;
      J.col(0) = (pixel(p_C + h * s) - pixel(p_C - h * s)) / (2 * h);
      J.col(1) = (pixel(p_C + h * t) - pixel(p_C - h * t)) / (2 * h);
      const Eigen::Vector2d step = J.inverse() * error;
      p_C -= step.x() * s + step.y() * t;
    }
    EXPECT_LT((pixel(p_C) - wanted).norm(), 1e-10);
    return p_C;
  }

 private:
  cv::Matx33d camera_;
  std::vector<double> distortion_;
};

}  // namespace celadon
