// Compiled once per SIMD target. Each point's polynomial in s is evaluated with the powers of t in the lanes, then
// those of some points are turned so that points are in the lanes. Products and sums stay apart: every target gives the
// same bits.
#include "fitting/range_batch.h"

// Arrays of vectors need a fixed vector size.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/range_batch.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef CELADON_FITTING_RANGE_BATCH_ONCE
#define CELADON_FITTING_RANGE_BATCH_ONCE
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace celadon {
namespace {

struct Batch {
  const double *v, *z;
  std::size_t n;
  DerivativeArrays out;
};

}  // namespace
}  // namespace celadon
#endif

// Highway's scalar target is never needed: the baseline is SSSE3 or NEON at least.
#if HWY_TARGET != HWY_SCALAR
HWY_BEFORE_NAMESPACE();
namespace celadon {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<double, 4>;
using V = hn::Vec<D>;
constexpr std::size_t kLanes = hn::MaxLanes(D());

HWY_INLINE V times_plus(V a, V b, V c) {
  return hn::Add(hn::Mul(a, b), c);
}

// Horner's rule: value, derivative and half the second one of a polynomial with coefficients c(0) ... c(degree).
template <int kOrder, class Coefficient>
HWY_INLINE void horner(const Coefficient& c, int degree, V at, V* value) {
  V f = c(degree), f1 = hn::Zero(D()), f2 = f1;
  for (int k = degree - 1; k >= 0; --k) {
    if (kOrder > 1) f2 = times_plus(f2, at, f1);
    if (kOrder > 0) f1 = times_plus(f1, at, f);
    f = times_plus(f, at, c(k));
  }
  value[0] = f;
  if constexpr (kOrder > 0) value[1] = f1;
  if constexpr (kOrder > 1) value[2] = f2;
}

// What points of one vector have: F and its derivatives in s and t by order, second ones halved.
template <int kOrder>
struct Local {
  V f[kOrder + 1], f_s[std::max(kOrder, 1)], f_ss[1];
};

// From `along_s(b, d)`: the d-th derivative in s of the power t^b's coefficient.
template <int kOrder, int kWidth, class AlongS>
HWY_INLINE void along_t(const AlongS& along_s, V t, Local<kOrder>& local) {
  horner<kOrder>([&](int b) { return along_s(b, 0); }, kWidth - 1, t, local.f);
  if constexpr (kOrder > 0) horner<kOrder - 1>([&](int b) { return along_s(b, 1); }, kWidth - 1, t, local.f_s);
  if constexpr (kOrder > 1) horner<0>([&](int b) { return along_s(b, 2); }, kWidth - 1, t, local.f_ss);
}

// All points of a vector in one cell: its coefficients are the same for all lanes.
template <int kOrder, int kWidth, int kDegree>
HWY_INLINE void in_one_cell(const double* c, int degree, V s, V t, Local<kOrder>& local) {
  const D d;
  const int p = kDegree ? kDegree : degree;
  V rows[kWidth][kOrder + 1];
  for (int b = 0; b < kWidth; ++b) horner<kOrder>([&](int a) { return hn::Set(d, c[a * kWidth + b]); }, p, s, rows[b]);
  along_t<kOrder, kWidth>([&](int b, int order) { return rows[b][order]; }, t, local);
}

// Each in its own: first the powers of t are in the lanes, point by point, then the points. The same sums.
template <int kOrder, int kWidth, int kDegree>
HWY_INLINE void in_their_cells(const double* const* cells, const double* s, int degree, V t, Local<kOrder>& local) {
  const D d;
  const int p = kDegree ? kDegree : degree;
  constexpr std::size_t kParts = kWidth / 4;
  HWY_ALIGN double turned[kOrder + 1][kParts][4 * kLanes];  // four powers of t, point after point
  for (std::size_t i = 0; i < kLanes; ++i)
    for (std::size_t part = 0; part < kWidth; part += kLanes) {
      V value[kOrder + 1];
      const double* c = cells[i] + part;
      horner<kOrder>([&](int a) { return hn::Load(d, c + a * kWidth); }, p, hn::Set(d, s[i]), value);
      for (int order = 0; order <= kOrder; ++order)
        hn::Store(value[order], d, turned[order][part / 4] + 4 * i + part % 4);
    }
  V rows[kWidth][kOrder + 1];
  for (int order = 0; order <= kOrder; ++order)
    for (std::size_t part = 0; part < kParts; ++part) {
      const std::size_t b = 4 * part;
      hn::LoadInterleaved4(d, turned[order][part], rows[b][order], rows[b + 1][order], rows[b + 2][order],
                           rows[b + 3][order]);
    }
  along_t<kOrder, kWidth>([&](int b, int order) { return rows[b][order]; }, t, local);
}

template <int kOrder, int kWidth, int kDegree>
void evaluate_all(const RangeBatch& all, const Batch& batch) {
  const D d;
  const int p = all.degree_u();
  const V one = hn::Set(d, 1.0), two = hn::Set(d, 2.0);
  const V per_sine = hn::Set(d, 1 / all.sine()), bulge = hn::Set(d, all.bulge());
  const V origin = hn::Set(d, all.origin()), per_unit = hn::Set(d, all.per_unit());
  const V u_start = hn::Set(d, all.u_start()), u_end = hn::Set(d, all.u_end());
  RangeBatch::Cell cell = all.cell_at(0, 0);
  HWY_ALIGN double tail_v[kLanes], tail_z[kLanes], tail_out[kLanes];
  for (std::size_t k = 0; k < batch.n; k += kLanes) {
    const std::size_t count = std::min(kLanes, batch.n - k);
    const double *from_v = batch.v + k, *from_z = batch.z + k;
    if (count < kLanes) {  // the last point fills the lanes
      for (std::size_t i = 0; i < kLanes; ++i) {
        tail_v[i] = from_v[std::min(i, count - 1)];
        tail_z[i] = from_z[std::min(i, count - 1)];
      }
      from_v = tail_v, from_z = tail_z;
    }
    const V v = hn::LoadU(d, from_v);
    V u = hn::Mul(hn::Sub(hn::LoadU(d, from_z), origin), per_unit);
    u = hn::IfThenElse(hn::Lt(u, u_start), u_start, hn::IfThenElse(hn::Gt(u, u_end), u_end, u));  // not-a-number stays
    const auto local_of = [&](V at, V start, V scale) { return hn::Sub(hn::Mul(hn::Sub(at, start), scale), one); };

    Local<kOrder> local;
    V scale_u, scale_v;
    const auto inside = hn::And(hn::And(hn::Ge(u, hn::Set(d, cell.start_u)), hn::Lt(u, hn::Set(d, cell.end_u))),
                                hn::And(hn::Ge(v, hn::Set(d, cell.start_v)), hn::Lt(v, hn::Set(d, cell.end_v))));
    if (hn::AllTrue(d, inside)) {
      scale_u = hn::Set(d, cell.scale_u), scale_v = hn::Set(d, cell.scale_v);
      const V s = local_of(u, hn::Set(d, cell.origin_u), scale_u), t = local_of(v, hn::Set(d, cell.origin_v), scale_v);
      in_one_cell<kOrder, kWidth, kDegree>(cell.coefficients, p, s, t, local);
    } else {
      HWY_ALIGN double lanes[5][kLanes];  // u; origins and scales
      const double* coefficients[kLanes];
      hn::Store(u, d, lanes[0]);
      for (std::size_t i = 0; i < kLanes; ++i) {
        if (!cell.holds(lanes[0][i], from_v[i])) cell = all.cell_at(lanes[0][i], from_v[i]);
        lanes[1][i] = cell.origin_u, lanes[2][i] = cell.scale_u;
        lanes[3][i] = cell.origin_v, lanes[4][i] = cell.scale_v;
        coefficients[i] = cell.coefficients;
      }
      scale_u = hn::Load(d, lanes[2]), scale_v = hn::Load(d, lanes[4]);
      const V s = local_of(u, hn::Load(d, lanes[1]), scale_u), t = local_of(v, hn::Load(d, lanes[3]), scale_v);
      hn::Store(s, d, lanes[0]);
      in_their_cells<kOrder, kWidth, kDegree>(coefficients, lanes[0], p, t, local);
    }

    const auto put = [&](V value, double* to) {
      if (HWY_LIKELY(count == kLanes)) {
        hn::StoreU(value, d, to + k);
      } else {
        hn::Store(value, d, tail_out);
        std::copy(tail_out, tail_out + count, to + k);
      }
    };
    put(local.f[0], batch.out.r_mm);
    if constexpr (kOrder > 0) {
      const V eta = hn::Sub(v, hn::Floor(v)), rest = hn::Sub(one, eta);
      const V v_theta = hn::Mul(hn::Sub(one, hn::Mul(bulge, hn::Mul(eta, rest))), per_sine);
      const V t_theta = hn::Mul(scale_v, v_theta), s_z = hn::Mul(scale_u, per_unit);
      put(hn::Mul(local.f[1], t_theta), batch.out.r_theta);
      put(hn::Mul(local.f_s[0], s_z), batch.out.r_z);
      if constexpr (kOrder > 1) {
        // d v_theta/d theta = v_theta (d/dv)(1 - bulge eta (1 - eta)) / sine.
        const V t_theta_theta = hn::Mul(hn::Mul(t_theta, hn::Mul(bulge, hn::Sub(eta, rest))), per_sine);
        put(hn::Add(hn::Mul(hn::Mul(two, local.f[2]), hn::Mul(t_theta, t_theta)), hn::Mul(local.f[1], t_theta_theta)),
            batch.out.r_theta_theta);
        put(hn::Mul(local.f_s[1], hn::Mul(t_theta, s_z)), batch.out.r_theta_z);
        put(hn::Mul(hn::Mul(two, local.f_ss[0]), hn::Mul(s_z, s_z)), batch.out.r_z_z);
      }
    }
  }
}

template <int kOrder>
void evaluate_order(const RangeBatch& all, const Batch& batch) {
  if (all.width() == 8) {
    evaluate_all<kOrder, 8, 0>(all, batch);
  } else {
    all.degree_u() == 3 ? evaluate_all<kOrder, 4, 3>(all, batch) : evaluate_all<kOrder, 4, 0>(all, batch);
  }
}

void evaluate_batch(const RangeBatch& all, const Batch& batch) {
  if (batch.out.r_z_z) {
    evaluate_order<2>(all, batch);
  } else {
    batch.out.r_theta ? evaluate_order<1>(all, batch) : evaluate_order<0>(all, batch);
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon
HWY_AFTER_NAMESPACE();
#endif  // not scalar

#if HWY_ONCE
#include "fitting/interval_basis.h"
#include "fitting/knots.h"

namespace celadon {
namespace {
HWY_EXPORT(evaluate_batch);
}  // namespace

IntervalTable::IntervalTable(const std::vector<double>& breaks) : breaks_(breaks) {
  const std::size_t intervals = breaks.size() - 1, steps = 4 * intervals;  // even breaks are steps' ends
  const double range = breaks.back() - breaks.front();
  steps_per_unit_ = static_cast<double>(steps) / range;
  last_step_ = static_cast<double>(steps - 1);
  for (std::size_t k = 0; k < intervals; ++k) scale_.push_back(2 / (breaks[k + 1] - breaks[k]));
  std::uint32_t k = 0;
  for (std::size_t step = 0; step < steps; ++step) {  // the interval at the step's start
    const double start = breaks.front() + range * static_cast<double>(step) / static_cast<double>(steps);
    while (start >= breaks[k + 1] && k + 1 < intervals) ++k;
    table_.push_back(k);
  }
}

RangeBatch::RangeBatch(const RangeFunction& f)
    : base_(f.base()),
      along_u_(breaks_of(f.knots_u()).values),
      along_v_(breaks_of(f.knots_v()).values),
      degree_u_(f.degree_u()),
      degree_v_(f.degree_v()),
      origin_(f.base().spherical() ? 0 : f.base().band_start),
      per_unit_(f.base().spherical() ? 1 : 1 / (f.base().band_end - f.base().band_start)),
      u_start_(f.knots_u().front()),
      u_end_(f.knots_u().back()),
      sine_(2 * std::sin(f.base().arcs.arc_rad() / 2)),
      bulge_(4 * std::pow(std::sin(f.base().arcs.arc_rad() / 4), 2)) {
  const IntervalBasis basis_u(f.knots_u(), degree_u_), basis_v(f.knots_v(), degree_v_);
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const auto powers = [](const IntervalBasis& basis, int interval) {
    return Eigen::Map<const RowMajor>(basis.power(interval), basis.degree() + 1, basis.width())
        .leftCols(basis.degree() + 1);
  };
  rows_ = static_cast<std::size_t>(basis_u.intervals());
  stride_ = static_cast<std::size_t>((degree_u_ + 1) * width());
  coefficients_.assign(rows_ * static_cast<std::size_t>(basis_v.intervals()) * stride_, 0.0);
  double* to = coefficients_.data();
  for (int j = 0; j < basis_v.intervals(); ++j)
    for (int i = 0; i < basis_u.intervals(); ++i, to += stride_) {
      const auto c = f.coefficients().block(basis_u.first(i), basis_v.first(j), degree_u_ + 1, degree_v_ + 1);
      Eigen::Map<RowMajor>(to, degree_u_ + 1, width()).leftCols(degree_v_ + 1) =
          powers(basis_u, i) * c * powers(basis_v, j).transpose();
    }
}

void RangeBatch::evaluate(const double* v, const double* along, std::size_t n, const DerivativeArrays& out) const {
  HWY_DYNAMIC_DISPATCH(evaluate_batch)(*this, {v, along, n, out});
}

SurfacePoint RangeBatch::pole(double along) const {
  RangeDerivatives at[3];
  for (int k = 0; k < 3; ++k) {
    const double theta = k * std::numbers::pi / 4, v = base_.arcs.v_of_theta(theta);
    RangeDerivatives& r = at[k];
    evaluate(&v, &along, 1, {&r.r_mm, &r.r_theta, &r.r_z, &r.r_theta_theta, &r.r_theta_z, &r.r_z_z});
  }
  return pole_point(base_, along, at);
}

void RangeBatch::surface_points(const double* theta_rad, const double* along, std::size_t n,
                                SurfacePoint* points) const {
  constexpr std::size_t kBlock = 256;
  std::array<double, kBlock> v, r, r_theta, r_z, r_theta_theta, r_theta_z, r_z_z;
  const DerivativeArrays arrays{r.data(),         r_theta.data(), r_z.data(), r_theta_theta.data(),
                                r_theta_z.data(), r_z_z.data()};
  for (std::size_t first = 0; first < n; first += kBlock) {
    const std::size_t m = std::min(kBlock, n - first);
    base_.arcs.synchronise(theta_rad + first, m, v.data());
    evaluate(v.data(), along + first, m, arrays);
    for (std::size_t k = 0; k < m; ++k) {
      const double at = std::clamp(along[first + k], base_.band_start, base_.band_end);
      if (base_.spherical() && (at == 0 || at == BaseSurface::kMeridianEnd)) {
        points[first + k] = pole(at);
        continue;
      }
      points[first + k] = surface_point(base_, theta_rad[first + k], at,
                                        {r[k], r_theta[k], r_z[k], r_theta_theta[k], r_theta_z[k], r_z_z[k]});
    }
  }
}

}  // namespace celadon
#endif  // HWY_ONCE
