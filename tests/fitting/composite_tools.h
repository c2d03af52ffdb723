#pragma once
// Bodies of pieces in closed form: r(theta, z) below or between the splits, rho(phi, theta) about the splits.

#include <cmath>
#include <optional>
#include <random>

#include "fitting/composite_fit.h"
#include "tests/fitting/sphere_tools.h"

namespace celadon::test {

struct PieceBody {
  Shape wall;
  double low = 0, high = 0;  ///< of the wall
  Body below, above;         ///< about (0, 0, low) and (0, 0, high); null: open there
};

/// A wall of radius R between hemispheres.
inline PieceBody capsule(double R, double low, double high, bool head_below, bool head_above) {
  const Body ball = [R](double, double) { return R; };
  return {.wall = [R](double, double) { return R; },
          .low = low,
          .high = high,
          .below = head_below ? ball : Body(),
          .above = head_above ? ball : Body()};
}

/// Squeezed, with a wall that leans at the rim by `slope` and bends below it: tangent planes agree on the rim for every
/// theta: r = R(theta) g(z), rho = R0 + a cos(2 theta) sin^2(phi) + c(theta, phi) cos(phi) with c = r r_z at the rim.
struct Knob {
  double R0 = 25, a = 2, slope = 0.3, bend = -1e-3, low = 20, high = 60, flat = 0.15;
  double R(double theta) const { return R0 + a * std::cos(2 * theta); }
  PieceBody body() const {
    const Knob k = *this;
    return {.wall =
                [k](double theta, double z) {
                  const double h = z - k.high;
                  return k.R(theta) * (1 + k.slope / k.R0 * h + k.bend / k.R0 * h * h);
                },
            .low = low,
            .high = high,
            .below = {},
            .above =
                [k](double phi, double theta) {
                  const double s2 = std::pow(std::sin(phi), 2), c = std::cos(phi), m = k.slope / k.R0;
                  const double round = k.R0 * k.R0 + k.a * k.a / 2, two = 2 * k.R0 * k.a * std::cos(2 * theta),
                               four = k.a * k.a / 2 * std::cos(4 * theta);
                  return k.R0 + k.a * std::cos(2 * theta) * s2 + m * (round + two * s2 + four * s2 * s2) * c -
                         k.flat * k.R0 * c * c;
                }};
  }
};

/// Even samples of wall and heads, each by its own area about.
inline MemoryStream scattered_pieces(const PieceBody& body, int samples, double sigma, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0, 1);
  const double R = body.wall(0, (body.low + body.high) / 2);
  const double wall = body.high - body.low, below = body.below ? R : 0, above = body.above ? R : 0;
  MemoryStream stream;
  for (int k = 0; k < samples; ++k) {
    if (k % 1024 == 0) {
      stream.profiles.emplace_back();
      stream.profiles.back().order = ProfileOrder::scattered;
    }
    const double at = share(random) * (wall + below + above), theta = 2 * kPi * share(random),
                 e = sigma * normal(random);
    if (at < wall) {
      const double z = body.low + at;
      push(stream.profiles.back(), body.wall(theta, z) + e, theta, z);
      continue;
    }
    const bool up = at >= wall + below;
    const double c = share(random), phi = up ? std::acos(c) : std::acos(-c);
    const double rho = (up ? body.above : body.below)(phi, theta) + e;
    push(stream.profiles.back(), rho * std::sin(phi), theta, (up ? body.high : body.low) + rho * std::cos(phi));
  }
  return stream;
}

/// Of a piece to the body it stands for.
inline Miss miss_piece(const RangeFunction& f, const PieceBody& body) {
  if (!f.base().spherical()) {
    Miss m;
    double square = 0;
    for (int i = 0; i <= 100; ++i)
      for (int j = 0; j < 97; ++j) {
        const double z = f.base().band_start + (f.base().band_end - f.base().band_start) * i / 100,
                     t = 2 * kPi * j / 97;
        const double e = f(t, z) - body.wall(t, z);
        square += e * e;
        m.max = std::max(m.max, std::abs(e));
      }
    m.rms = std::sqrt(square / (101 * 97));
    return m;
  }
  return miss_sphere(f, f.base().band_end == 1 ? body.above : body.below);
}

}  // namespace celadon::test
