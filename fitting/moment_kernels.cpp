// Compiled once per SIMD target.
#include "fitting/moment_kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitting/moment_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
// After highway.h: it takes its attributes from there.
#include <hwy/cache_control.h>

#include <algorithm>
#include <limits>

// Highway's scalar target lacks operations used here and is never needed: the baseline is SSSE3 or NEON at least.
#if HWY_TARGET != HWY_SCALAR
HWY_BEFORE_NAMESPACE();
namespace celadon::moment_kernels {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using DW = hn::CappedTag<double, 8>;  // a row of weight moments is a whole number of these
using DR = hn::CappedTag<double, 4>;  // a row of range moments likewise
using D = hn::ScalableTag<double>;

HWY_ALIGN constexpr double kOdd[8] = {0, 1, 0, 1, 0, 1, 0, 1};
HWY_ALIGN constexpr double kSecond[8] = {0, 0, 1, 1, 0, 0, 1, 1};
HWY_ALIGN constexpr double kUpper[8] = {0, 0, 0, 0, 1, 1, 1, 1};

// (1, t, t^2, ...) over the lanes of a vector.
template <class Tag>
HWY_INLINE hn::Vec<Tag> powers(Tag d, double t) {
  const auto one = hn::Set(d, 1.0), zero = hn::Zero(d);
  const double t2 = t * t;
  auto result = hn::IfThenElse(hn::Gt(hn::Load(d, kOdd), zero), hn::Set(d, t), one);
  if (hn::Lanes(d) >= 4)
    result = hn::Mul(result, hn::IfThenElse(hn::Gt(hn::Load(d, kSecond), zero), hn::Set(d, t2), one));
  if (hn::Lanes(d) >= 8)
    result = hn::Mul(result, hn::IfThenElse(hn::Gt(hn::Load(d, kUpper), zero), hn::Set(d, t2 * t2), one));
  return result;
}

// t to the power of the number of lanes: from one vector of powers to the next.
HWY_INLINE double step_power(double t, std::size_t lanes) {
  double x = t;
  for (std::size_t k = 1; k < lanes; k *= 2) x *= x;
  return x;
}

// One sample as it enters its cell: vectors of powers of t, scaled by its weight.
template <int kMaxWeightVectors, int kMaxRangeVectors>
struct Sample {
  hn::Vec<DW> weight[kMaxWeightVectors];
  hn::Vec<DR> range[kMaxRangeVectors];
  double s;
};

constexpr int kWeightVectors3 = 8 / HWY_MIN(8, HWY_LANES(double)), kRangeVectors3 = 4 / HWY_MIN(4, HWY_LANES(double));

// kQ is the degree in v if known at compile time, else 0.
template <int kQ, int kWeightVectors, int kRangeVectors>
HWY_INLINE Sample<kWeightVectors, kRangeVectors> prepare(const MomentLayout& layout, double t, double s, double r,
                                                         double w) {
  const DW dw;
  const DR dr;
  Sample<kWeightVectors, kRangeVectors> sample;
  sample.s = s;
  const int q = kQ ? kQ : layout.degree_v;
  const int lanes = static_cast<int>(hn::Lanes(dw));
  const int vectors = kQ ? kWeightVectors : layout.weight_lanes / lanes;
  auto u = hn::Mul(powers(dw, t), hn::Set(dw, w));
  const auto step = hn::Set(dw, step_power(t, hn::Lanes(dw)));
  for (int k = 0; k < vectors; ++k) {
    sample.weight[k] = u;
    u = hn::Mul(u, step);
  }
  const int square = 2 * q + 1;
  const auto is_square = hn::Eq(hn::Iota(dw, 0.0), hn::Set(dw, static_cast<double>(square % lanes)));
  sample.weight[square / lanes] = hn::IfThenElse(is_square, hn::Set(dw, w * r * r), sample.weight[square / lanes]);

  const int range_vectors = kQ ? kRangeVectors : layout.range_lanes / static_cast<int>(hn::Lanes(dr));
  auto h = hn::Mul(powers(dr, t), hn::Set(dr, w * r));
  const auto range_step = hn::Set(dr, step_power(t, hn::Lanes(dr)));
  for (int k = 0; k < range_vectors; ++k) {
    sample.range[k] = h;
    h = hn::Mul(h, range_step);
  }
  return sample;
}

// cell += the samples' moments; several samples of one cell share its loads and stores.
template <int kP, int kQ, int kCount, class S>
HWY_INLINE void scatter(const MomentLayout& layout, double* HWY_RESTRICT cell, const S* samples) {
  const DW dw;
  const DR dr;
  const int p = kP ? kP : layout.degree_u;
  const int weight_lanes = kQ ? (kQ <= 3 ? 8 : 16) : layout.weight_lanes;
  const int range_lanes = kQ ? (kQ <= 3 ? 4 : 8) : layout.range_lanes;
  const int nw = weight_lanes / static_cast<int>(hn::Lanes(dw)), nr = range_lanes / static_cast<int>(hn::Lanes(dr));
  double power[kCount];
  for (int c = 0; c < kCount; ++c) power[c] = 1;
  for (int b = 0; b <= 2 * p; ++b) {
    double* row = cell + b * weight_lanes;
    for (int k = 0; k < nw; ++k) {
      auto sum = hn::Load(dw, row + k * static_cast<int>(hn::Lanes(dw)));
      for (int c = 0; c < kCount; ++c) sum = hn::MulAdd(samples[c].weight[k], hn::Set(dw, power[c]), sum);
      hn::Store(sum, dw, row + k * static_cast<int>(hn::Lanes(dw)));
    }
    if (b <= p) {
      double* range_row = cell + (2 * p + 1) * weight_lanes + b * range_lanes;
      for (int k = 0; k < nr; ++k) {
        auto sum = hn::Load(dr, range_row + k * static_cast<int>(hn::Lanes(dr)));
        for (int c = 0; c < kCount; ++c) sum = hn::MulAdd(samples[c].range[k], hn::Set(dr, power[c]), sum);
        hn::Store(sum, dr, range_row + k * static_cast<int>(hn::Lanes(dr)));
      }
    }
    for (int c = 0; c < kCount; ++c) power[c] *= samples[c].s;
  }
}

struct Located {
  HWY_ALIGN double cell[kBlock], s[kBlock], t[kBlock];  // cell -1: not to be added
};

// Cell and local coordinates of each sample.
HWY_INLINE std::size_t locate(const Grid& g, const double* r, const double* z, const double* v, const double* w,
                              std::size_t n, Located& out) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const auto zero = hn::Zero(d), one = hn::Set(d, 1.0), two = hn::Set(d, 2.0);
  const auto largest = hn::Set(d, std::numeric_limits<double>::max());
  const auto nz = hn::Set(d, static_cast<double>(g.z_cells)), nv = hn::Set(d, static_cast<double>(g.v_cells));
  std::size_t good = 0;
  HWY_ALIGN double tail[4][hn::MaxLanes(D())] = {};
  for (std::size_t k = 0; k < n; k += lanes) {
    const double *rk = r + k, *zk = z + k, *vk = v + k, *wk = w ? w + k : nullptr;
    if (k + lanes > n) {  // zeros behind the end: r = 0 is never good
      std::copy(rk, r + n, tail[0]);
      std::copy(zk, z + n, tail[1]);
      std::copy(vk, v + n, tail[2]);
      if (w) std::copy(wk, w + n, tail[3]);
      rk = tail[0], zk = tail[1], vk = tail[2], wk = w ? tail[3] : nullptr;
    }
    const auto range = hn::LoadU(d, rk);
    const auto x = hn::Mul(hn::Sub(hn::LoadU(d, zk), hn::Set(d, g.z_start)), hn::Set(d, g.z_scale));
    const auto y = hn::Mul(hn::LoadU(d, vk), hn::Set(d, g.v_scale));
    auto ok = hn::And(hn::And(hn::Ge(x, zero), hn::Le(x, nz)), hn::And(hn::Ge(y, zero), hn::Le(y, nv)));
    ok = hn::And(ok, hn::And(hn::Gt(range, zero), hn::Le(range, largest)));
    if (wk) {
      const auto weight = hn::LoadU(d, wk);
      ok = hn::And(ok, hn::And(hn::Gt(weight, zero), hn::Le(weight, largest)));
    }
    const auto i = hn::Min(hn::Floor(hn::IfThenElseZero(ok, x)), hn::Sub(nz, one));
    const auto j = hn::Min(hn::Floor(hn::IfThenElseZero(ok, y)), hn::Sub(nv, one));
    const auto cell = hn::MulAdd(j, nz, i);
    hn::Store(hn::IfThenElse(ok, cell, hn::Set(d, -1.0)), d, out.cell + k);
    hn::Store(hn::Sub(hn::Mul(two, hn::Sub(x, i)), one), d, out.s + k);
    hn::Store(hn::Sub(hn::Mul(two, hn::Sub(y, j)), one), d, out.t + k);
    good += hn::CountTrue(d, ok);
  }
  return good;
}

