#include "sim/projection.h"

#include <gtest/gtest.h>

#include <opencv2/calib3d.hpp>
#include <random>

#include "sim/optics.h"

namespace celadon::sim {
namespace {

// The independent check: OpenCV's projection with the same parameters.
TEST(Projection, AgreesWithOpenCv) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> u(-1, 1);
  for (int trial = 0; trial < 50; ++trial) {
    CameraIntrinsics in{1280,
                        1024,
                        1800 + 500 * u(random),
                        1900 + 400 * u(random),
                        640 + 30 * u(random),
                        512 + 30 * u(random),
                        0.2 * u(random),
                        0.1 * u(random),
                        1e-3 * u(random),
                        1e-3 * u(random),
                        0.05 * u(random)};
    const Eigen::Vector3d axis = Eigen::Vector3d(u(random), u(random), u(random)).normalized();
    Eigen::Isometry3d X_CW = Eigen::Isometry3d::Identity();
    X_CW.linear() = Eigen::AngleAxisd(0.5 * u(random), axis).toRotationMatrix();
    X_CW.translation() = Eigen::Vector3d(10 * u(random), 10 * u(random), 300 + 20 * u(random));
    const VirtualCamera camera(in, X_CW);

    const cv::Matx33d k(in.fx_px, 0, in.cx_px, 0, in.fy_px, in.cy_px, 0, 0, 1);
    const cv::Vec<double, 5> d(in.k1, in.k2, in.p1, in.p2, in.k3);
    cv::Matx33d rotation;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) rotation(i, j) = X_CW.linear()(i, j);
    }
    cv::Vec3d rvec;
    cv::Rodrigues(rotation, rvec);
    const cv::Vec3d tvec(X_CW.translation().x(), X_CW.translation().y(), X_CW.translation().z());
    std::vector<cv::Point3d> points;
    for (int i = 0; i < 20; ++i) points.emplace_back(50 * u(random), 50 * u(random), 60 * u(random));
    std::vector<cv::Point2d> pixels;
    cv::projectPoints(points, rvec, tvec, k, d, pixels);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Eigen::Vector3d p(points[i].x, points[i].y, points[i].z);
      const Eigen::Vector2d pixel = camera.project(p);
      EXPECT_NEAR(pixel.x(), pixels[i].x, 1e-8);
      EXPECT_NEAR(pixel.y(), pixels[i].y, 1e-8);
      // The ray through that pixel passes the point.
      const Eigen::Vector3d ray = camera.ray_W(pixel.x(), pixel.y()).normalized(), to = p - camera.centre_W();
      EXPECT_LT((to - to.dot(ray) * ray).norm(), 1e-8);
    }
  }
}

// The default camera sees a body 120 mm high and 90 mm wide at every table angle.
TEST(Projection, DefaultCameraSeesTheWholeObject) {
  const OpticsConfig optics = default_optics(1280, 1024, 0.3, 0.002);
  const VirtualCamera camera(optics.camera, optics.X_CW);
  for (double theta = 0; theta < 6.28; theta += 0.1) {
    for (double z = 0; z <= 120; z += 5) {
      const Eigen::Vector2d p = camera.project({45 * std::cos(theta), 45 * std::sin(theta), z});
      EXPECT_GT(p.x(), 20);
      EXPECT_LT(p.x(), 1259);
      // The nearest foot, towards the camera, may leave the picture below; the lit side, at theta = 0, may not.
      if (theta < 0.05) {
        EXPECT_GT(p.y(), 10);
        EXPECT_LT(p.y(), 1013);
      }
    }
  }
  // Rows at the lit side lie 0.1 to 0.15 mm apart.
  const double rows = camera.project({37, 0, 59}).y() - camera.project({37, 0, 61}).y();
  EXPECT_GT(2 / rows, 0.1);
  EXPECT_LT(2 / rows, 0.15);
}

}  // namespace
}  // namespace celadon::sim
