#include "fitting/deviation_map.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <utility>

#include "fitting/coefficient_covariance.h"
#include "fitting/deviation_nodes.h"

namespace celadon {
namespace {

struct Place {
  std::size_t node;  // the lower one
  double share;      // of the upper one
};

Place place(const std::vector<double>& nodes, double t) {
  const auto next = std::upper_bound(nodes.begin() + 1, nodes.end() - 1, t);
  const double lo = *(next - 1), hi = *next;
  return {static_cast<std::size_t>(next - nodes.begin()) - 1, std::clamp((t - lo) / (hi - lo), 0.0, 1.0)};
}

// Intervals are halved; next to places where deviations fall steeply, cut in eight.
std::vector<double> nodes_of(const DeviationBreaks& space, double start, double end) {
  const double least = 1e-9 * (end - start);
  const auto same = [&](double a, double b) { return std::abs(a - b) <= least; };
  std::vector<double> edges{start, end};
  for (const std::vector<double>* places : {&space.breaks, &space.held})
    for (const double b : *places)
      if (b > start && b < end) edges.push_back(b);
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end(), same), edges.end());
  edges.back() = end;
  const auto steep = [&](double at) {
    return (space.ends && (at == start || at == end)) ||
           std::any_of(space.held.begin(), space.held.end(), [&](double held) { return same(at, held); });
  };
  std::vector<double> nodes{start};
  for (std::size_t k = 1; k < edges.size(); ++k) {
    const int parts = steep(edges[k - 1]) || steep(edges[k]) ? 8 : 2;
    for (int part = 1; part < parts; ++part) nodes.push_back(edges[k - 1] + (edges[k] - edges[k - 1]) * part / parts);
    nodes.push_back(edges[k]);
  }
  return nodes;
}

double three_digits_up(double x) {
  if (!(x > 0)) return 0;
  const double unit = std::pow(10.0, std::floor(std::log10(x)) - 2);
  char text[32];
  std::snprintf(text, sizeof text, "%.2e", std::ceil(x / unit * (1 - 1e-12)) * unit);
  return std::strtod(text, nullptr);
}

// How much of the whole each node stands for: the trapezoid's weights.
Eigen::VectorXd shares(const std::vector<double>& x) {
  Eigen::VectorXd w = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(x.size()));
  for (std::size_t k = 0; k + 1 < x.size(); ++k) {
    w(static_cast<Eigen::Index>(k)) += (x[k + 1] - x[k]) / 2;
    w(static_cast<Eigen::Index>(k) + 1) += (x[k + 1] - x[k]) / 2;
  }
  return w / w.sum();
}

}  // namespace

DeviationMap::DeviationMap(std::vector<double> along, std::vector<double> v, Eigen::MatrixXd sd_mm)
    : along_(std::move(along)), v_(std::move(v)), sd_mm_(std::move(sd_mm)) {}

double DeviationMap::operator()(double v, double along) const {
  const Place a = place(along_, along), b = place(v_, v);
  const auto i = static_cast<Eigen::Index>(a.node), j = static_cast<Eigen::Index>(b.node);
  return (1 - b.share) * ((1 - a.share) * sd_mm_(i, j) + a.share * sd_mm_(i + 1, j)) +
         b.share * ((1 - a.share) * sd_mm_(i, j + 1) + a.share * sd_mm_(i + 1, j + 1));
}

void DeviationMap::evaluate(const double* v, const double* along, std::size_t n, double* sd) const {
  for (std::size_t k = 0; k < n; ++k) sd[k] = (*this)(v[k], along[k]);
}

double DeviationMap::mean(const BaseSurface& base) const {
  std::vector<double> along(along_), around(v_);
  for (double& v : around) v = base.arcs.theta_of_v(v);
  if (base.spherical())
    for (double& w : along) w = -std::cos(BaseSurface::meridian().theta_of_v(w));
  return shares(along).dot(sd_mm_ * shares(around));
}

DeviationMap deviation_map(const std::function<double(double v, double along)>& sd_mm, const DeviationBreaks& of_along,
                           const DeviationBreaks& of_v, double start, double end) {
  std::vector<double> along = nodes_of(of_along, start, end),
                      v = nodes_of(of_v, of_v.breaks.front(), of_v.breaks.back());
  Eigen::MatrixXd sd(static_cast<Eigen::Index>(along.size()), static_cast<Eigen::Index>(v.size()));
  for (std::size_t j = 0; j < v.size(); ++j)
    for (std::size_t i = 0; i < along.size(); ++i)
      sd(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) = three_digits_up(sd_mm(v[j], along[i]));
  return {std::move(along), std::move(v), std::move(sd)};
}

DeviationMap deviation_map(const CoefficientCovariance& covariance, double start, double end) {
  const auto breaks = [](const RangeSpace& space, std::vector<double> held) {
    return DeviationBreaks{space.breaks(), !space.periodic() && space.degree() > 0, std::move(held)};
  };
  return deviation_map([&](double v, double along) { return covariance.sd_mm(v, along); },
                       breaks(covariance.space().u, covariance.held_heights()), breaks(covariance.space().v, {}), start,
                       end);
}

}  // namespace celadon
