#pragma once
// How far many points lie from a range function's surface: along their rays, and at right angles to it to first order.
// Source: README.md, "Batches".

#include <cstddef>
#include <optional>

#include "fitting/range_batch.h"
#include "fitting/range_function.h"

namespace celadon {

/// RangeFunction::membership for batches, up to rounding. Positive outside; not a number where the coordinate along the
/// base is outside the band. A point's result has the same bits alone, in a batch, and at every SIMD level.
class SignedDistance {
 public:
  /// @throws std::invalid_argument if the function's arcs are not those of the full circle
  explicit SignedDistance(const RangeFunction& function);
  /// e_p: the range of each point minus F along its ray. Coordinates of the scanner frame in mm; arrays of length n.
  void along_ray(const double* x, const double* y, const double* z, std::size_t n, double* ray_mm) const;
  /// e_p cos(psi), psi between ray and surface normal: the distance for cones, first order else.
  void to_surface(const double* x, const double* y, const double* z, std::size_t n, double* distance_mm) const;

 private:
  struct Places;
  void along_meridian(Places& at, std::size_t n, bool slopes) const;
  void between_rims(const double* z, Places& at, std::size_t n, bool slopes) const;
  void measure(const double* x, const double* y, const double* z, std::size_t n, double* result, bool slopes) const;
  BaseSurface base_;
  bool in_scanner_frame_;
  RangeBatch batch_;
  std::optional<RangeBatch> heights_;
};

}  // namespace celadon
