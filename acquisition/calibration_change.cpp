#include "acquisition/calibration_change.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <charconv>
#include <functional>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

namespace celadon {
namespace {

using Eigen::Vector3d;
using Change = std::function<void(Calibration&, double)>;

/// Column i (0: x, 1: y) of the scanner frame is where the axis tilts to; the frame follows by the smallest turn.
void tilt_axis(Calibration& c, int i, double step) {
  const Vector3d up = c.axis.X_CW.linear().col(2), towards = c.axis.X_CW.linear().col(i);
  const auto turn = Eigen::Quaterniond::FromTwoVectors(up, up + step * towards);
  c.axis.X_CW.linear() = (turn * Eigen::Quaterniond(c.axis.X_CW.linear())).normalized().toRotationMatrix();
}

void tilt_plane(Calibration& c, LaserPlane& plane, bool across, double step) {
  const Vector3d n = plane.normal_C, up = c.axis.X_CW.linear().col(2), origin = c.axis.X_CW.translation();
  const Vector3d in_plane = (up - n * n.dot(up)).normalized();
  const Vector3d foot = origin + n * (plane.distance_mm - n.dot(origin));
  plane.normal_C = (n + step * (across ? n.cross(in_plane) : in_plane)).normalized();
  plane.distance_mm = plane.normal_C.dot(foot);
}

Change camera_change(std::string_view name) {
  constexpr std::array<std::pair<std::string_view, Measured CameraModel::*>, 4> kPinhole{
      {{"fx_px", &CameraModel::fx_px},
       {"fy_px", &CameraModel::fy_px},
       {"cx_px", &CameraModel::cx_px},
       {"cy_px", &CameraModel::cy_px}}};
  constexpr std::array<std::string_view, 5> kDistortion{"k1", "k2", "p1", "p2", "k3"};
  for (const auto& [key, member] : kPinhole) {
    if (name == key) {
      return [to = member](Calibration& c, double step) { (c.camera_model.*to).value += step; };
    }
  }
  const auto found = std::find(kDistortion.begin(), kDistortion.end(), name);
  if (found == kDistortion.end()) return {};
  const auto i = static_cast<std::size_t>(found - kDistortion.begin());
  return [i](Calibration& c, double step) { c.camera_model.distortion[i].value += step; };
}

Change axis_change(std::string_view name) {
  const auto shift = [](int column) -> Change {
    return
        [column](Calibration& c, double step) { c.axis.X_CW.translation() += step * c.axis.X_CW.linear().col(column); };
  };
  if (name == "axis.tilt_x_rad") return [](Calibration& c, double step) { tilt_axis(c, 0, step); };
  if (name == "axis.tilt_y_rad") return [](Calibration& c, double step) { tilt_axis(c, 1, step); };
  if (name == "axis.x_mm") return shift(0);
  if (name == "axis.y_mm") return shift(1);
  if (name == "platter.height_mm") return shift(2);
  return {};
}

Change encoder_change(std::string_view name) {
  const auto moved = [](Measured TableEncoder::*number) -> Change {
    return [number](Calibration& c, double step) { (c.encoder.*number).value += step; };
  };
  if (name == "encoder.scale") return moved(&TableEncoder::scale);
  if (name == "encoder.cos_rad") return moved(&TableEncoder::cos_rad);
  if (name == "encoder.sin_rad") return moved(&TableEncoder::sin_rad);
  return {};
}

/// Across a direction: u is z less its part along it, v = direction x u.
std::pair<Vector3d, Vector3d> across(const Vector3d& direction) {
  const Vector3d up = (Vector3d::UnitZ() - direction * direction.z()).normalized();
  return {up, direction.cross(up)};
}

Change elevation_change(const Calibration& calibration, std::string_view name) {
  if (!calibration.elevation) return {};
  const auto tilt = [](bool up) -> Change {
    return [up](Calibration& c, double step) {
      Vector3d& d = c.elevation->direction;
      const auto [u, v] = across(d);
      d = (d + step * (up ? u : v)).normalized();
    };
  };
  const auto shift = [](bool up) -> Change {
    return [up](Calibration& c, double step) {
      const auto [u, v] = across(c.elevation->direction);
      c.elevation->origin_mm += step * (up ? u : v);
    };
  };
  if (name == "elevation.tilt_up_rad") return tilt(true);
  if (name == "elevation.tilt_across_rad") return tilt(false);
  if (name == "elevation.up_mm") return shift(true);
  if (name == "elevation.across_mm") return shift(false);
  if (name == "elevation.scale") return [](Calibration& c, double step) { c.elevation->scale.value += step; };
  return {};
}

Change lift_change(const Calibration& calibration, std::string_view name) {
  if (!calibration.lift) return {};
  const auto tilt = [](const Vector3d& towards) -> Change {
    return [towards](Calibration& c, double step) {
      Vector3d& d = c.lift->direction;
      d = (d + step * towards).normalized();
    };
  };
  if (name == "lift.tilt_x_rad") return tilt(Vector3d::UnitX());
  if (name == "lift.tilt_y_rad") return tilt(Vector3d::UnitY());
  if (name == "lift.scale") return [](Calibration& c, double step) { c.lift->scale.value += step; };
  return {};
}

Change laser_change(const Calibration& calibration, std::string_view name) {
  constexpr std::string_view kPrefix = "laser";
  if (!name.starts_with(kPrefix)) return {};
  name.remove_prefix(kPrefix.size());
  int number = -1;
  const auto parsed = std::from_chars(name.data(), name.data() + name.size(), number);
  if (parsed.ec != std::errc{}) return {};
  const std::string_view what(parsed.ptr, static_cast<std::size_t>(name.data() + name.size() - parsed.ptr));
  const auto found = std::find_if(calibration.lasers.begin(), calibration.lasers.end(),
                                  [&](const LaserPlane& plane) { return plane.laser == number; });
  if (found == calibration.lasers.end()) return {};
  const auto i = static_cast<std::size_t>(found - calibration.lasers.begin());
  if (what == ".tilt_up_rad") return [i](Calibration& c, double step) { tilt_plane(c, c.lasers[i], false, step); };
  if (what == ".tilt_across_rad") return [i](Calibration& c, double step) { tilt_plane(c, c.lasers[i], true, step); };
  if (what == ".offset_mm") return [i](Calibration& c, double step) { c.lasers[i].distance_mm += step; };
  return {};
}

Change change_of(const Calibration& calibration, const std::string& name) {
  if (Change change = camera_change(name)) return change;
  if (Change change = axis_change(name)) return change;
  if (Change change = encoder_change(name)) return change;
  if (Change change = elevation_change(calibration, name)) return change;
  if (Change change = lift_change(calibration, name)) return change;
  return laser_change(calibration, name);
}

}  // namespace

bool has_parameter(const Calibration& calibration, const std::string& name) {
  return static_cast<bool>(change_of(calibration, name));
}

Calibration changed(const Calibration& calibration, const std::string& name, double step) {
  const Change change = change_of(calibration, name);
  if (!change) throw std::invalid_argument("changed: the calibration has no number '" + name + "'");
  Calibration out = calibration;
  change(out, step);
  return out;
}

}  // namespace celadon
