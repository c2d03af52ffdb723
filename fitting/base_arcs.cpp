// Compiled once per SIMD target; only additions, products, quotients and square roots, so that every target gives the
// same bits, and tails go through the same lanes as the rest.
#include "fitting/base_arcs.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/base_arcs.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef CELADON_FITTING_BASE_ARCS_ONCE
#define CELADON_FITTING_BASE_ARCS_ONCE
#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>

namespace celadon {
namespace {

// What the lanes need to know of the arcs.
struct ArcConstants {
  int count;
  bool quadrants;  // the full circle from theta = 0 in four arcs
  double start_rad, arc_rad, range_rad;
  double sin_half;                // sin(arc/2)
  double one_minus_w;             // 1 - w = 2 sin^2(arc/4)
  double start_cos, start_sin;    // of the first joint
  double arc_cos, arc_sin;        // from one joint to the next
  double middle_cos, middle_sin;  // of the middle of the range, seen from the start
};

// Lanes reduce the angle by up to this many arcs exactly; beyond, it is brought back by the library's remainder.
constexpr double kLargestAngle = 1e5;

}  // namespace
}  // namespace celadon
#endif

// Highway's scalar target lacks operations used here and is never needed: the baseline is SSSE3 or NEON at least.
#if HWY_TARGET != HWY_SCALAR
HWY_BEFORE_NAMESPACE();
namespace celadon {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;

// Run `body(in, out)` on whole vectors of in[0], in[1] to out[0], out[1]; the tail is padded with zeros and runs
// through the same instructions. Arrays that a body does not use are null.
template <class Body>
void over(std::size_t n, const double* in0, const double* in1, double* out0, double* out1, const Body& body) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const auto at = [](auto* array, std::size_t k) { return array ? array + k : nullptr; };
  std::size_t k = 0;
  for (; k + lanes <= n; k += lanes) body(at(in0, k), at(in1, k), at(out0, k), at(out1, k));
  if (k == n) return;
  double a[hn::MaxLanes(D())] = {}, b[hn::MaxLanes(D())] = {}, c[hn::MaxLanes(D())], e[hn::MaxLanes(D())];
  std::copy(in0 + k, in0 + n, a);
  if (in1) std::copy(in1 + k, in1 + n, b);
  body(a, b, c, e);
  std::copy(c, c + (n - k), out0 + k);
  if (out1) std::copy(e, e + (n - k), out1 + k);
}

// eta = y'/(sin(arc/2)(r + x') + (1 - w) y') in the frame of the arc's start, not above 1; NaN stays.
V eta_of_point(const ArcConstants& c, V x, V y, V r) {
  const D d;
  const V one = hn::Set(d, 1.0);
  const V eta =
      hn::Div(y, hn::Add(hn::Mul(hn::Set(d, c.sin_half), hn::Add(r, x)), hn::Mul(hn::Set(d, c.one_minus_w), y)));
  return hn::IfThenElse(hn::Gt(eta, one), one, eta);
}

void points_in_quadrants(const ArcConstants& c, const double* x, const double* y, std::size_t n, double* v, double* r) {
  const D d;
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0), two = hn::Set(d, 2.0);
  over(n, x, y, v, r, [&](const double* in_x, const double* in_y, double* out_v, double* out_r) {
    const V px = hn::LoadU(d, in_x), py = hn::LoadU(d, in_y);
    const V radius = hn::Sqrt(hn::Add(hn::Mul(px, px), hn::Mul(py, py)));
    // Opposite quadrants share their turned frame but for the sign: fold the lower half plane onto the upper.
    const auto lower = hn::Or(hn::Lt(py, zero), hn::And(hn::Eq(py, zero), hn::Lt(px, zero)));
    const V ux = hn::IfThenElse(lower, hn::Neg(px), px), uy = hn::IfThenElse(lower, hn::Neg(py), py);
    const auto second = hn::Le(ux, zero);
    const V qx = hn::IfThenElse(second, uy, ux), qy = hn::IfThenElse(second, hn::Neg(ux), uy);
    const V joint = hn::Add(hn::IfThenElse(lower, two, zero), hn::IfThenElse(second, one, zero));
    const V parameter = hn::Add(joint, eta_of_point(c, qx, qy, radius));
    hn::StoreU(hn::IfThenElse(hn::Eq(radius, zero), zero, parameter), d, out_v);
    hn::StoreU(radius, d, out_r);
  });
}

