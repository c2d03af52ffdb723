#pragma once
// From scene, laser sheet and camera to the bytes of a frame. README.md, "How a frame is made".

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "acquisition/frame.h"
#include "sim/noise.h"
#include "sim/projection.h"
#include "sim/scene.h"

namespace celadon::sim {

/// Laser sheet in the scanner frame: the plane normal . p = distance with a Gaussian profile across it, fanned out from
/// an emitter that lies in the plane.
struct LaserSheet {
  Eigen::Vector3d normal_W = Eigen::Vector3d::UnitY();
  double distance_mm = 0;
  Eigen::Vector3d emitter_W = Eigen::Vector3d(310, 0, 110);
  double sigma_mm = 0.25;  ///< standard deviation of the irradiance across the sheet
};

/// All of the optics. Brightness in grey levels at reference_exposure_ns and full laser power.
struct OpticsConfig {
  CameraIntrinsics camera;
  Eigen::Isometry3d X_CW = Eigen::Isometry3d::Identity();
  LaserSheet sheet;
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
  SensorNoise noise;
  PixelFormat format = PixelFormat::grey8;
};

/// The default machine: camera 300 mm from the axis, 30 degrees beside the laser and 12 degrees above the horizontal,
/// its rows 0.11 to 0.14 mm apart at the object; sheet through the axis but for offset and tilt.
/// @pre width_px, height_px > 0
OpticsConfig default_optics(int width_px, int height_px, double sheet_offset_mm, double sheet_tilt_rad);

/// Table angle and laser power over time, sampled on a regular grid that covers a frame's exposure.
struct MotionRecord {
  struct Sample {
    double angle_rad = 0, speed_rad_per_s = 0, laser_power = 0;
  };
  std::int64_t first_ns = 0, step_ns = 1'000'000;
  std::vector<Sample> samples;

  /// Hermite interpolation. @pre samples is not empty; times outside are clamped
  double angle_rad(std::int64_t time_ns) const;
  /// Mean laser power between two instants, piecewise linear.
  double mean_power(std::int64_t from_ns, std::int64_t to_ns) const;
};

/// One frame to be rendered. Row y is exposed over [first_row_end_ns - exposure_ns, first_row_end_ns] + y *
/// line_time_ns.
struct Exposure {
  std::uint64_t seed = 0, frame = 0;
  std::int64_t first_row_end_ns = 0, exposure_ns = 0, line_time_ns = 0;
  MotionRecord motion;
  double ambient_factor = 1;  ///< room light relative to normal
};

/// Renders frames; a pure function of the exposure. Owns scratch memory: one thread at a time.
class Renderer {
 public:
  Renderer(Scene scene, const OpticsConfig& config);

  /// Fills `out` (height rows of stride_bytes).
  /// @pre out.size() >= height * stride_bytes, stride_bytes >= width * bytes per pixel
  void render(const Exposure& exposure, std::span<std::uint8_t> out, std::size_t stride_bytes);
  /// Mean brightness of the laser line alone, in levels over the background, without speckle and noise: for tests.
  void render_line(const Exposure& exposure, std::vector<float>& levels);

  /// Another pose of the object on the table, or a camera that was turned about its own vertical.
  void place(const ObjectPose& pose, double camera_turn_rad);

  const Scene& scene() const { return scene_; }
  const OpticsConfig& config() const { return config_; }
  const VirtualCamera& camera() const { return camera_; }

 private:
  static constexpr int kAcross = 5;  ///< places across the sheet that are traced
  struct Beam {                      ///< one ray of the fan at one place across the sheet, traced
    double x_px = 0, y_px = 0;
    float brightness = 0;       ///< relative irradiance times reflectance towards the camera
    std::int8_t material = -1;  ///< -1: nothing visible
    Eigen::Vector3f p;
  };
  struct Strand {  ///< the traced fan at one table motion
    std::array<std::vector<Beam>, kAcross> beams;
  };

  double across_mm(int k) const;
  double angle_for_row(const Exposure& exposure, double row, double node) const;
  Beam trace(const Ray& ray_W, double angle_rad, double* t_hint) const;
  void trace_fan(const Exposure& exposure, double node, Strand& strand) const;
  void draw_strand(const Strand& strand, double weight, const Exposure& exposure);
  void draw_row(int row, const std::array<double, kAcross>& x, const std::array<double, kAcross>& brightness, int first,
                int last, double scale);
  void draw_reflection(int row, double x_px, double sigma_px, double peak);
  void draw_line(const Exposure& exposure);
  void update_ambient(double angle_rad);
  void speckle_row(const RandomKey& key, int row, int from, int to);

  Scene scene_;
  double camera_turn_rad_ = 0;
  OpticsConfig config_;
  VirtualCamera camera_;
  std::vector<Eigen::Vector3d> fan_;  ///< directions in the sheet, a few rows apart
  Strand strand_;
  bool strand_is_current_ = false;  ///< of a scene that looks the same at every angle
  std::vector<float> signal_;       ///< laser light, levels, height x width
  struct Span {
    int from = 0, to = 0;
  };
  std::vector<Span> lit_;       ///< columns of each row with laser light
  std::vector<float> ambient_;  ///< room light, levels
  long ambient_cell_ = 0;
  bool ambient_ready_ = false;
  std::vector<float> mean_, speckle_, white_;
  std::array<std::vector<std::uint8_t>, 3> colour_;
};

}  // namespace celadon::sim
