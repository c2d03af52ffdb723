#include "fitting/bezier_patches.h"

#include <algorithm>
#include <stdexcept>

#include "fitting/knots.h"

namespace celadon {
namespace {

std::vector<double> breaks_along(const RangeFunction& f) {
  std::vector<double> z = breaks_of(f.knots_u()).values;
  const BaseSurface& base = f.base();
  if (base.spherical()) return z;
  for (double& t : z) t = (1 - t) * base.band_start + t * base.band_end;
  return z;
}

// Both lists within [lo, hi] and its ends; breaks that only rounding tells apart are one.
std::vector<double> merged(const std::vector<double>& a, const std::vector<double>& b, double lo, double hi) {
  std::vector<double> all(a);
  all.insert(all.end(), b.begin(), b.end());
  std::sort(all.begin(), all.end());
  const double near = 1e-12 * (hi - lo);
  std::vector<double> breaks{lo};
  for (const double t : all)
    if (t > breaks.back() + near && t < hi - near) breaks.push_back(t);
  breaks.push_back(hi);
  return breaks;
}

std::vector<double> joints(const BaseArcs& arcs) {
  std::vector<double> all;
  for (int j = 0; j <= arcs.count(); ++j) all.push_back(j);
  return all;
}

// Bezier coefficients of degree `to` = matrix * those of degree `from`.
IntervalMatrix elevation(int from, int to) {
  IntervalMatrix all = IntervalMatrix::Identity(from + 1, from + 1);
  for (int n = from; n < to; ++n) {
    IntervalMatrix next = IntervalMatrix::Zero(n + 2, from + 1);
    for (int i = 0; i <= n + 1; ++i) {
      const double share = static_cast<double>(i) / (n + 1);
      if (i > 0) next.row(i) += share * all.row(i - 1);
      if (i <= n) next.row(i) += (1 - share) * all.row(i);
    }
    all = next;
  }
  return all;
}

// Of one direction's intervals: the span's first coefficient, and the map from its coefficients.
struct Conversion {
  Eigen::Index first;
  IntervalMatrix map;
};
std::vector<Conversion> conversions(const std::vector<double>& knots, int degree, int to, std::vector<double> breaks) {
  std::vector<Conversion> all;
  const IntervalMatrix raise = elevation(degree, to);
  for (std::size_t k = 0; k + 1 < breaks.size(); ++k) {
    const int span = find_span(knots, degree, 0.5 * (breaks[k] + breaks[k + 1]));
    all.push_back({span - degree, raise * bezier_conversion(knots, degree, span, breaks[k], breaks[k + 1])});
  }
  return all;
}

}  // namespace

void BezierPatches::add(const RangeFunction& f, double sign) {
  const BaseSurface& base = f.base();
  std::vector<double> u = along_;
  if (!base.spherical())
    for (double& t : u) t = (t - base.band_start) / (base.band_end - base.band_start);
  const auto along_u = conversions(f.knots_u(), f.degree_u(), degree_u_, u);
  const auto along_v = conversions(f.knots_v(), f.degree_v(), degree_v_, v_);
  patches_.resize(along_u.size() * along_v.size(), IntervalMatrix::Zero(degree_u_ + 1, degree_v_ + 1));
  for (std::size_t j = 0; j < along_v.size(); ++j)
    for (std::size_t i = 0; i < along_u.size(); ++i) {
      const auto c = f.coefficients().block(along_u[i].first, along_v[j].first, f.degree_u() + 1, f.degree_v() + 1);
      patches_[j * along_u.size() + i] += sign * (along_u[i].map * c * along_v[j].map.transpose());
    }
}

BezierPatches::BezierPatches(const RangeFunction& f)
    : arcs_(f.base().arcs), degree_u_(f.degree_u()), degree_v_(f.degree_v()) {
  along_ = merged(breaks_along(f), {}, f.base().band_start, f.base().band_end);
  v_ = merged(breaks_of(f.knots_v()).values, joints(arcs_), 0, arcs_.count());
  add(f, 1);
}

BezierPatches::BezierPatches(const RangeFunction& a, const RangeFunction& b)
    : arcs_(a.base().arcs),
      degree_u_(std::max(a.degree_u(), b.degree_u())),
      degree_v_(std::max(a.degree_v(), b.degree_v())) {
  if (a.base().kind != b.base().kind || a.base().heights != b.base().heights)
    throw std::invalid_argument("BezierPatches: the two functions are over different bases");
  if (a.base().X_WB.matrix() != b.base().X_WB.matrix() || arcs_ != b.base().arcs) {
    throw std::invalid_argument("BezierPatches: the two functions have different frames or arcs");
  }
  const double lo = std::max(a.base().band_start, b.base().band_start);
  const double hi = std::min(a.base().band_end, b.base().band_end);
  if (!(lo < hi)) throw std::invalid_argument("BezierPatches: the two bands have nothing in common");
  along_ = merged(breaks_along(a), breaks_along(b), lo, hi);
  std::vector<double> v = breaks_of(a.knots_v()).values;
  const std::vector<double> of_b = breaks_of(b.knots_v()).values;
  v.insert(v.end(), of_b.begin(), of_b.end());
  v_ = merged(v, joints(arcs_), 0, arcs_.count());
  add(a, 1);
  add(b, -1);
}

}  // namespace celadon
