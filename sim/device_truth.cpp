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
          {"backlash_rad", device.turntable.backlash_rad},
          {"glaze", o.glaze}};
}

}  // namespace celadon::sim