void points_on_arcs(const ArcConstants& c, const double* x, const double* y, std::size_t n, double* v, double* r) {
  const D d;
  const V zero = hn::Zero(d);
  const V start_cos = hn::Set(d, c.start_cos), start_sin = hn::Set(d, c.start_sin);
  const V arc_cos = hn::Set(d, c.arc_cos), arc_sin = hn::Set(d, c.arc_sin);
  over(n, x, y, v, r, [&](const double* in_x, const double* in_y, double* out_v, double* out_r) {
    const V px = hn::LoadU(d, in_x), py = hn::LoadU(d, in_y);
    const V radius = hn::Sqrt(hn::Add(hn::Mul(px, px), hn::Mul(py, py)));
    V ax = hn::Add(hn::Mul(start_cos, px), hn::Mul(start_sin, py));
    V ay = hn::Sub(hn::Mul(start_cos, py), hn::Mul(start_sin, px));
    // Outside the range: the nearer end, by the side of the range's middle; NaN stays.
    const V side = hn::Sub(hn::Mul(hn::Set(d, c.middle_cos), ay), hn::Mul(hn::Set(d, c.middle_sin), ax));
    V parameter = hn::IfThenElse(hn::Gt(side, zero), hn::Set(d, static_cast<double>(c.count)), zero);
    parameter = hn::IfThenElse(hn::Eq(side, side), parameter, side);
    for (int j = 0; j < c.count; ++j) {
      const V bx = hn::Add(hn::Mul(arc_cos, ax), hn::Mul(arc_sin, ay));
      const V by = hn::Sub(hn::Mul(arc_cos, ay), hn::Mul(arc_sin, ax));
      // An arc is below 180 degrees: two half planes bound its sector.
      const auto inside = hn::And(hn::Ge(ay, zero), hn::Lt(by, zero));
      const V here = hn::Add(hn::Set(d, static_cast<double>(j)), eta_of_point(c, ax, ay, radius));
      parameter = hn::IfThenElse(inside, here, parameter);
      ax = bx, ay = by;
    }
    hn::StoreU(hn::IfThenElse(hn::Eq(radius, zero), zero, parameter), d, out_v);
    hn::StoreU(radius, d, out_r);
  });
}

// sin(x) for x in [-0.8, 0.8] to half an ulp or so: odd polynomial of degree 15 (Taylor, remainder below 1e-17 x).
V small_sin(V x) {
  const D d;
  static constexpr double kOverFactorial[] = {-1.0 / 1307674368000.0, 1.0 / 6227020800.0, -1.0 / 39916800.0,
                                              1.0 / 362880.0,         -1.0 / 5040.0,      1.0 / 120.0};
  const V x2 = hn::Mul(x, x);
  V sum = hn::Set(d, kOverFactorial[0]);
  for (int k = 1; k < 6; ++k) sum = hn::Add(hn::Mul(sum, x2), hn::Set(d, kOverFactorial[k]));
  sum = hn::Add(hn::Mul(sum, x2), hn::Set(d, -1.0 / 6.0));
  return hn::Add(x, hn::Mul(hn::Mul(sum, x2), x));
}

// Stable form of (2.7): eta = sin(xi/2)/(sin(xi/2) + sin((arc - xi)/2)), xi in [0, arc].
V eta_of_angle(V xi, V rest) {
  const D d;
  const V half = hn::Set(d, 0.5);
  const V a = small_sin(hn::Mul(half, xi)), b = small_sin(hn::Mul(half, rest));
  return hn::Div(a, hn::Add(a, b));
}

