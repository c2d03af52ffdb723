#pragma once
// What the rotary axis's encoder tells of the table's angle. README.md, "The table's angle".

#include "acquisition/measured.h"

namespace celadon {

/// The table's true angle, counter-clockwise seen from above, at the encoder angle b (unwrapped, 0 at the index):
/// direction (scale b + cos_rad (cos b - 1) + sin_rad sin b). The last two are what a disc errs by once a turn whose
/// middle lies beside the axis. It rises or falls everywhere: hypot(cos_rad, sin_rad) < scale.
struct TableEncoder {
  Measured scale{1, 0}, cos_rad, sin_rad;
  double direction = 1;  ///< +1: the table turns counter-clockwise for rising encoder angles

  double table_rad(double encoder_rad) const;
  /// d table_rad / d encoder_rad there.
  double rate(double encoder_rad) const;
  /// The inverse of table_rad.
  double encoder_rad(double table_rad) const;
};

}  // namespace celadon
