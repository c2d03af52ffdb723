#include "acquisition/calibrate/frame_change.h"

#include <Eigen/LU>

namespace celadon::calibrate {

using Eigen::Vector3d;

Eigen::MatrixXd in_scanner_frame(const Estimate& estimate, const SharedLayout& layout) {
  const Eigen::Isometry3d X_CW = scanner_frame(estimate);
  const Vector3d x = X_CW.linear().col(0), y = X_CW.linear().col(1), z = X_CW.linear().col(2);
  // What the frame's numbers do: tilts turn it about the origin, z towards x about y and z towards y about -x.
  const Vector3d turns[2] = {y, -x};
  struct Shift {
    int column;
    Vector3d along;
  };
  std::vector<Shift> shifts = {{layout.axis + 2, x}, {layout.axis + 3, y}};
  if (layout.platter >= 0) shifts.push_back({layout.platter, z});

  Eigen::MatrixXd out = Eigen::MatrixXd::Identity(layout.size, layout.size);
  if (layout.elevation >= 0) {
    const ElevationEstimate& axis = *estimate.elevation;
    const Vector3d from_origin = axis.point_C - X_CW.translation();
    const auto across = axis.across_C.transpose();
    for (int i = 0; i < 2; ++i) {
      out.block<2, 1>(layout.elevation, layout.axis + i) = -across * turns[i].cross(axis.direction_C);
      out.block<2, 1>(layout.elevation + 2, layout.axis + i) = -across * turns[i].cross(from_origin);
    }
    for (const Shift& shift : shifts) out.block<2, 1>(layout.elevation + 2, shift.column) = -across * shift.along;
  }
  if (layout.lift >= 0) {
    const LiftEstimate& axis = *estimate.lift;
    const Vector3d& d = axis.direction_C;
    const Tangents by = axis.across_C - d * (d.transpose() * axis.across_C);
    const Eigen::Matrix<double, 2, 3> to_chart = (by.transpose() * by).inverse() * by.transpose();
    for (int i = 0; i < 2; ++i) out.block<2, 1>(layout.lift, layout.axis + i) = -to_chart * turns[i].cross(d);
  }
  return out;
}

}  // namespace celadon::calibrate
