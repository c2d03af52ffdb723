#include "sim/line_effects.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace celadon::sim {
namespace {

// 1 between an even whole number and the next, -1 between an odd one and the next, edges blurred.
double square_wave(double at, double blur) {
  const double edge = std::round(at);
  const double sense = std::fmod(std::abs(edge), 2) == 0 ? 1 : -1;
  return sense * std::erf((at - edge) / (std::numbers::sqrt2 * std::max(blur, 1e-9)));
}

}  // namespace

double FieldsOnRow::reflectance(double contrast, double u) const {
  const double wave = square_wave(around + around_per_px * u, around_blur) * square_wave(up + up_per_px * u, up_blur);
  return 0.5 * (1 + 1 / contrast) + 0.5 * (1 - 1 / contrast) * wave;
}

void add_halo(float* row, int from, int to, double centre, double length, double energy) {
  for (int x = from; x < to; ++x) {
    row[x] += static_cast<float>(0.5 * energy / length * std::exp(-std::abs(x - centre) / length));
  }
}

}  // namespace celadon::sim
