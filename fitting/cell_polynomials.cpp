// Compiled once per SIMD target. Lanes are points; those of one vector that lie in different cells are taken cell by
// cell.
#include "fitting/cell_polynomials.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/cell_polynomials.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef CELADON_FITTING_CELL_POLYNOMIALS_ONCE
#define CELADON_FITTING_CELL_POLYNOMIALS_ONCE
#include <algorithm>
#include <cmath>
#include <limits>

namespace celadon {
namespace {

struct PointArrays {
  const double *v, *z;
  double *r, *r_theta, *r_z;  // slopes may be null
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
using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;

// Value, dF/ds and dF/dt by Horner's rule, along s for each power of t, then along t. kDegree 0: degrees known at run
// time only.
template <int kDegree, bool kSlopes>
HWY_INLINE void horner(const double* c, int degree_u, int degree_v, V s, V t, V& f, V& f_s, V& f_t) {
  const D d;
  const int p = kDegree ? kDegree : degree_u, q = kDegree ? kDegree : degree_v;
  f = f_s = f_t = hn::Zero(d);
  for (int b = q; b >= 0; --b) {
    const double* row = c + b * (p + 1);
    V g = hn::Set(d, row[p]), g_s = hn::Zero(d);
    for (int a = p - 1; a >= 0; --a) {
      if (kSlopes) g_s = hn::MulAdd(g_s, s, g);
      g = hn::MulAdd(g, s, hn::Set(d, row[a]));
    }
    if (kSlopes) {
      f_t = hn::MulAdd(f_t, t, f);
      f_s = hn::MulAdd(f_s, t, g_s);
    }
    f = hn::MulAdd(f, t, g);
  }
}

template <int kDegree, bool kSlopes>
void evaluate_all(const CellPolynomials& all, const PointArrays& points, std::size_t n) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const int p = all.degree_u(), q = all.degree_v();
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0);
  const V z_start = hn::Set(d, all.z_start_mm()), per_height = hn::Set(d, all.per_height());
  const V u_start = hn::Set(d, all.u_start()), u_end = hn::Set(d, all.u_end());
  const V per_sine = hn::Set(d, 1 / all.sine()), bulge = hn::Set(d, all.bulge());
  int near_u = 0, near_v = 0;
  CellPolynomials::Cell cell = all.cell_at(0, 0, near_u, near_v);
  HWY_ALIGN double tail[5][hn::MaxLanes(D())] = {};
  HWY_ALIGN double lane_u[hn::MaxLanes(D())];
  for (std::size_t k = 0; k < n; k += lanes) {
    const bool whole = k + lanes <= n;
    const double *from_v = points.v + k, *from_z = points.z + k;
    if (!whole) {  // the last point fills the vector
      for (std::size_t i = 0; i < lanes; ++i) {
        tail[0][i] = points.v[std::min(k + i, n - 1)];
        tail[1][i] = points.z[std::min(k + i, n - 1)];
      }
      from_v = tail[0], from_z = tail[1];
    }
    const V v = hn::LoadU(d, from_v);
    const V u = hn::Min(hn::Max(hn::Mul(hn::Sub(hn::LoadU(d, from_z), z_start), per_height), u_start), u_end);
    V f = zero, f_s = zero, f_t = zero, scale_u = zero, scale_v = zero;
    const auto inside = [&] {
      return hn::And(hn::And(hn::Ge(u, hn::Set(d, cell.start_u)), hn::Lt(u, hn::Set(d, cell.end_u))),
                     hn::And(hn::Ge(v, hn::Set(d, cell.start_v)), hn::Lt(v, hn::Set(d, cell.end_v))));
    };
    const auto in_cell = [&](V& value, V& value_s, V& value_t) {
      const V s = hn::Sub(hn::Mul(hn::Sub(u, hn::Set(d, cell.origin_u)), hn::Set(d, cell.scale_u)), one);
      const V t = hn::Sub(hn::Mul(hn::Sub(v, hn::Set(d, cell.origin_v)), hn::Set(d, cell.scale_v)), one);
      horner<kDegree, kSlopes>(cell.coefficients, p, q, s, t, value, value_s, value_t);
    };
    if (HWY_LIKELY(hn::AllTrue(d, inside()))) {
      in_cell(f, f_s, f_t);
      scale_u = hn::Set(d, cell.scale_u), scale_v = hn::Set(d, cell.scale_v);
    } else {
      hn::Store(u, d, lane_u);
      auto left = hn::Eq(zero, zero);
      while (!hn::AllFalse(d, left)) {
        const auto first = static_cast<std::size_t>(hn::FindFirstTrue(d, left));
        cell = all.cell_at(lane_u[first], from_v[first], near_u, near_v);
        // The first lane belongs to its cell even if it is not a number.
        const auto here = hn::And(left, hn::Or(inside(), hn::FirstN(d, first + 1)));
        V value, value_s, value_t;
        in_cell(value, value_s, value_t);
        f = hn::IfThenElse(here, value, f);
        if (kSlopes) {
          f_s = hn::IfThenElse(here, value_s, f_s);
          f_t = hn::IfThenElse(here, value_t, f_t);
          scale_u = hn::IfThenElse(here, hn::Set(d, cell.scale_u), scale_u);
          scale_v = hn::IfThenElse(here, hn::Set(d, cell.scale_v), scale_v);
        }
        left = hn::AndNot(here, left);
      }
    }
    hn::StoreU(f, d, whole ? points.r + k : tail[2]);
    if (kSlopes) {
      const V eta = hn::Sub(v, hn::Floor(v));
      const V v_theta = hn::Mul(hn::Sub(one, hn::Mul(bulge, hn::Mul(eta, hn::Sub(one, eta)))), per_sine);
      hn::StoreU(hn::Mul(hn::Mul(f_t, scale_v), v_theta), d, whole ? points.r_theta + k : tail[3]);
      hn::StoreU(hn::Mul(hn::Mul(f_s, scale_u), per_height), d, whole ? points.r_z + k : tail[4]);
    }
    if (!whole) {
      std::copy(tail[2], tail[2] + (n - k), points.r + k);
      if (kSlopes) {
        std::copy(tail[3], tail[3] + (n - k), points.r_theta + k);
        std::copy(tail[4], tail[4] + (n - k), points.r_z + k);
      }
    }
  }
}

void evaluate_cells(const CellPolynomials& all, const PointArrays& points, std::size_t n) {
  const bool cubic = all.degree_u() == 3 && all.degree_v() == 3;
  if (points.r_theta) {
    cubic ? evaluate_all<3, true>(all, points, n) : evaluate_all<0, true>(all, points, n);
  } else {
    cubic ? evaluate_all<3, false>(all, points, n) : evaluate_all<0, false>(all, points, n);
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon
HWY_AFTER_NAMESPACE();
#endif  // not scalar

#if HWY_ONCE
namespace celadon {
namespace {
HWY_EXPORT(evaluate_cells);
}  // namespace

CellPolynomials::CellPolynomials(const RangeFunction& f)
    : basis_u_(f.knots_u(), f.degree_u()),
      basis_v_(f.knots_v(), f.degree_v()),
      z_start_(f.base().spherical() ? 0 : f.base().band_start),
      per_height_(f.base().spherical() ? 1 : 1 / (f.base().band_end - f.base().band_start)),
      u_start_(f.knots_u().front()),
      u_end_(f.knots_u().back()),
      sine_(2 * std::sin(f.base().arcs.arc_rad() / 2)),
      bulge_(4 * std::pow(std::sin(f.base().arcs.arc_rad() / 4), 2)) {
  const int p = f.degree_u(), q = f.degree_v(), width_u = basis_u_.width(), width_v = basis_v_.width();
  coefficients_.reserve(static_cast<std::size_t>(basis_u_.intervals() * basis_v_.intervals() * (p + 1) * (q + 1)));
  Eigen::MatrixXd along_u(p + 1, q + 1);
  for (int j = 0; j < basis_v_.intervals(); ++j)
    for (int i = 0; i < basis_u_.intervals(); ++i) {
      const double *of_u = basis_u_.power(i), *of_v = basis_v_.power(j);
      const auto c = f.coefficients().block(basis_u_.first(i), basis_v_.first(j), p + 1, q + 1);
      for (int a = 0; a <= p; ++a)
        for (int l = 0; l <= q; ++l) {
          double sum = 0;
          for (int k = 0; k <= p; ++k) sum += of_u[a * width_u + k] * c(k, l);
          along_u(a, l) = sum;
        }
      for (int b = 0; b <= q; ++b)
        for (int a = 0; a <= p; ++a) {
          double sum = 0;
          for (int l = 0; l <= q; ++l) sum += of_v[b * width_v + l] * along_u(a, l);
          coefficients_.push_back(sum);
        }
    }
}

CellPolynomials::Cell CellPolynomials::cell_at(double u, double v, int& near_u, int& near_v) const {
  constexpr double kNone = std::numeric_limits<double>::infinity();
  near_u = basis_u_.locate(u, near_u);
  near_v = basis_v_.locate(v, near_v);
  const auto start = [](const IntervalBasis& basis, int k) { return k == 0 ? -kNone : basis.start(k); };
  const auto end = [](const IntervalBasis& basis, int k) {
    return k + 1 == basis.intervals() ? kNone : basis.start(k + 1);
  };
  const int entries = (degree_u() + 1) * (degree_v() + 1);
  return {start(basis_u_, near_u),
          end(basis_u_, near_u),
          start(basis_v_, near_v),
          end(basis_v_, near_v),
          basis_u_.start(near_u),
          basis_u_.scale(near_u),
          basis_v_.start(near_v),
          basis_v_.scale(near_v),
          coefficients_.data() + static_cast<std::ptrdiff_t>(near_v * basis_u_.intervals() + near_u) * entries};
}

void CellPolynomials::evaluate(const double* v, const double* z_mm, std::size_t n, double* r_mm) const {
  HWY_DYNAMIC_DISPATCH(evaluate_cells)(*this, {v, z_mm, r_mm, nullptr, nullptr}, n);
}

void CellPolynomials::evaluate(const double* v, const double* z_mm, std::size_t n, double* r_mm, double* r_theta,
                               double* r_z) const {
  HWY_DYNAMIC_DISPATCH(evaluate_cells)(*this, {v, z_mm, r_mm, r_theta, r_z}, n);
}

}  // namespace celadon
#endif  // HWY_ONCE