template <int kP, int kQ>
HWY_INLINE void scatter_block(const Grid& g, const Located& at, const double* r, const double* w, std::size_t n) {
  constexpr int kScale = kQ && kQ <= 3 ? 1 : 2;
  using S = Sample<kWeightVectors3 * kScale, kRangeVectors3 * kScale>;
  const std::size_t stride = static_cast<std::size_t>(g.layout.stride());
  const auto cell_of = [&](std::size_t k) { return g.cells + static_cast<std::size_t>(at.cell[k]) * stride; };
  const auto sample = [&](std::size_t k) {
    return prepare<kQ, kWeightVectors3 * kScale, kRangeVectors3 * kScale>(g.layout, at.t[k], at.s[k], r[k],
                                                                          w ? w[k] : 1.0);
  };
  for (std::size_t k = 0; k < n;) {
    constexpr std::size_t kAhead = 6;
    if (k + kAhead < n && at.cell[k + kAhead] >= 0 && at.cell[k + kAhead] != at.cell[k + kAhead - 1]) {
      const char* next = reinterpret_cast<const char*>(cell_of(k + kAhead));
      for (std::size_t line = 0; line < stride * sizeof(double); line += 64) hwy::Prefetch(next + line);
    }
    if (at.cell[k] < 0) {
      ++k;
    } else if (k + 1 < n && at.cell[k + 1] == at.cell[k]) {
      const S pair[2] = {sample(k), sample(k + 1)};
      scatter<kP, kQ, 2>(g.layout, cell_of(k), pair);
      k += 2;
    } else {
      const S single[1] = {sample(k)};
      scatter<kP, kQ, 1>(g.layout, cell_of(k), single);
      ++k;
    }
  }
}