// Where the lanes' angle is large, the library's remainder brings it back.
V reduced(V theta) {
  const D d;
  const V limit = hn::Set(d, kLargestAngle);
  if (HWY_LIKELY(hn::AllFalse(d, hn::Gt(hn::Abs(theta), limit)))) return theta;
  double lanes[hn::MaxLanes(D())];
  hn::StoreU(theta, d, lanes);
  for (std::size_t k = 0; k < hn::Lanes(d); ++k) {
    if (std::abs(lanes[k]) > kLargestAngle) lanes[k] = std::remainder(lanes[k], 2 * std::numbers::pi);
  }
  return hn::LoadU(d, lanes);
}

void angles_in_quadrants(const ArcConstants& c, const double* theta_rad, std::size_t n, double* v) {
  const D d;
  // pi/2 in two parts, the first of 33 bits: its multiples are exact.
  const V high = hn::Set(d, 1.57079632673412561417e+00), low = hn::Set(d, 6.07710050650619224932e-11);
  const V arc = hn::Set(d, c.arc_rad), zero = hn::Zero(d), four = hn::Set(d, 4.0);
  over(n, theta_rad, nullptr, v, nullptr, [&](const double* in, const double*, double* out, double*) {
    const V angle = hn::LoadU(d, in);
    const V theta = reduced(angle);
    const V quadrant = hn::Floor(hn::Mul(theta, hn::Set(d, 2 / std::numbers::pi)));
    V xi = hn::Sub(hn::Sub(theta, hn::Mul(quadrant, high)), hn::Mul(quadrant, low));
    xi = hn::IfThenElse(hn::Lt(xi, zero), zero, hn::IfThenElse(hn::Gt(xi, arc), arc, xi));
    const V joint = hn::Sub(quadrant, hn::Mul(four, hn::Floor(hn::Mul(quadrant, hn::Set(d, 0.25)))));
    hn::StoreU(hn::Add(joint, eta_of_angle(xi, hn::Sub(arc, xi))), d, out);
  });
}

void angles_on_arcs(const ArcConstants& c, const double* theta_rad, std::size_t n, double* v) {
  const D d;
  const V arc = hn::Set(d, c.arc_rad), zero = hn::Zero(d), range = hn::Set(d, c.range_rad);
  const V turn = hn::Set(d, 2 * std::numbers::pi);
  const V last = hn::Set(d, static_cast<double>(c.count - 1));
  const V gap = hn::Set(d, 0.5 * (2 * std::numbers::pi - c.range_rad));  // half of what is not covered
  over(n, theta_rad, nullptr, v, nullptr, [&](const double* in, const double*, double* out, double*) {
    const V angle = hn::LoadU(d, in);
    V from_start = hn::Sub(reduced(angle), hn::Set(d, c.start_rad));
    const V turns = hn::Floor(hn::Div(hn::Add(from_start, gap), turn));
    from_start = hn::Sub(from_start, hn::Mul(turns, turn));
    from_start = hn::IfThenElse(hn::Lt(from_start, zero), zero, from_start);
    from_start = hn::IfThenElse(hn::Gt(from_start, range), range, from_start);
    V joint = hn::Floor(hn::Div(from_start, arc));
    joint = hn::IfThenElse(hn::Gt(joint, last), last, joint);
    V xi = hn::Sub(from_start, hn::Mul(joint, arc));
    xi = hn::IfThenElse(hn::Lt(xi, zero), zero, hn::IfThenElse(hn::Gt(xi, arc), arc, xi));
    hn::StoreU(hn::Add(joint, eta_of_angle(xi, hn::Sub(arc, xi))), d, out);
  });
}

void points(const ArcConstants& c, const double* x, const double* y, std::size_t n, double* v, double* r) {
  c.quadrants ? points_in_quadrants(c, x, y, n, v, r) : points_on_arcs(c, x, y, n, v, r);
}

