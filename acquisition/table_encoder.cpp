#include "acquisition/table_encoder.h"

#include <cmath>

namespace celadon {

double TableEncoder::table_rad(double encoder_rad) const {
  return direction * (scale.value * encoder_rad + cos_rad.value * (std::cos(encoder_rad) - 1) +
                      sin_rad.value * std::sin(encoder_rad));
}

double TableEncoder::rate(double encoder_rad) const {
  return direction * (scale.value - cos_rad.value * std::sin(encoder_rad) + sin_rad.value * std::cos(encoder_rad));
}

double TableEncoder::encoder_rad(double table_rad) const {
  double b = direction * table_rad / scale.value;
  if (cos_rad.value == 0 && sin_rad.value == 0) return b;
  // Newton's steps from where the even part would be: thousandths of a radian off, and nearly linear.
  constexpr int kSteps = 20;
  constexpr double kRounding_rad = 1e-15;
  for (int k = 0; k < kSteps; ++k) {
    const double step = (table_rad - this->table_rad(b)) / rate(b);
    b += step;
    if (std::abs(step) <= kRounding_rad * (1 + std::abs(b))) break;
  }
  return b;
}

}  // namespace celadon
