#pragma once
// How samples scatter when they are drawn many times, against the covariance that is stated for them.

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <numbers>
#include <vector>

#include "fitting/profile.h"

namespace celadon {

inline double angle_between(double a, double b) {
  return std::remainder(a - b, 2 * std::numbers::pi);
}

class SampleSpread {
 public:
  explicit SampleSpread(const Profile& expected)
      : expected_(expected), sum_(expected.size(), Eigen::Matrix3d::Zero()) {}

  void add(const Profile& drawn) {
    ASSERT_EQ(drawn.size(), expected_.size());
    for (std::size_t i = 0; i < drawn.size(); ++i) {
      const Eigen::Vector3d d(drawn.r_mm[i] - expected_.r_mm[i],
                              angle_between(drawn.theta_rad[i], expected_.theta_rad[i]),
                              drawn.z_mm[i] - expected_.z_mm[i]);
      sum_[i] += d * d.transpose();
    }
    ++draws_;
  }
  /// Within 5 % of the standard deviations, term by term.
  void expect_as_stated() const {
    for (std::size_t i = 0; i < expected_.size(); ++i) {
      const SampleCovariance& s = expected_.covariance[i];
      Eigen::Matrix3d stated;
      stated << s.rr, s.rt, s.rz, s.rt, s.tt, s.tz, s.rz, s.tz, s.zz;
      const Eigen::Vector3d scale = stated.diagonal().cwiseSqrt().cwiseInverse();
      const Eigen::Matrix3d difference = scale.asDiagonal() * (sum_[i] / draws_ - stated) * scale.asDiagonal();
      EXPECT_LT(difference.cwiseAbs().maxCoeff(), 0.05) << difference;
      EXPECT_GT(s.rr, 0);
    }
  }

 private:
  Profile expected_;
  std::vector<Eigen::Matrix3d> sum_;
  int draws_ = 0;
};

}  // namespace celadon