std::size_t add_block(const Grid& g, const double* r, const double* z, const double* v, const double* w,
                      std::size_t n) {
  Located at;
  const std::size_t good = locate(g, r, z, v, w, n, at);
  if (good == 0) return 0;
  if (g.layout.degree_u == 3 && g.layout.degree_v == 3) {
    scatter_block<3, 3>(g, at, r, w, n);
  } else {
    scatter_block<0, 0>(g, at, r, w, n);
  }
  return good;
}

// Sums over the lanes of n vectors.
HWY_INLINE void sums_of_lanes(const hn::Vec<D>* v, int n, double* HWY_RESTRICT out) {
  const D d;
  int k = 0;
#if HWY_MAX_BYTES == 32 || HWY_MAX_BYTES == 64
  // Four vectors of four at a time, by transposing them; of eight, after their halves are added.
  const hn::CappedTag<double, 4> d4;
  const auto four = [&](int i) {
#if HWY_MAX_BYTES == 64
    return hn::Add(hn::LowerHalf(d4, v[i]), hn::UpperHalf(d4, v[i]));
#else
    return v[i];
#endif
  };
  for (; k + 4 <= n; k += 4) {
    const auto a = four(k), b = four(k + 1), c = four(k + 2), e = four(k + 3);
    const auto ab = hn::Add(hn::InterleaveLower(d4, a, b), hn::InterleaveUpper(d4, a, b));
    const auto ce = hn::Add(hn::InterleaveLower(d4, c, e), hn::InterleaveUpper(d4, c, e));
    hn::StoreU(hn::Add(hn::ConcatLowerLower(d4, ce, ab), hn::ConcatUpperUpper(d4, ce, ab)), d4, out + k);
  }
#endif
  for (; k < n; ++k) out[k] = hn::GetLane(hn::SumOfLanes(d, v[k]));
}

