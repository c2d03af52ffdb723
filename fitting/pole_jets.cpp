#include "fitting/pole_jets.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>

#include "fitting/base_surface.h"
#include "fitting/gauss_legendre.h"

namespace celadon {
namespace {

constexpr int kHarmonics = 4;  // cos theta, sin theta, cos 2 theta, sin 2 theta
constexpr int kQuadrature = 10;
// Relative size of a direction that the spline around cannot tell from the others.
constexpr double kRank = 1e-8;

double value(std::span<const double> polynomial, double s) {
  double result = 0;
  for (std::size_t k = polynomial.size(); k-- > 0;) result = result * s + polynomial[k];
  return result;
}

// Free coefficients of the least squares approximations to the harmonics, with respect to theta.
Eigen::MatrixXd harmonics(const RangeSpace& v, const BaseArcs& arcs) {
  const int n = v.free_count();
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(n, n), right = Eigen::MatrixXd::Zero(n, kHarmonics);
  const GaussRule& rule = gauss_rule(kQuadrature);
  for (int k = 0; k < v.intervals(); ++k) {
    const double lo = v.breaks()[static_cast<std::size_t>(k)], hi = v.breaks()[static_cast<std::size_t>(k) + 1];
    const auto active = v.active(k);
    Eigen::VectorXd N(static_cast<Eigen::Index>(active.size()));
    for (std::size_t q = 0; q < rule.nodes.size(); ++q) {
      const double s = rule.nodes[q], at = lo + (hi - lo) / 2 * (1 + s), theta = arcs.theta_of_v(at);
      double theta_v = 1, theta_vv = 0;
      arcs.theta_derivatives(at, theta_v, theta_vv);
      const double weight = rule.weights[q] * theta_v;
      for (std::size_t a = 0; a < active.size(); ++a)
        N[static_cast<Eigen::Index>(a)] = value(v.polynomial(k, static_cast<int>(a)), s);
      const std::array<double, kHarmonics> f = {std::cos(theta), std::sin(theta), std::cos(2 * theta),
                                                std::sin(2 * theta)};
      for (std::size_t a = 0; a < active.size(); ++a) {
        for (std::size_t b = 0; b < active.size(); ++b)
          gram(active[a], active[b]) += weight * N[static_cast<Eigen::Index>(a)] * N[static_cast<Eigen::Index>(b)];
        for (std::size_t h = 0; h < f.size(); ++h)
          right(active[a], static_cast<Eigen::Index>(h)) += weight * N[static_cast<Eigen::Index>(a)] * f[h];
      }
    }
  }
  return gram.llt().solve(right);
}

// Rows 0, 1, 2 from a pole outward (fewer for degree 1), one below another, one column for each of f00, a, b, c, d, e:
// method 7. `harmonics` are those of v, `h1` and `h2` the intervals next to the pole, `c` is 1 - w of the meridian.
Eigen::MatrixXd jet(int degree, const Eigen::MatrixXd& harmonics, double h1, double h2, double c) {
  const Eigen::Index n = harmonics.rows();
  const double p = degree;
  Eigen::MatrixXd f0 = Eigen::MatrixXd::Zero(n, 6);
  f0.col(0).setOnes();
  if (degree == 1) return f0.leftCols(1);
  Eigen::MatrixXd slope = Eigen::MatrixXd::Zero(n, 6), second = slope;  // F_u and F_uu
  slope.middleCols(1, 2) = harmonics.leftCols(2);
  second = 2 * c * slope;
  second.col(3).setOnes();
  second.rightCols(2) = harmonics.rightCols(2);
  const Eigen::MatrixXd f1 = f0 + h1 / p * slope;
  const Eigen::MatrixXd f2 = f1 + (h1 + h2) * (h1 / (p * (p - 1)) * second + (f1 - f0) / h1);
  Eigen::MatrixXd rows(3 * n, 6);
  rows << f0, f1, f2;
  return rows;
}

}  // namespace

PoleJets::PoleJets(const RangeSpace& u, const RangeSpace& v, const BaseArcs& around, Poles poles)
    : count_u_(u.free_count()), count_v_(v.free_count()), last_row_(u.free_count()) {
  const int bound = poles.rows(u.degree());
  const int needed = bound * (static_cast<int>(poles.start) + static_cast<int>(poles.end));
  if (count_u_ < needed || u.intervals() < 2) {
    throw std::invalid_argument("PoleJets: " + std::to_string(count_u_) + " rows of coefficients on " +
                                std::to_string(u.intervals()) + " intervals are too few for closed poles");
  }
  const Eigen::MatrixXd of_v = harmonics(v, around);
  const double quarter = std::sin(BaseSurface::meridian().arc_rad() / 4), c = 2 * quarter * quarter;
  const auto& breaks = u.breaks();
  const std::size_t last = breaks.size() - 1;
  const auto bind = [&](bool from_end) {
    const double h1 = from_end ? breaks[last] - breaks[last - 1] : breaks[1] - breaks[0];
    const double h2 = from_end ? breaks[last - 1] - breaks[last - 2] : breaks[2] - breaks[1];
    const Eigen::MatrixXd rows = poles.rule == PoleRule::jet
                                     ? jet(u.degree(), of_v, h1, h2, c)
                                     : Eigen::MatrixXd::Ones(static_cast<Eigen::Index>(bound) * count_v_, 1);
    Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(rows);
    qr.setThreshold(kRank);
    const Eigen::Index rank = qr.rank();
    const Eigen::MatrixXd Q = qr.householderQ() * Eigen::MatrixXd::Identity(rows.rows(), rank);
    for (Eigen::Index k = 0; k < rank; ++k) {
      Eigen::MatrixXd column = Eigen::MatrixXd::Zero(count_u_, count_v_);
      for (int i = 0; i < bound; ++i)
        column.row(from_end ? count_u_ - 1 - i : i) =
            Q.col(k).segment(static_cast<Eigen::Index>(i) * count_v_, count_v_).transpose();
      columns_.push_back(std::move(column));
    }
  };
  if (poles.start) {
    bind(false);
    first_row_ = bound;
  }
  if (poles.end) {
    bind(true);
    last_row_ -= bound;
  }
}

int PoleJets::unknowns() const {
  return (last_row_ - first_row_) * count_v_ + parameters();
}

}  // namespace celadon
