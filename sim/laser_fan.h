#pragma once
// The laser's fan of rays, traced into the scene and on to the image.

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "sim/exposure.h"
#include "sim/optics.h"
#include "sim/scene.h"

namespace celadon::sim {

inline constexpr int kAcross = 5;  ///< places across the sheet that are traced

/// One ray of the fan at one place across the sheet.
struct Beam {
  static constexpr int kNothing = -1, kPlatter = 1 << 30;

  double x_px = 0, y_px = 0;
  float brightness = 0;      ///< relative irradiance times reflectance towards the camera
  float around = 0, up = 0;  ///< fields of reflectance, counted from psi = 0 and z = 0
  float halo_px = 0;         ///< x of what leaves the object again, less x_px
  int surface = kNothing;    ///< of the object, kPlatter, or nothing visible
  int facet = 0;
  bool joined = false;  ///< the line goes on to the next ray's point
  double t = 0;         ///< along the ray
  Posture posture;      ///< of the machine
  Eigen::Vector3f p = Eigen::Vector3f::Zero();

  bool visible() const { return surface != kNothing; }
};

/// The traced fan at one table motion.
struct Strand {
  std::vector<Eigen::Vector3d> directions;
  bool dense = false;  ///< rays were added at edges
  std::array<std::vector<Beam>, kAcross> beams;
};

/// Place number k across the sheet, millimetres from its middle.
double across_mm(const LaserSheet& sheet, int k);

class LaserFan {
 public:
  /// From below the platter to a little over the scene's top; where head or table move, as far as the camera sees.
  LaserFan(const OpticsConfig& config, const LaserSheet& sheet, const Scene& scene);

  const LaserSheet& sheet() const { return sheet_; }
  /// The line looks the same at every table angle, as long as head and lift stand.
  bool turns_invisibly(const Scene& scene) const;
  /// Traces all places across the sheet. A ray hits what is first in its way (the laser's shadow) and counts if the
  /// camera sees that point. `node` in [-1, 1] is the place within the exposure. Where a scene has edges, rays are
  /// added until neighbours meet neighbouring points or the edge lies between them.
  void trace(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure, double node,
             Strand& strand) const;
  /// The same rays at another node of an exposure over which the table turns little: what `near` shows is visible.
  void trace_near(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure, double node,
                  const Strand& near, Strand& strand) const;
  /// How far, in pixels, points of a strand traced at node 0 move until `node`: the most of a sample of them.
  double shift_px(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure, double node,
                  const Strand& strand) const;

 private:
  struct View {
    const Scene& scene;
    const VirtualCamera& camera;
    const Exposure& exposure;
    double node;
    Posture middle;
    TablePose middle_pose;
    bool rows_differ;
  };
  View view_of(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure, double node) const;
  Posture posture_for_row(const Exposure& exposure, double row, double node) const;
  Ray ray_W(const Eigen::Vector3d& direction, int k) const;
  struct Near {  ///< a neighbour's point on the object, and where on this ray to look for it
    double t;
    int facet;
    bool is_seen;  ///< what the neighbour says of the camera's view holds here too
  };
  Beam trace_ray(const View& view, const Ray& ray_W, const Posture& posture, const std::optional<Near>& near) const;
  void dress(const View& view, const Hit& hit, const Ray& ray_T, const TablePose& pose, Beam& beam) const;
  Beam trace_middle(const View& view, const Eigen::Vector3d& direction, const Beam* near) const;
  void add_between(const View& view, const Eigen::Vector3d& to, const Beam& end, int depth, Strand& strand) const;
  void trace_across(const View& view, const Strand* near, Strand& strand) const;
  void join(const Scene& scene, Strand& strand) const;

  OpticsConfig config_;
  LaserSheet sheet_;
  std::vector<Eigen::Vector3d> fan_;  ///< directions in the sheet, a few rows apart
};

}  // namespace celadon::sim
