#pragma once
// The optics of the machine: camera, laser sheet, light and noise.

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <optional>

#include "acquisition/frame.h"
#include "sim/effects.h"
#include "sim/noise.h"
#include "sim/projection.h"
#include "sim/table_pose.h"

namespace celadon::sim {

/// Laser sheet in the scanner frame: the plane normal . p = distance with a Gaussian profile across it, fanned out from
/// an emitter that lies in the plane.
struct LaserSheet {
  Eigen::Vector3d normal_W = Eigen::Vector3d::UnitY();
  double distance_mm = 0;
  Eigen::Vector3d emitter_W = Eigen::Vector3d(310, 0, 110);
  double sigma_mm = 0.25;  ///< standard deviation of the irradiance across the sheet
  double azimuth_rad = 0;  ///< the side that the light comes from
  /// The sheet is bowed: 50 mm above and below the emitter's height, 30 mm in front of the axis, by this along the
  /// normal; with the square of the height.
  double bow_mm = 0;
};

/// All of the optics. Brightness in grey levels at reference_exposure_ns and full laser power.
struct OpticsConfig {
  CameraIntrinsics camera;
  Eigen::Isometry3d X_CW = Eigen::Isometry3d::Identity();
  LaserSheet sheet;
  std::optional<LaserSheet> second_sheet;  ///< of laser 1, on the other side of the camera
  std::int64_t reference_exposure_ns = 4'000'000;
  double line_levels = 150;                   ///< peak of a sheet of 0.25 mm at normal incidence at the axis
  double blur_px = 0.6;                       ///< standard deviation of lens blur and pixel footprint together
  double ambient_low = 6, ambient_high = 18;  ///< background, from one corner to the other
  double object_ambient = 22;                 ///< the object's brightest side under room light
  double platter_albedo = 0.08;               ///< relative to the object's
  double speckle_contrast = 0.2;
  double reflection = 0.1;  ///< stray secondary line, share of the line's brightness
  double glaze = 0;         ///< strength of a glossy lobe on the object, relative to its diffuse brightness
  double glaze_exponent = 60;
  SpindleErrors spindle;
  MachineAxes axes;
  Subsurface subsurface;
  ReflectanceFields fields;
  SensorNoise noise;
  PixelFormat format = PixelFormat::grey8;
};

/// Red, green and blue of the room's warm light, as a colour camera has a white surface.
inline constexpr std::array<float, 3> kRoomColour{1.F, 0.9F, 0.8F};

/// The default machine: camera 300 mm from the axis, 30 degrees beside the laser and 12 degrees above the horizontal,
/// its rows 0.11 to 0.14 mm apart at the object; sheet through the axis but for offset and tilt.
/// @pre width_px, height_px > 0
OpticsConfig default_optics(int width_px, int height_px, double sheet_offset_mm, double sheet_tilt_rad);
/// Direction of a horizontal axis across the camera's view, about which positive angles raise the camera.
Eigen::Vector3d across_the_view(const Eigen::Isometry3d& X_CW);
/// The sheet of a second laser: the mirror image of the default machine's in the vertical plane of axis and camera.
LaserSheet mirrored_sheet(const LaserSheet& sheet);

}  // namespace celadon::sim
