#pragma once
// The unit base circle as equal rational quadratic Bezier arcs, and the synchronisation of theta with its parameter v.
// Source: thesis (2.3) - (2.8); stable form of (2.7) as in README.md, "Base arcs".

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace celadon {

/// How functions over arcs go on beyond both ends.
enum class ArcEnds : std::uint8_t {
  free,      ///< not at all
  periodic,  ///< from the start again
  mirrored   ///< back the same way
};

/// Equal rational quadratic arcs over [start_rad, start_rad + range_rad], each on a unit parameter interval:
/// v in [0, count()].
class BaseArcs {
 public:
  /// The full circle: four arcs of 90 degrees from theta = 0, closed.
  static BaseArcs full_circle();
  /// max(1, ceil(range / 90 degrees - 1e-9)) equal arcs, open.
  /// @pre 0 < range_rad <= 2 pi
  static BaseArcs open(double start_rad, double range_rad);
  /// The same, part of a circle that consists of such sectors, each the next one's repetition or mirror image.
  /// @pre the circle holds a whole number of them, an even one if mirrored
  static BaseArcs sector(double start_rad, double range_rad, ArcEnds ends);
  /// The full circle in `count` equal arcs from start_rad, closed. @pre count >= 3
  static BaseArcs circle(int count, double start_rad);

  int count() const { return count_; }
  double arc_rad() const { return arc_rad_; }
  double start_rad() const { return start_rad_; }
  /// All of a circle.
  bool closed() const { return closed_; }
  ArcEnds ends() const { return ends_; }
  bool periodic() const { return ends_ == ArcEnds::periodic; }
  /// Middle weight of each arc, cos(arc/2) (2.4).
  double weight() const { return weight_; }

  /// The angle is on the arcs; ends that differ by rounding alone are. @pre finite
  bool contains(double theta_rad) const;
  /// Parameter v of an angle (2.8). Closed arcs take any theta; open ones clamp to their range.
  double v_of_theta(double theta_rad) const;
  /// Angle of a parameter v in [0, count()], in [start, start + range].
  double theta_of_v(double v) const;
  /// d theta / d v and d^2 theta / d v^2, taken from the arc that contains v (the right one at a joint unless v ==
  /// count()).
  void theta_derivatives(double v, double& theta_v, double& theta_vv) const;
  /// v and r of points (x, y), without any arctangent; SIMD. Arrays of length n; x = y = 0 gives r = 0, v = 0.
  void synchronise(const double* x, const double* y, std::size_t n, double* v, double* r) const;
  /// v of angles; SIMD. Arrays of length n.
  void synchronise(const double* theta_rad, std::size_t n, double* v) const;
  /// The same for samples, of which some may have no place on the arcs: those get kNoAngle or kOutside. Of points whose
  /// r is not finite or 0, v means nothing.
  void place(const double* theta_rad, std::size_t n, double* v) const;
  void place(const double* x, const double* y, std::size_t n, double* v, double* r) const;
  static constexpr double kNoAngle = -1;  ///< an angle that is not finite
  static constexpr double kOutside = -2;  ///< not within an open range
  bool operator==(const BaseArcs&) const = default;

  /// Clamped knot vector of degree 2 with full multiplicity at the joints (2.3).
  std::vector<double> knots() const;
  /// Homogeneous control points (w x, w y, w), one per row, (2 count() + 1) x 3.
  Eigen::MatrixX3d control_points() const;

 private:
  double placed(double theta_rad, double v) const;
  int count_ = 4;
  double start_rad_ = 0, arc_rad_ = 0, weight_ = 0;
  bool closed_ = true;
  ArcEnds ends_ = ArcEnds::periodic;
};

}  // namespace celadon