// One-dimensional sums of a run of samples in one z cell: s^1..s^2p, then r s^0..r s^p, then r^2.
template <int kP>
struct LineSums {
  static constexpr int kSums = 3 * kP + 2;
  hn::Vec<D> sums[kSums];
  double count;
  HWY_INLINE void clear() {
    for (auto& sum : sums) sum = hn::Zero(D());
    count = 0;
  }
  // s and r are zero in lanes that do not count.
  HWY_INLINE void add(std::size_t samples, hn::Vec<D> s, hn::Vec<D> r) {
    count += static_cast<double>(samples);
    sums[0] = hn::Add(sums[0], s);
    sums[2 * kP] = hn::Add(sums[2 * kP], r);
    sums[2 * kP + 1] = hn::MulAdd(r, s, sums[2 * kP + 1]);
    auto power = s;
    for (int b = 2; b <= kP; ++b) {
      power = hn::Mul(power, s);
      sums[b - 1] = hn::Add(sums[b - 1], power);
      sums[2 * kP + b] = hn::MulAdd(r, power, sums[2 * kP + b]);
    }
    const auto highest = power;  // s^p: the higher powers are its products with the lower ones
    auto low = s;
    for (int b = kP + 1; b <= 2 * kP; ++b) {
      sums[b - 1] = hn::MulAdd(highest, low, sums[b - 1]);
      if (b < 2 * kP) low = hn::Mul(low, s);
    }
    sums[3 * kP + 1] = hn::MulAdd(r, r, sums[3 * kP + 1]);
  }
  HWY_INLINE void flush(const MomentLayout& layout, const double* t_powers, double* HWY_RESTRICT cell) {
    const DW dw;
    const DR dr;
    double line[kSums + 1];
    line[0] = count;
    sums_of_lanes(sums, kSums, line + 1);
    for (int b = 0; b <= 2 * kP; ++b) {
      const auto sum = hn::Set(dw, line[b]);
      double* row = cell + layout.weight(b, 0);
      for (int a = 0; a < layout.weight_lanes; a += static_cast<int>(hn::Lanes(dw)))
        hn::Store(hn::MulAdd(hn::Load(dw, t_powers + a), sum, hn::Load(dw, row + a)), dw, row + a);
    }
    for (int b = 0; b <= kP; ++b) {
      const auto sum = hn::Set(dr, line[2 * kP + 1 + b]);
      double* row = cell + layout.range(b, 0);
      for (int a = 0; a < layout.range_lanes; a += static_cast<int>(hn::Lanes(dr)))
        hn::Store(hn::MulAdd(hn::Load(dr, t_powers + a), sum, hn::Load(dr, row + a)), dr, row + a);
    }
    cell[layout.square()] += line[kSums];
    clear();
  }
};

