#pragma once
// What a real machine does beyond the calibrated model. All 0: it does not. README.md, "Effects".

#include <Eigen/Geometry>
#include <cmath>

namespace celadon::sim {

/// Error motion of the spindle, synchronous, at table angle a: the table frame moves by
/// (radial cos(2a + 0.3), radial sin(3a + 1.1), axial cos(2a + 0.7)) after a tilt about x by tilt cos(2a + 1.9) and
/// then about y by tilt sin(2a + 1.9). Once a turn there is none: that would be where the object stands.
struct SpindleErrors {
  double radial_mm = 0, axial_mm = 0, tilt_rad = 0;

  bool any() const { return radial_mm != 0 || axial_mm != 0 || tilt_rad != 0; }
  Eigen::Isometry3d motion(double angle_rad) const {
    const double a2 = 2 * angle_rad;
    Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
    X.translation() << radial_mm * std::cos(a2 + 0.3), radial_mm * std::sin(3 * angle_rad + 1.1),
        axial_mm * std::cos(a2 + 0.7);
    X.linear() = (Eigen::AngleAxisd(tilt_rad * std::sin(a2 + 1.9), Eigen::Vector3d::UnitY()) *
                  Eigen::AngleAxisd(tilt_rad * std::cos(a2 + 1.9), Eigen::Vector3d::UnitX()))
                     .toRotationMatrix();
    return X;
  }
};

/// Light that enters the object and leaves it again about a point `depth` further along the laser's ray: in each row
/// the share of the line's light, with a spread e^(-|u| / depth) to both sides.
struct Subsurface {
  double share = 0, depth_mm = 0.5;
};

/// The object is printed in fields of two reflectances, 24 around and one above the other every pitch.
struct ReflectanceFields {
  static constexpr int kAround = 24;
  double contrast = 1;  ///< bright over dark
  double pitch_mm = 8;
};

/// The camera turns about its own vertical as the machine warms up: by turn (1 - e^(-t / time constant)).
struct ThermalDrift {
  double camera_turn_rad = 0, time_constant_s = 600;
};

}  // namespace celadon::sim
