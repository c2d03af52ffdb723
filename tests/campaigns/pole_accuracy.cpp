// Closed poles of a sphere: the 2-jet against the level pole of the thesis (3.14) and its cap (3.15) - (3.24), on a
// body whose tangent planes at the poles are normal to the axis, on one whose are tilted, and on one that is tilted and
// uneven besides, where the level pole wobbles (figure 3.7). Noise free, even samples; errors over the intervals an
// arc.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>

#include "fitting/thesis_cap.h"
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

// The surface fitted around a hole of kHole_rad, closed by a cap: errors of the cap.
struct CapErrors {
  double largest_mm = 0, normal_deg = 0, curvature_per_mm = 0;
  double rim_deg = 0, rim_curvature_per_mm = 0;  ///< against the surface that it closes
};

// Normal curvature along u.
double curvature_along(const celadon::SurfaceDerivatives& d) {
  const Eigen::Vector3d n = d.S_u.cross(d.S_v).normalized();
  return d.S_uu.dot(n) / d.S_u.squaredNorm();
}

CapErrors errors_of_cap(const celadon::RangeFunction& f, const Body& body) {
  const celadon::ThesisCap cap = celadon::thesis_cap(f);
  const celadon::NurbsSurface around = symbolic_product(f);
  const double turn = around.knots_v.back(), half = turn / 2;
  const Eigen::Vector3d truth = normal_of(body);
  CapErrors e;
  for (int j = 0; j < 96; ++j) {
    const double v = turn * (j + 0.3) / 96, opposite = v < half ? v + half : v - half;
    for (int i = 0; i <= 60; ++i) {
      const Eigen::Vector3d p = cap.surface.evaluate(i / 60.0, v);
      const double phi = std::atan2(std::hypot(p.x(), p.y()), p.z());
      e.largest_mm = std::max(e.largest_mm, std::abs(p.norm() - body(phi, std::atan2(p.y(), p.x()))));
    }
    const auto pole = cap.surface.derivatives(1e-4, v), other = cap.surface.derivatives(1e-4, opposite);
    const Eigen::Vector3d n = pole.S_u.cross(pole.S_v).normalized();
    e.normal_deg = std::max(e.normal_deg, std::atan2(n.cross(truth).norm(), std::abs(n.dot(truth))) * 180 / kPi);
    e.curvature_per_mm = std::max(e.curvature_per_mm, std::abs(curvature_along(pole) - curvature_along(other)));
    const auto rim = cap.surface.derivatives(1, v), beyond = around.derivatives(around.knots_u.front(), v);
    const Eigen::Vector3d a = rim.S_u.cross(rim.S_v).normalized(), b = beyond.S_u.cross(beyond.S_v).normalized();
    e.rim_deg = std::max(e.rim_deg, std::atan2(a.cross(b).norm(), std::abs(a.dot(b))) * 180 / kPi);
    e.rim_curvature_per_mm = std::max(e.rim_curvature_per_mm, std::abs(curvature_along(rim) - curvature_along(beyond)));
  }
  return e;
}

// Intervals that the cap spans: two of the finest each, so that the hole shrinks with the intervals.
constexpr double kCapIntervals = 2;

int print_caps(const Body& body) {
  CapErrors before;
  for (const int n : kIntervals) {
    const celadon::BaseArcs& meridian = celadon::BaseSurface::meridian();
    const double hole_w = kCapIntervals / n, hole_rad = meridian.theta_of_v(hole_w);
    celadon::test::MemoryStream stream =
        celadon::test::scattered_body(body, {.samples = kSamples, .phi_low = hole_rad, .phi_high = kPi, .seed = kSeed});
    celadon::RangeFitOptions options;
    options.model = celadon::SurfaceModel::general;
    options.z_intervals = 2 * n;
    options.intervals_per_arc = n;
    options.robust = options.smoothing = false;
    options.reach_start = hole_w;
    const auto fit = celadon::test::fit_sphere(stream, options);
    if (!fit) {
      std::fprintf(stderr, "pole_accuracy: %s\n", fit.error().message.c_str());
      return 1;
    }
    const CapErrors e = errors_of_cap(fit->function, body);
    std::printf("%-6s %9d %12s %6s %12.2e %6.1f %12.2e %14.2e   at its rim: %.2e deg, %.2e 1/mm\n", "cap", n, "", "",
                e.largest_mm, before.largest_mm > 0 ? std::log2(before.largest_mm / e.largest_mm) : std::nan(""),
                e.normal_deg, e.curvature_per_mm, e.rim_deg, e.rim_curvature_per_mm);
    before = e;
  }
  return 0;
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
      {"tilted: a sphere of 25 mm off its centre by (3, 1, 2)", celadon::test::off_centre_sphere(25, {3, 1, 2})},
      {"tilted and uneven: 25 + 4 x + 2 y + 3 x y + 2 x^3 - y^2 mm, (x, y) = sin phi (cos t, sin t)",
       [](double phi, double t) {
         const double x = std::sin(phi) * std::cos(t), y = std::sin(phi) * std::sin(t);
         return 25 + 4 * x + 2 * y + 3 * x * y + 2 * x * x * x - y * y;
       }}};
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
    if (const int failed = print_caps(body)) return failed;
  }
  return 0;
}
