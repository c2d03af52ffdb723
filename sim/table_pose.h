#pragma once
// How the machine stands, and where that puts the table for camera and lasers.
//
// Frames: S, the scanner frame; H, the head of camera and lasers, which coincides with S at elevation 0. All optics are
// given in H; without an elevation axis H is S, and both are called W.

#include <Eigen/Geometry>
#include <cmath>
#include <optional>

#include "sim/effects.h"
#include "sim/rotation.h"

namespace celadon::sim {

/// Where the axes of the machine really are.
struct Posture {
  double table_rad = 0;
  double elevation_rad = 0;
  double lift_mm = 0;
  bool operator==(const Posture&) const = default;
};

/// How far two postures are apart, as an angle at which a body's surface moves as far. The table may be left out.
inline double apart_rad(const Posture& a, const Posture& b, bool with_table = true) {
  constexpr double kSurface_mm = 60;
  return (with_table ? std::abs(a.table_rad - b.table_rad) : 0) + std::abs(a.elevation_rad - b.elevation_rad) +
         std::abs(a.lift_mm - b.lift_mm) / kSurface_mm;
}

/// The axes besides the table as they are mounted. Positive angles about `direction_S` raise the head.
struct MachineAxes {
  struct Elevation {
    Eigen::Vector3d origin_S = Eigen::Vector3d::Zero(), direction_S = Eigen::Vector3d::UnitX();
    double scale = 1;  ///< true angle / what the encoder says
  };
  struct Lift {
    Eigen::Vector3d direction_S = Eigen::Vector3d::UnitZ();
    double scale = 1;
  };
  std::optional<Elevation> elevation;
  std::optional<Lift> lift;

  bool any() const { return elevation || lift; }
  /// The posture at which the encoders say this.
  Posture at(double table_rad, double elevation_rad, double lift_mm) const {
    return {table_rad, elevation ? elevation->scale * elevation_rad : 0, lift ? lift->scale * lift_mm : 0};
  }
  /// p_H = X_HS p_S of a point of the room.
  Eigen::Isometry3d X_HS(const Posture& posture) const {
    Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
    if (!elevation || posture.elevation_rad == 0) return X;
    X.linear() = Eigen::AngleAxisd(-posture.elevation_rad, elevation->direction_S).toRotationMatrix();
    X.translation() = elevation->origin_S - X.linear() * elevation->origin_S;
    return X;
  }
  Eigen::Vector3d raised_mm(const Posture& posture) const {
    return lift ? Eigen::Vector3d(posture.lift_mm * lift->direction_S) : Eigen::Vector3d(Eigen::Vector3d::Zero());
  }
};

/// Where the table frame is for the optics: p_H = X_HS (raised + motion Rz(table) p_T).
class TablePose {
 public:
  TablePose(const Posture& posture, const SpindleErrors& errors, const MachineAxes& axes)
      : cos_(std::cos(posture.table_rad)), sin_(std::sin(posture.table_rad)) {
    if (!errors.any() && posture.elevation_rad == 0 && posture.lift_mm == 0) return;
    is_moved_ = true;
    if (errors.any()) motion_ = errors.motion(posture.table_rad);
    motion_.pretranslate(axes.raised_mm(posture));
    motion_ = axes.X_HS(posture) * motion_;
  }
  Eigen::Vector3d to_table(const Eigen::Vector3d& p_H) const {
    return turned(is_moved_ ? motion_.inverse(Eigen::Isometry) * p_H : p_H, cos_, -sin_);
  }
  Eigen::Vector3d direction_to_table(const Eigen::Vector3d& d_H) const {
    return turned(is_moved_ ? Eigen::Vector3d(motion_.linear().transpose() * d_H) : d_H, cos_, -sin_);
  }
  Eigen::Vector3d to_head(const Eigen::Vector3d& p_T) const {
    const Eigen::Vector3d p = turned(p_T, cos_, sin_);
    return is_moved_ ? motion_ * p : p;
  }

 private:
  double cos_, sin_;
  bool is_moved_ = false;
  Eigen::Isometry3d motion_ = Eigen::Isometry3d::Identity();
};

}  // namespace celadon::sim