void angles(const ArcConstants& c, const double* theta_rad, std::size_t n, double* v) {
  c.quadrants ? angles_in_quadrants(c, theta_rad, n, v) : angles_on_arcs(c, theta_rad, n, v);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon
HWY_AFTER_NAMESPACE();
#endif  // not scalar

#if HWY_ONCE
namespace celadon {
namespace {

HWY_EXPORT(points);
HWY_EXPORT(angles);

bool in_quadrants(const BaseArcs& arcs) {
  return arcs.closed() && arcs.count() == 4 && arcs.start_rad() == 0;
}

// What angles need; points need the rest.
ArcConstants extents(const BaseArcs& arcs) {
  ArcConstants c{};
  c.count = arcs.count();
  c.quadrants = in_quadrants(arcs);
  c.start_rad = arcs.start_rad();
  c.arc_rad = arcs.arc_rad();
  c.range_rad = arcs.arc_rad() * arcs.count();
  return c;
}

ArcConstants constants(const BaseArcs& arcs) {
  ArcConstants c = extents(arcs);
  const double quarter_sin = std::sin(c.arc_rad / 4);
  c.sin_half = std::sin(c.arc_rad / 2);
  c.one_minus_w = 2 * quarter_sin * quarter_sin;
  c.start_cos = std::cos(c.start_rad);
  c.start_sin = std::sin(c.start_rad);
  c.arc_cos = std::cos(c.arc_rad);
  c.arc_sin = std::sin(c.arc_rad);
  c.middle_cos = std::cos(c.range_rad / 2);
  c.middle_sin = std::sin(c.range_rad / 2);
  return c;
}

}  // namespace

BaseArcs BaseArcs::full_circle() {
  BaseArcs arcs;
  arcs.count_ = 4;
  arcs.arc_rad_ = std::numbers::pi / 2;
  arcs.weight_ = std::numbers::sqrt2 / 2;
  return arcs;
}

BaseArcs BaseArcs::circle(int count, double start_rad) {
  if (count == 4 && start_rad == 0) return full_circle();
  if (count < 3 || !std::isfinite(start_rad))
    throw std::invalid_argument("BaseArcs::circle: " + std::to_string(count) + " arcs from " +
                                std::to_string(start_rad) + " rad; it takes three at least");
  BaseArcs arcs;
  arcs.count_ = count;
  arcs.start_rad_ = start_rad;
  arcs.arc_rad_ = 2 * std::numbers::pi / count;
  arcs.weight_ = std::cos(arcs.arc_rad_ / 2);
  return arcs;
}

BaseArcs BaseArcs::sector(double start_rad, double range_rad, ArcEnds ends) {
  BaseArcs arcs = open(start_rad, range_rad);
  arcs.ends_ = ends;
  return arcs;
}

BaseArcs BaseArcs::open(double start_rad, double range_rad) {
  if (!(range_rad > 0 && range_rad <= 2 * std::numbers::pi) || !std::isfinite(start_rad)) {
    throw std::invalid_argument("BaseArcs::open: from " + std::to_string(start_rad) + " over " +
                                std::to_string(range_rad) + " rad; the range must be in (0, 2 pi]");
  }
  BaseArcs arcs;
  arcs.count_ = std::max(1, static_cast<int>(std::ceil(range_rad / (std::numbers::pi / 2) - 1e-9)));
  arcs.start_rad_ = start_rad;
  arcs.arc_rad_ = range_rad / arcs.count_;
  arcs.weight_ = std::cos(arcs.arc_rad_ / 2);
  arcs.closed_ = false;
  arcs.ends_ = ArcEnds::free;
  return arcs;
}

double BaseArcs::v_of_theta(double theta_rad) const {
  double v = 0;
  synchronise(&theta_rad, 1, &v);
  return v;
}

double BaseArcs::theta_of_v(double v) const {
  const double clamped = std::clamp(v, 0.0, static_cast<double>(count_));
  const double joint = std::min(std::floor(clamped), static_cast<double>(count_ - 1));
  const double eta = clamped - joint, s = std::sin(arc_rad_ / 2);
  const double quarter_sin = std::sin(arc_rad_ / 4), one_minus_w = 2 * quarter_sin * quarter_sin;
  // The inverse of (2.7): tan(xi/2) = eta sin(arc/2)/(1 - (1 - w) eta).
  return start_rad_ + joint * arc_rad_ + 2 * std::atan2(eta * s, 1 - one_minus_w * eta);
}

void BaseArcs::theta_derivatives(double v, double& theta_v, double& theta_vv) const {
  const double clamped = std::clamp(v, 0.0, static_cast<double>(count_));
  const double eta = clamped - std::min(std::floor(clamped), static_cast<double>(count_ - 1));
  const double s = std::sin(arc_rad_ / 2), quarter_sin = std::sin(arc_rad_ / 4);
  const double c = 2 * quarter_sin * quarter_sin;  // 1 - w
  const double W = 1 - 2 * c * eta * (1 - eta);    // the arc's denominator (2.4)
  theta_v = 2 * s / W;
  theta_vv = 4 * s * c * (1 - 2 * eta) / (W * W);
}

void BaseArcs::synchronise(const double* x, const double* y, std::size_t n, double* v, double* r) const {
  // Blocks are small: sines and cosines of the usual arcs are not taken for each of them.
  static const ArcConstants full_circle = constants(BaseArcs::full_circle());
  HWY_DYNAMIC_DISPATCH(points)(in_quadrants(*this) ? full_circle : constants(*this), x, y, n, v, r);
}

void BaseArcs::synchronise(const double* theta_rad, std::size_t n, double* v) const {
  HWY_DYNAMIC_DISPATCH(angles)(extents(*this), theta_rad, n, v);
}

bool BaseArcs::contains(double theta_rad) const {
  constexpr double kRounding = 1e-12;
  const double half = count_ * arc_rad_ / 2;
  return closed_ || std::abs(std::remainder(theta_rad - start_rad_ - half, 2 * std::numbers::pi)) <= half + kRounding;
}

// What lies outside was brought to an end.
double BaseArcs::placed(double theta_rad, double v) const {
  constexpr double kAtAnEnd = 1e-9;
  return (v > kAtAnEnd && v < count_ - kAtAnEnd) || contains(theta_rad) ? v : kOutside;
}

void BaseArcs::place(const double* theta_rad, std::size_t n, double* v) const {
  synchronise(theta_rad, n, v);
  for (std::size_t k = 0; k < n; ++k) v[k] = std::isfinite(theta_rad[k]) ? placed(theta_rad[k], v[k]) : kNoAngle;
}

void BaseArcs::place(const double* x, const double* y, std::size_t n, double* v, double* r) const {
  synchronise(x, y, n, v, r);
  if (closed_) return;
  for (std::size_t k = 0; k < n; ++k)
    if (r[k] > 0 && std::isfinite(r[k])) v[k] = placed(std::atan2(y[k], x[k]), v[k]);
}

std::vector<double> BaseArcs::knots() const {
  std::vector<double> knots{0, 0, 0};
  for (int j = 1; j < count_; ++j) knots.insert(knots.end(), 2, j);
  knots.insert(knots.end(), 3, count_);
  return knots;
}

Eigen::MatrixX3d BaseArcs::control_points() const {
  Eigen::MatrixX3d points(2 * count_ + 1, 3);
  for (int i = 0; i <= 2 * count_; ++i) {
    if (in_quadrants(*this)) {  // the square's corners and middles of sides, exactly
      static constexpr int kX[] = {1, 1, 0, -1, -1, -1, 0, 1}, kY[] = {0, 1, 1, 1, 0, -1, -1, -1};
      points.row(i) << kX[i % 8], kY[i % 8], 1;
    } else {
      const int at = closed_ ? i % (2 * count_) : i;  // the end is the start, to the bit
      const double angle = start_rad_ + arc_rad_ * at / 2, reach = i % 2 ? 1 / weight_ : 1;
      const auto exact = [](double x) { return std::abs(x) < 1e-15 ? 0 : x; };  // of quarters of a turn
      points.row(i) << reach * exact(std::cos(angle)), reach * exact(std::sin(angle)), 1;
    }
    if (i % 2) points.row(i) *= weight_;
  }
  return points;
}

}  // namespace celadon
#endif  // HWY_ONCE
