#pragma once
// Light on a row beyond that of a matt surface of one colour.

#include "sim/effects.h"

namespace celadon::sim {

/// Fields of reflectance along a row about the line's middle, counted as Beam does; blur: in fields.
struct FieldsOnRow {
  double around = 0, around_per_px = 0, around_blur = 0;
  double up = 0, up_per_px = 0, up_blur = 0;

  /// 1 on bright fields, 1 / contrast on dark ones, edges blurred; u pixels from the middle.
  double reflectance(double contrast, double u_px) const;
};

/// Adds energy (levels times pixels) e^(-|x - centre| / length) / (2 length) to row[from .. to).
void add_halo(float* row, int from, int to, double centre_px, double length_px, double energy);

}  // namespace celadon::sim
