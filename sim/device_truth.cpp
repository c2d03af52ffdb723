#include "sim/device_truth.h"

#include <nlohmann/json.hpp>

namespace celadon::sim {

nlohmann::json effects_of(const DeviceConfig& device) {
  const OpticsConfig& o = device.optics;
  return {{"sheet_bow_mm", o.sheet.bow_mm},
          {"spindle_radial_mm", o.spindle.radial_mm},
          {"spindle_axial_mm", o.spindle.axial_mm},
          {"spindle_tilt_rad", o.spindle.tilt_rad},
          {"encoder_eccentricity_rad", device.turntable.encoder_eccentricity_rad},
          {"thermal_camera_turn_rad", device.thermal.camera_turn_rad},
          {"thermal_time_constant_s", device.thermal.time_constant_s},
          {"subsurface_share", o.subsurface.share},
          {"subsurface_depth_mm", o.subsurface.depth_mm},
          {"fields_contrast", o.fields.contrast},
          {"fields_around", ReflectanceFields::kAround},
          {"fields_pitch_mm", o.fields.pitch_mm},
          {"texture", device.texture ? nlohmann::json(*device.texture) : nlohmann::json(nullptr)},
          {"paint", to_string(device.paint)},
          {"backlash_rad", device.turntable.backlash_rad},
          {"glaze", o.glaze}};
}

nlohmann::json corners_of(const DeviceConfig& device, const Scene& scene, const Posture& posture) {
  const VirtualCamera camera(device.optics.camera, device.optics.X_CW);
  const OpticsConfig& o = device.optics;
  const TablePose seen = scene.table_pose(posture, o.spindle, o.axes);
  const TablePose stands = scene.table_pose({posture.table_rad, 0, posture.lift_mm}, o.spindle, o.axes);
  nlohmann::json corners = nlohmann::json::array();
  for (const PrintedCorner& corner : scene.corners()) {
    const Eigen::Vector3d p = stands.to_head(corner.p);  // the head's frame at elevation 0 is the scanner's
    const Eigen::Vector2d pixel = camera.project(seen.to_head(corner.p));
    const bool inside = pixel.x() > -0.5 && pixel.y() > -0.5 && pixel.x() < camera.intrinsics().width_px - 0.5 &&
                        pixel.y() < camera.intrinsics().height_px - 0.5;
    if (!inside) continue;
    corners.push_back({{"id", corner.id},
                       {"corner", corner.corner},
                       {"x_px", pixel.x()},
                       {"y_px", pixel.y()},
                       {"p_mm", {p.x(), p.y(), p.z()}}});
  }
  return corners;
}

}  // namespace celadon::sim