bool all_positive(const double* values, std::size_t n) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const auto zero = hn::Zero(d), largest = hn::Set(d, std::numeric_limits<double>::max());
  auto good = hn::Eq(zero, zero);
  std::size_t k = 0;
  for (; k + lanes <= n; k += lanes) {
    const auto value = hn::LoadU(d, values + k);
    good = hn::And(good, hn::And(hn::Gt(value, zero), hn::Le(value, largest)));
  }
  bool all = hn::AllTrue(d, good);
  for (; k < n; ++k) all = all && values[k] > 0 && values[k] <= std::numeric_limits<double>::max();
  return all;
}

// Whole vectors inside the current cell, whatever the order of the samples; one that touches the cell's edge ends the
// run. The sums stay in registers. @pre all of r is positive
template <int kP>
HWY_INLINE std::size_t add_run(LineSums<kP>& sums, const Grid& g, double current, const double* r, const double* z,
                               std::size_t n) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const auto one = hn::Set(d, 1.0), two = hn::Set(d, 2.0), origin = hn::Set(d, 2 * current + 1);
  const auto z_start = hn::Set(d, g.z_start), z_scale = hn::Set(d, g.z_scale);
  LineSums<kP> in_registers = sums;
  std::size_t k = 0;
  for (; k + lanes <= n; k += lanes) {
    const auto x = hn::Mul(hn::Sub(hn::LoadU(d, z + k), z_start), z_scale);
    const auto s = hn::MulSub(two, x, origin);
    if (HWY_UNLIKELY(!hn::AllTrue(d, hn::Lt(hn::Abs(s), one)))) break;
    in_registers.add(0, s, hn::LoadU(d, r + k));
  }
  in_registers.count += static_cast<double>(k);
  sums = in_registers;
  return k;
}

template <int kP, bool kPositive>
std::size_t add_line(const Grid& g, double v, const double* r, const double* z, std::size_t n) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const double y = v * g.v_scale;
  if (!(y >= 0 && y <= g.v_cells)) return 0;
  const int j = std::min(static_cast<int>(y), g.v_cells - 1);
  const double t = 2 * (y - j) - 1;
  HWY_ALIGN double t_powers[16] = {1};
  for (int a = 1; a <= 2 * g.layout.degree_v; ++a) t_powers[a] = t_powers[a - 1] * t;  // beyond: zero, r^2 is theirs
  const std::size_t stride = static_cast<std::size_t>(g.layout.stride());
  double* column = g.cells + static_cast<std::size_t>(j) * static_cast<std::size_t>(g.z_cells) * stride;

  const auto zero = hn::Zero(d), one = hn::Set(d, 1.0), two = hn::Set(d, 2.0);
  const auto largest = hn::Set(d, std::numeric_limits<double>::max());
  const auto nz = hn::Set(d, static_cast<double>(g.z_cells)), last = hn::Sub(nz, one);
  const auto z_start = hn::Set(d, g.z_start), z_scale = hn::Set(d, g.z_scale);
  LineSums<kP> sums;
  sums.clear();
  double current = -1;
  std::size_t good = 0;
  HWY_ALIGN double tail[2][hn::MaxLanes(D())] = {};
  HWY_ALIGN double cell_of[hn::MaxLanes(D())];
  for (std::size_t k = 0; k < n; k += lanes) {
    if (kPositive && current >= 0) {
      const std::size_t run = add_run(sums, g, current, r + k, z + k, n - k);
      good += run;
      k += run;
      if (k == n) break;
    }
    const double *rk = r + k, *zk = z + k;
    if (k + lanes > n) {
      std::copy(rk, r + n, tail[0]);
      std::copy(zk, z + n, tail[1]);
      rk = tail[0], zk = tail[1];
    }
    const auto range = hn::LoadU(d, rk);
    const auto x = hn::Mul(hn::Sub(hn::LoadU(d, zk), z_start), z_scale);
    // A vector that crosses into other cells, or may hold bad samples: cell by cell.
    const auto ok =
        hn::And(hn::And(hn::Ge(x, zero), hn::Le(x, nz)), hn::And(hn::Gt(range, zero), hn::Le(range, largest)));
    const auto cell = hn::Min(hn::Floor(x), last);
    const auto s = hn::Sub(hn::Mul(two, hn::Sub(x, cell)), one);
    auto left = ok;
    good += hn::CountTrue(d, ok);
    hn::Store(cell, d, cell_of);
    while (!hn::AllFalse(d, left)) {
      const double next = cell_of[hn::FindFirstTrue(d, left)];
      if (next != current) {
        if (current >= 0) sums.flush(g.layout, t_powers, column + static_cast<std::size_t>(current) * stride);
        current = next;
      }
      const auto here = hn::And(left, hn::Eq(cell, hn::Set(d, current)));
      sums.add(hn::CountTrue(d, here), hn::IfThenElseZero(here, s), hn::IfThenElseZero(here, range));
      left = hn::AndNot(here, left);
    }
  }
  if (current >= 0) sums.flush(g.layout, t_powers, column + static_cast<std::size_t>(current) * stride);
  return good;
}

