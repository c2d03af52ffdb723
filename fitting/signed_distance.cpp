// Compiled once per SIMD target; products and sums stay apart: every target gives the same bits.
#include "fitting/signed_distance.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/signed_distance.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef CELADON_FITTING_SIGNED_DISTANCE_ONCE
#define CELADON_FITTING_SIGNED_DISTANCE_ONCE
#include <array>

namespace celadon {
namespace {

// A few vectors more than the points of one block, so that kernels need no tails.
constexpr std::size_t kBlock = 256;
using Block = std::array<double, kBlock>;

struct Motion {  // into the base frame: p_B = R p_W + t
  double R[3][3], t[3];
};
struct Slopes {
  const double *theta, *z;  // null: along the ray
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

// Arrays are whole blocks.
void move_block(const Motion& m, const Block& x, const Block& y, const Block& z, Block* to) {
  const D d;
  for (std::size_t k = 0; k < kBlock; k += hn::Lanes(d)) {
    const V a = hn::LoadU(d, x.data() + k), b = hn::LoadU(d, y.data() + k), c = hn::LoadU(d, z.data() + k);
    for (int i = 0; i < 3; ++i) {
      const V xy = hn::Add(hn::Mul(hn::Set(d, m.R[i][0]), a), hn::Mul(hn::Set(d, m.R[i][1]), b));
      const V turned = hn::Add(xy, hn::Mul(hn::Set(d, m.R[i][2]), c));
      hn::StoreU(hn::Add(turned, hn::Set(d, m.t[i])), d, to[i].data() + k);
    }
  }
}

// e_p = r - F, or e_p F / sqrt(F^2 (1 + F_z^2) + F_theta^2), where z is within the band.
void distances(const double* r, const double* f, const Slopes& slopes, const double* z, double lo, double hi,
               std::size_t n, double* result) {
  const D d;
  const V one = hn::Set(d, 1.0), none = hn::NaN(d);
  for (std::size_t k = 0; k < n; k += hn::Lanes(d)) {
    const V F = hn::LoadU(d, f + k), height = hn::LoadU(d, z + k);
    V e = hn::Sub(hn::LoadU(d, r + k), F);
    if (slopes.theta) {
      const V F_theta = hn::LoadU(d, slopes.theta + k), F_z = hn::LoadU(d, slopes.z + k);
      const V along = hn::Mul(hn::Mul(F, F), hn::Add(one, hn::Mul(F_z, F_z)));
      e = hn::Div(hn::Mul(e, F), hn::Sqrt(hn::Add(along, hn::Mul(F_theta, F_theta))));
    }
    const auto within = hn::And(hn::Ge(height, hn::Set(d, lo)), hn::Le(height, hn::Set(d, hi)));
    hn::StoreU(hn::IfThenElse(within, e, none), d, result + k);
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon
HWY_AFTER_NAMESPACE();
#endif  // not scalar

#if HWY_ONCE
#include <algorithm>
#include <stdexcept>

namespace celadon {
namespace {
HWY_EXPORT(move_block);
HWY_EXPORT(distances);
}  // namespace

// Of the points of a block: the coordinates on the base, F there, and its slopes as those over a cylinder's theta and
// z.
struct SignedDistance::Places {
  Block v{}, r{}, along{}, f{}, f_theta{}, f_z{};
};

SignedDistance::SignedDistance(const RangeFunction& f)
    : base_(f.base()), in_scanner_frame_(f.base().X_WB.matrix() == Eigen::Matrix4d::Identity()), batch_(f) {
  if (!base_.arcs.closed()) throw std::invalid_argument("SignedDistance: the arcs are open");
  if (base_.heights) heights_.emplace(*base_.heights);
}

// psi on a sphere: tan^2 = (F_w w_phi/F)^2 + (F_theta/(F sin phi))^2. At a pole the slopes are those beside it.
void SignedDistance::along_meridian(Places& at, std::size_t n, bool slopes) const {
  constexpr double kBeside = 1e-7;
  const BaseArcs& meridian = BaseSurface::meridian();
  Block off_axis = at.r, beside;
  meridian.synchronise(at.along.data(), off_axis.data(), n, at.along.data(), at.r.data());
  batch_.evaluate(at.v.data(), at.along.data(), n, {at.f.data()});
  if (!slopes) return;
  for (std::size_t k = 0; k < n; ++k) beside[k] = std::clamp(at.along[k], kBeside, BaseSurface::kMeridianEnd - kBeside);
  Block unused;
  batch_.evaluate(at.v.data(), beside.data(), n, {unused.data(), at.f_theta.data(), at.f_z.data()});
  double phi_w = 1, phi_ww = 0;
  meridian.theta_derivatives(kBeside, phi_w, phi_ww);
  const double least_sine = kBeside * phi_w;
  for (std::size_t k = 0; k < n; ++k) {
    meridian.theta_derivatives(beside[k], phi_w, phi_ww);
    at.f_theta[k] /= std::max(off_axis[k] / at.r[k], least_sine);
    at.f_z[k] /= phi_w * at.f[k];
  }
}

// t along by linear heights H between the rims: F_z = F_t/H_t, F_theta at one height = F_theta - F_z H_theta.
void SignedDistance::between_rims(const double* z, Places& at, std::size_t n, bool slopes) const {
  const double a = base_.heights->base().band_start, b = base_.heights->base().band_end;
  Block place, lower, lower_theta, upper, upper_theta, unused;
  place.fill(a);
  heights_->evaluate(at.v.data(), place.data(), n,
                     {lower.data(), slopes ? lower_theta.data() : nullptr, unused.data()});
  place.fill(b);
  heights_->evaluate(at.v.data(), place.data(), n,
                     {upper.data(), slopes ? upper_theta.data() : nullptr, unused.data()});
  for (std::size_t k = 0; k < n; ++k) at.along[k] = a + (z[k] - lower[k]) / (upper[k] - lower[k]) * (b - a);
  batch_.evaluate(at.v.data(), at.along.data(), n, {at.f.data(), slopes ? at.f_theta.data() : nullptr, at.f_z.data()});
  if (!slopes) return;
  for (std::size_t k = 0; k < n; ++k) {
    const double share = (at.along[k] - a) / (b - a);
    at.f_z[k] *= (b - a) / (upper[k] - lower[k]);
    at.f_theta[k] -= at.f_z[k] * ((1 - share) * lower_theta[k] + share * upper_theta[k]);
  }
}

void SignedDistance::measure(const double* x, const double* y, const double* z, std::size_t n, double* result,
                             bool slopes) const {
  Motion motion{};
  const Eigen::Isometry3d X_BW = base_.X_WB.inverse();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) motion.R[i][j] = X_BW.linear()(i, j);
    motion.t[i] = X_BW.translation()[i];
  }
  Block p[3] = {}, padded[3] = {};
  Places at;
  const Slopes of_f{slopes ? at.f_theta.data() : nullptr, at.f_z.data()};
  for (std::size_t first = 0; first < n; first += kBlock) {
    const std::size_t m = std::min(kBlock, n - first);
    const double *at_x = x + first, *at_y = y + first, *at_z = z + first;
    if (!in_scanner_frame_) {
      std::copy(at_x, at_x + m, padded[0].begin());
      std::copy(at_y, at_y + m, padded[1].begin());
      std::copy(at_z, at_z + m, padded[2].begin());
      HWY_DYNAMIC_DISPATCH(move_block)(motion, padded[0], padded[1], padded[2], p);
      at_x = p[0].data(), at_y = p[1].data(), at_z = p[2].data();
    }
    base_.arcs.synchronise(at_x, at_y, m, at.v.data(), at.r.data());
    const double* along = at.along.data();
    if (base_.spherical()) {
      std::copy(at_z, at_z + m, at.along.begin());
      along_meridian(at, m, slopes);
    } else if (heights_) {
      between_rims(at_z, at, m, slopes);
    } else {
      along = at_z;
      batch_.evaluate(at.v.data(), at_z, m, {at.f.data(), slopes ? at.f_theta.data() : nullptr, at.f_z.data()});
    }
    if (m < kBlock) {  // whole vectors: what lies beyond the points is not copied out
      std::copy(along, along + m, padded[2].begin());
      Block tail;
      HWY_DYNAMIC_DISPATCH(distances)
      (at.r.data(), at.f.data(), of_f, padded[2].data(), base_.band_start, base_.band_end, kBlock, tail.data());
      std::copy(tail.begin(), tail.begin() + static_cast<std::ptrdiff_t>(m), result + first);
    } else {
      HWY_DYNAMIC_DISPATCH(distances)
      (at.r.data(), at.f.data(), of_f, along, base_.band_start, base_.band_end, kBlock, result + first);
    }
  }
}

void SignedDistance::along_ray(const double* x, const double* y, const double* z, std::size_t n, double* ray) const {
  measure(x, y, z, n, ray, false);
}

void SignedDistance::to_surface(const double* x, const double* y, const double* z, std::size_t n,
                                double* distance) const {
  measure(x, y, z, n, distance, true);
}

}  // namespace celadon
#endif  // HWY_ONCE
