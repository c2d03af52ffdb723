// Closed poles of a sphere: the 2-jet against the level pole of the thesis (3.14), on a body whose tangent planes at
// the poles are normal to the axis and on one whose are tilted. Noise free, even samples; errors over the intervals an
// arc.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>

#include "tests/fitting/sphere_tools.h"

namespace {

using celadon::PoleRule;
using celadon::test::Body;
using celadon::test::kPi;

constexpr double kNear_rad = 0.3;
constexpr int kSamples = 400'000, kIntervals[] = {4, 8, 16, 32};
constexpr unsigned kSeed = 11;

struct Errors {
  double largest_mm = 0, near_pole_mm = 0;
  double normal_deg = 0;        ///< beside the pole, against the body's normal there
  double curvature_per_mm = 0;  ///< between the two halves of a meridian plane
};

// Direction of a body's tangent plane at phi = 0, from its own values.
Eigen::Vector3d normal_of(const Body& body) {
  const double h = 1e-5;
  const auto slope = [&](double theta) { return (body(h, theta) - body(h, theta + kPi)) / (2 * h); };
  return Eigen::Vector3d(-slope(0), -slope(kPi / 2), body(0, 0)).normalized();
}

Errors errors_of(const celadon::RangeFunction& f, const Body& body) {
  const celadon::BaseArcs& meridian = celadon::BaseSurface::meridian();
  Errors e;
  for (int i = 0; i <= 300; ++i)
    for (int j = 0; j < 96; ++j) {
      const double phi = kPi * i / 300, theta = 2 * kPi * (j + 0.3) / 96;
      const double miss = std::abs(f(theta, meridian.v_of_theta(phi)) - body(phi, theta));
      e.largest_mm = std::max(e.largest_mm, miss);
      if (phi < kNear_rad) e.near_pole_mm = std::max(e.near_pole_mm, miss);
    }
  const Eigen::Vector3d truth = normal_of(body);
  double phi_w = 1, phi_ww = 0;
  meridian.theta_derivatives(0, phi_w, phi_ww);
  // Of the plane curve rho(phi), which goes on at theta + pi.
  const auto curvature = [&](double theta) {
    const celadon::RangeDerivatives r = f.derivatives(theta, 0);
    const double d = r.r_z / phi_w, dd = (r.r_z_z - d * phi_ww) / (phi_w * phi_w);
    return (r.r_mm * r.r_mm + 2 * d * d - r.r_mm * dd) / std::pow(r.r_mm * r.r_mm + d * d, 1.5);
  };
  for (int j = 0; j < 96; ++j) {
    const double theta = 2 * kPi * (j + 0.3) / 96;
    const Eigen::Vector3d n = f.surface_point(theta, 1e-7).normal_W;
    e.normal_deg = std::max(e.normal_deg, std::atan2(n.cross(truth).norm(), n.dot(truth)) * 180 / kPi);
    e.curvature_per_mm = std::max(e.curvature_per_mm, std::abs(curvature(theta) - curvature(theta + kPi)));
  }
  return e;
}

}  // namespace

int main() {
  const struct {
    const char* name;
    Body body;
  } bodies[] = {
      {"level: 25 + 2 s^2 cos 2t + s^3 sin 3t mm, s = sin phi",
       [](double phi, double t) {
         const double s = std::sin(phi);
         return 25 + 2 * s * s * std::cos(2 * t) + s * s * s * std::sin(3 * t);
       }},
      {"tilted: a sphere of 25 mm off its centre by (3, 1, 2)", celadon::test::off_centre_sphere(25, {3, 1, 2})}};
  std::printf("%d samples, noise free, degree (3, 3), seed %u; near: within %.1f rad of the pole phi = 0\n", kSamples,
              kSeed, kNear_rad);
  for (const auto& [name, body] : bodies) {
    celadon::test::MemoryStream stream = celadon::test::scattered_body(body, {.samples = kSamples, .seed = kSeed});
    std::printf("\n%s\n%-6s %9s %12s %6s %12s %6s %12s %14s\n", name, "pole", "intervals", "largest mm", "order",
                "near mm", "order", "normal deg", "curvature 1/mm");
    for (const PoleRule rule : {PoleRule::level, PoleRule::jet}) {
      Errors before;
      for (const int n : kIntervals) {
        celadon::RangeFitOptions options;
        options.model = celadon::SurfaceModel::general;
        options.z_intervals = 2 * n;
        options.intervals_per_arc = n;
        options.robust = options.smoothing = false;
        options.pole_rule = rule;
        const auto fit = celadon::test::fit_sphere(stream, options);
        if (!fit) {
          std::fprintf(stderr, "pole_accuracy: %s\n", fit.error().message.c_str());
          return 1;
        }
        const Errors e = errors_of(fit->function, body);
        const auto order = [&](double now, double then) { return then > 0 ? std::log2(then / now) : std::nan(""); };
        std::printf("%-6s %9d %12.2e %6.1f %12.2e %6.1f %12.2e %14.2e\n", rule == PoleRule::jet ? "jet" : "level", n,
                    e.largest_mm, order(e.largest_mm, before.largest_mm), e.near_pole_mm,
                    order(e.near_pole_mm, before.near_pole_mm), e.normal_deg, e.curvature_per_mm);
        before = e;
      }
    }
  }
  return 0;
}
