#include "fitting/held_errors.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace celadon {
namespace {

// Of the system's largest entry, what conditions weigh that hold exactly: what is left of the errors that they forbid
// is the inverse of it.
constexpr double kHolding = 1e6;

// Over functions that are constant around, which add up to 1 there.
Eigen::MatrixXd marginal_along(const StencilMatrix& system) {
  Eigen::MatrixXd result = Eigen::MatrixXd::Zero(system.count_u(), system.count_u());
  for (int j = 0; j < system.count_v(); ++j)
    for (int o = 0; o < system.planes_v(); ++o)
      for (int i = 0; i < system.count_u(); ++i)
        for (int du = std::max(-i, -system.band_u()); du <= std::min(system.count_u() - 1 - i, system.band_u()); ++du)
          result(i, i + du) += system.plane(o, du)[system.at(i, j)];
  return result;
}

}  // namespace

HeldErrors::HeldErrors(std::vector<HeldAlong> conditions, const RangeSpace& along, const StencilMatrix& system,
                       const Eigen::MatrixXd& knot_bias, const Eigen::MatrixXd& knot_bias_around)
    : conditions_(std::move(conditions)),
      along_(along),
      bias_along_((knot_bias.cwiseAbs2() - knot_bias_around.cwiseAbs2()).cwiseMax(0).cwiseSqrt()),
      bias_around_(knot_bias_around),
      rows_(Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(conditions_.size()), system.count_u())) {
  for (std::size_t k = 0; k < conditions_.size(); ++k) {
    const ActiveValues values(along_, conditions_[k].along, conditions_[k].order);
    for (std::size_t a = 0; a < values.count; ++a)
      rows_(static_cast<Eigen::Index>(k), values.index[a]) = values.value[a];
  }
  const Eigen::MatrixXd moved = marginal_along(system).ldlt().solve(rows_.transpose());
  response_ = moved * (rows_ * moved).ldlt().solve(Eigen::MatrixXd::Identity(rows_.rows(), rows_.rows()));
}

void HeldErrors::weigh_into(StencilMatrix& system) const {
  double largest = 0;
  for (int j = 0; j < system.count_v(); ++j)
    for (int i = 0; i < system.count_u(); ++i) largest = std::max(largest, system.diagonal(i, j));
  for (Eigen::Index k = 0; k < rows_.rows(); ++k) {
    const Eigen::RowVectorXd row = rows_.row(k).normalized() * std::sqrt(kHolding * largest);
    for (int j = 0; j < system.count_v(); ++j)
      for (int i = 0; i < system.count_u(); ++i)
        for (int du = std::max(-i, -system.band_u()); du <= std::min(system.count_u() - 1 - i, system.band_u()); ++du)
          system.plane(system.plane_of(j, j), du)[system.at(i, j)] += row(i) * row(i + du);
  }
}

// What a spline of least squares cannot follow goes up and down once an interval: a wave of that length whose phase is
// anybody's guess, or its slope.
std::complex<double> HeldErrors::wave(double along, int order) const {
  const auto at = static_cast<std::size_t>(interval_at(along_, along));
  const double lo = along_.breaks()[at], length = along_.breaks()[at + 1] - lo;
  const std::complex<double> value = std::polar(1.0, 2 * std::numbers::pi * (along - lo) / length);
  return order == 0 ? value : value * std::complex<double>(0, 2 * std::numbers::pi / length);
}

// The surface misses the object by b, is moved by -(response) b at the conditions, and misses it by what is left. What
// the knots around cannot follow does not change from one interval along to the next.
double HeldErrors::knots_square(const ActiveValues& of_u, const ActiveValues& of_v, double along) const {
  const auto sum = [&](const Eigen::MatrixXd& bias, const ActiveValues& u) {
    double result = 0;
    for (std::size_t b = 0; b < of_v.count; ++b)
      for (std::size_t a = 0; a < u.count; ++a) result += u.value[a] * of_v.value[b] * bias(u.index[a], of_v.index[b]);
    return result;
  };
  std::complex<double> of_along = sum(bias_along_, of_u) * wave(along, 0);
  double of_around = sum(bias_around_, of_u);
  for (std::size_t k = 0; k < conditions_.size(); ++k) {
    double share = 0;
    for (std::size_t a = 0; a < of_u.count; ++a)
      share += of_u.value[a] * response_(of_u.index[a], static_cast<Eigen::Index>(k));
    const HeldAlong& at = conditions_[k];
    const ActiveValues there(along_, at.along);
    of_along -= share * sum(bias_along_, there) * wave(at.along, at.order);
    if (at.order == 0) of_around -= share * sum(bias_around_, there);
  }
  return std::norm(of_along) + of_around * of_around;
}

std::vector<double> HeldErrors::heights() const {
  std::vector<double> result;
  for (const HeldAlong& at : conditions_)
    if (at.order == 0) result.push_back(at.along);
  return result;
}

}  // namespace celadon
