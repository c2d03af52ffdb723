#pragma once
// Two pictures of a turning table as two cameras side by side, and points from what matches in their normal images.
// Equations: README.md.

#include <Eigen/Core>
#include <array>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/calibration.h"
#include "acquisition/lens.h"

namespace celadon {

/// A point in the object's frame (table angle 0, lift 0), true mm, and how it moves with what it was computed from.
struct StereoPoint {
  Eigen::Vector3d p_mm = Eigen::Vector3d::Zero();
  Eigen::Vector3d by_disparity = Eigen::Vector3d::Zero();  ///< per px of the normal images
  Eigen::Vector3d by_first_rad = Eigen::Vector3d::Zero();  ///< per true angle of the table at the first picture
  Eigen::Vector3d by_second_rad = Eigen::Vector3d::Zero();
};

/// Which disparities a search goes through, px, both included.
struct DisparityRange {
  int lowest = 0, highest = 0;
};

/// The geometry of a pair of normal images: one image plane that holds the baseline's direction, rows along the
/// baseline, so that a point has the same row in both. Their size is the camera's. A point of the table's axis in the
/// middle of the view has the same place in both: disparity 0.
class NormalPair {
 public:
  /// @param first_rad, second_rad  encoder's angles of the table at the two pictures
  /// @returns one sentence where the angles are equal or too far apart, or the camera looks along the table's axis
  static tl::expected<NormalPair, std::string> make(const Calibration& calibration, double first_rad,
                                                    double second_rad);

  int width_px() const { return width_px_; }
  int height_px() const { return height_px_; }
  double turned_rad() const { return turned_rad_; }  ///< true angle from the first picture to the second
  double middle_rad() const { return middle_rad_; }  ///< true angle of the table half way between them
  double baseline_mm() const { return std::abs(baseline_mm_); }

  /// Where the camera's picture shows what a normal image shows at (x, y): equations (4) to (7), and the lens.
  /// @param picture  0: first, 1: second
  /// @returns NaN where the camera cannot see it
  Eigen::Vector2d pixel(std::size_t picture, double x_px, double y_px) const;
  /// The inverse. @pre the pixel's ray meets the image plane of the pair
  Eigen::Vector2d normal(std::size_t picture, const Eigen::Vector2d& pixel) const;

  /// The point at (x, y) of the first normal image and (x - disparity, y) of the second: equations (1) to (3).
  /// @pre the disparity is one of a point before the cameras: within range_to() of any reach
  StereoPoint point(double x_px, double y_px, double disparity_px) const;
  /// Disparities of what lies within `reach_mm` before the table's axis and half as far behind it.
  DisparityRange range_to(double reach_mm) const;
  /// How far from the table's axis the picture's sides look.
  double view_reach_mm() const;

 private:
  explicit NormalPair(const Calibration& calibration) : lens_(calibration.camera_model) {}

  Lens lens_;
  int width_px_ = 0, height_px_ = 0;
  double turned_rad_ = 0, middle_rad_ = 0;
  double scale_ = 1;
  double f_px_ = 1, cy_px_ = 0;
  std::array<double, 2> cx_px_{};
  double baseline_mm_ = 0;  ///< along the rows, from the first camera to the second; model length
  double axis_mm_ = 0;      ///< depth of the axis's point that has disparity 0; model length
  // Frame M is the object's, turned by the middle angle; N that of the normal images, at the first camera.
  Eigen::Matrix3d R_MN_ = Eigen::Matrix3d::Identity();
  std::array<Eigen::Matrix3d, 2> R_CN_{};
  std::array<Eigen::Vector3d, 2> centre_M_{};
};

/// How far the table turns between the pictures of a pair. The depth's error goes with 1 / angle, so more is better,
/// until the two views differ: a surface that slants by 60 degrees against the view changes its width by
/// tan(60) = 1.7 times the angle, 24 % at 8 degrees, which windows still follow (at 15 degrees, a half, they do not).
inline constexpr double kPairTurn_rad = 0.14;

}  // namespace celadon
