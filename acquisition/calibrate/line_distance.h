#pragma once
// How far a line point lies in the picture from where the line should be, on a board and on the platter, with
// derivatives. README.md, (3) to (6).

#include <Eigen/Core>

#include "acquisition/calibrate/estimate.h"

namespace celadon::calibrate {

/// The place where a ray meets a plane: normal . p = distance.
struct PlanePoint {
  bool exists = false;
  Eigen::Vector3d p_C;
  Eigen::Matrix<double, 3, 2> by_pixel;
  Eigen::Matrix<double, 3, 9> by_camera;
  Eigen::Matrix3d by_normal;
  Eigen::Vector3d by_distance;
};
PlanePoint plane_point(const Ray& ray, const Eigen::Vector3d& normal_C, double distance_mm);

/// A pixel against the picture of the line in which two planes meet: that which the light falls on (1), and another (2)
/// in which it lies too. Board and laser, or laser and platter.
struct LineDistance {
  bool exists = false;     ///< false: the ray misses plane 1
  bool definite = false;   ///< false: the planes are so nearly parallel, as seen, that there is no line
  double distance_px = 0;  ///< across the line, signed
  double height_mm = 0;    ///< of the pixel's place on plane 1 over plane 2
  PlanePoint foot;         ///< the nearest place on the line
  double per_px = 0;       ///< mm over plane 2 per pixel across the line, at the foot
};
LineDistance line_distance(const double* camera, const Eigen::Vector2d& p_px, const Eigen::Vector3d& normal_1_C,
                           double distance_1_mm, const Eigen::Vector3d& normal_2_C, double distance_2_mm);

/// The same for a line on a board at a pose: the plane is that of the board where the line is, flat board and sag
/// together. The sag's slope against the board, a thousandth, is left.
struct LineOnBoard {
  LineDistance at;
  Eigen::Vector3d shape = Eigen::Vector3d::Zero();  ///< sag_shape() at the foot
};
LineOnBoard line_on_board(const Estimate& estimate, const Eigen::Isometry3d& X_CB, const Eigen::Vector2d& p_px,
                          const PlaneEstimate& laser);

}  // namespace celadon::calibrate