template <int kP>
std::size_t add_line_of(const Grid& g, double v, const double* r, const double* z, std::size_t n, bool positive) {
  return positive ? add_line<kP, true>(g, v, r, z, n) : add_line<kP, false>(g, v, r, z, n);
}

std::size_t add_profile(const Grid& g, double v, const double* r, const double* z, std::size_t n, bool positive) {
  switch (g.layout.degree_u) {
    case 1:
      return add_line_of<1>(g, v, r, z, n, positive);
    case 2:
      return add_line_of<2>(g, v, r, z, n, positive);
    case 3:
      return add_line_of<3>(g, v, r, z, n, positive);
    case 4:
      return add_line_of<4>(g, v, r, z, n, positive);
    default:
      return add_line_of<5>(g, v, r, z, n, positive);
  }
}

void dot_products(const double* x, std::size_t step, int count, const double* y, std::size_t n, double* out) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  hn::Vec<D> sum[8];
  for (auto& part : sum) part = hn::Zero(d);
  std::size_t k = 0;
  for (; k + lanes <= n; k += lanes) {
    const auto right = hn::LoadU(d, y + k);
    for (int a = 0; a < count; ++a)
      sum[a] = hn::MulAdd(hn::LoadU(d, x + static_cast<std::size_t>(a) * step + k), right, sum[a]);
  }
  double totals[8];
  sums_of_lanes(sum, 8, totals);
  for (int a = 0; a < count; ++a) {
    for (std::size_t i = k; i < n; ++i) totals[a] += x[static_cast<std::size_t>(a) * step + i] * y[i];
    out[a] = totals[a];
  }
}

const char* target_name() {
  return hwy::TargetName(HWY_TARGET);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace celadon::moment_kernels
HWY_AFTER_NAMESPACE();
#endif

#if HWY_ONCE
namespace celadon::moment_kernels {

HWY_EXPORT(add_block);
HWY_EXPORT(add_profile);
HWY_EXPORT(all_positive);
HWY_EXPORT(dot_products);
HWY_EXPORT(target_name);

std::size_t add_block(const Grid& grid, const double* r, const double* z, const double* v, const double* weight,
                      std::size_t n) {
  return HWY_DYNAMIC_DISPATCH(add_block)(grid, r, z, v, weight, n);
}
std::size_t add_profile(const Grid& grid, double v, const double* r, const double* z, std::size_t n, bool positive) {
  return HWY_DYNAMIC_DISPATCH(add_profile)(grid, v, r, z, n, positive);
}
bool all_positive(const double* values, std::size_t n) {
  return HWY_DYNAMIC_DISPATCH(all_positive)(values, n);
}
void dot_products(const double* x, std::size_t step, int count, const double* y, std::size_t n, double* out) {
  HWY_DYNAMIC_DISPATCH(dot_products)(x, step, count, y, n, out);
}
const char* target_name() {
  return HWY_DYNAMIC_DISPATCH(target_name)();
}

}  // namespace celadon::moment_kernels
#endif
