#pragma once
// A camera turned onto its side about its optical axis: what was column x and row y of its image is column y and row
// width - 1 - x of the turned one's.

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "acquisition/calibration.h"

namespace celadon {

/// The same machine, seen by the turned camera.
inline Calibration turned(Calibration c) {
  CameraModel& m = c.camera_model;
  const double last_column = m.width_px - 1;
  std::swap(m.width_px, m.height_px);
  std::swap(m.fx_px, m.fy_px);
  const Measured cx = m.cx_px;
  m.cx_px = m.cy_px;
  m.cy_px = {last_column - cx.value, cx.u};
  // (a, b) becomes (b, -a): the tangential terms of OpenCV's formula change places.
  const Measured p1 = m.distortion[2], p2 = m.distortion[3];
  m.distortion[2] = {-p2.value, p2.u};
  m.distortion[3] = p1;
  Eigen::Matrix3d R;  // camera to turned camera
  R << 0, 1, 0, -1, 0, 0, 0, 0, 1;
  c.axis.X_CW = Eigen::Isometry3d(R) * c.axis.X_CW;
  for (LaserPlane& plane : c.lasers) plane.normal_C = R * plane.normal_C;
  return c;
}

/// A grey picture as the turned camera sees it.
inline std::vector<std::uint8_t> turned(const std::vector<std::uint8_t>& grey, int width, int height) {
  const auto w = static_cast<std::size_t>(width), h = static_cast<std::size_t>(height);
  std::vector<std::uint8_t> out(grey.size());
  for (std::size_t y = 0; y < h; ++y) {
    for (std::size_t x = 0; x < w; ++x) out[(w - 1 - x) * h + y] = grey[y * w + x];
  }
  return out;
}

}  // namespace celadon
