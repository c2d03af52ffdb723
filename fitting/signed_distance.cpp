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

SignedDistance::SignedDistance(const RangeFunction& f)
    : base_(f.base()), in_scanner_frame_(f.base().X_WB.matrix() == Eigen::Matrix4d::Identity()), batch_(f) {
  if (!base_.arcs.closed()) throw std::invalid_argument("SignedDistance: the arcs are open");
}

void SignedDistance::measure(const double* x, const double* y, const double* z, std::size_t n, double* result,
                             bool slopes) const {
  Motion motion{};
  const Eigen::Isometry3d X_BW = base_.X_WB.inverse();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) motion.R[i][j] = X_BW.linear()(i, j);
    motion.t[i] = X_BW.translation()[i];
  }
  Block p[3] = {}, padded[3] = {}, v{}, r{}, f{}, f_theta{}, f_z{};
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
    base_.arcs.synchronise(at_x, at_y, m, v.data(), r.data());
    batch_.evaluate(v.data(), at_z, m, {f.data(), slopes ? f_theta.data() : nullptr, f_z.data()});
    const Slopes of_f{slopes ? f_theta.data() : nullptr, f_z.data()};
    if (m < kBlock) {  // whole vectors: what lies beyond the points is not copied out
      std::copy(at_z, at_z + m, padded[2].begin());
      Block tail;
      HWY_DYNAMIC_DISPATCH(distances)
      (r.data(), f.data(), of_f, padded[2].data(), base_.band_start, base_.band_end, kBlock, tail.data());
      std::copy(tail.begin(), tail.begin() + static_cast<std::ptrdiff_t>(m), result + first);
    } else {
      HWY_DYNAMIC_DISPATCH(distances)
      (r.data(), f.data(), of_f, at_z, base_.band_start, base_.band_end, kBlock, result + first);
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
