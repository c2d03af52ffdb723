#include "sim/exposure.h"

#include <algorithm>
#include <cmath>

namespace celadon::sim {

Posture MotionRecord::posture(std::int64_t time_ns) const {
  const double at = std::clamp(static_cast<double>(time_ns - first_ns) / static_cast<double>(step_ns), 0.0,
                               static_cast<double>(samples.size() - 1));
  const auto i = std::min(static_cast<std::size_t>(at), samples.size() - 1), j = std::min(i + 1, samples.size() - 1);
  const double f = at - static_cast<double>(i), dt = static_cast<double>(step_ns) * 1e-9;
  const auto between = [&](double Sample::*position, double Sample::*speed) {
    const double a = samples[i].*position, b = samples[j].*position;
    const double va = samples[i].*speed * dt, vb = samples[j].*speed * dt;
    const double d = b - a;
    return a + f * (va + f * ((3 * d - 2 * va - vb) + f * (va + vb - 2 * d)));
  };
  return {between(&Sample::angle_rad, &Sample::speed_rad_per_s),
          between(&Sample::elevation_rad, &Sample::elevation_rad_per_s),
          between(&Sample::lift_mm, &Sample::lift_mm_per_s)};
}

double MotionRecord::mean_power(std::int64_t from_ns, std::int64_t to_ns, int laser) const {
  const auto power = laser == 0 ? &Sample::laser_power : &Sample::second_laser_power;
  if (to_ns <= from_ns) return 0;
  // Integral of the piecewise linear power, interval by interval.
  const auto power_at = [this, power](double at) {
    const double x = std::clamp(at, 0.0, static_cast<double>(samples.size() - 1));
    const auto i = static_cast<std::size_t>(x), j = std::min(i + 1, samples.size() - 1);
    const double f = x - static_cast<double>(i);
    return samples[i].*power * (1 - f) + samples[j].*power * f;
  };
  const auto place = [this](std::int64_t t) {
    return static_cast<double>(t - first_ns) / static_cast<double>(step_ns);
  };
  const double begin = place(from_ns), end = place(to_ns);
  double sum = 0, a = begin;
  while (a < end) {
    const double b = std::min(end, std::floor(a) + 1);
    sum += (b - a) * 0.5 * (power_at(a) + power_at(b));
    a = b;
  }
  return sum / (end - begin);
}

Posture Exposure::posture_at(double row, double node) const {
  const double at = static_cast<double>(line_time_ns) * row + 0.5 * (node - 1) * static_cast<double>(exposure_ns);
  return motion.posture(first_row_end_ns + std::llround(at));
}

}  // namespace celadon::sim
