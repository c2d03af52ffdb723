#include "fitting/bending_energy.h"

#include <cmath>

#include "fitting/base_surface.h"

namespace celadon {
namespace {

// Gauss - Legendre nodes and weights on [-1, 1]: exact to degree 15, and to rounding for the smooth factor of theta(v).
constexpr std::array<double, 8> kNodes = {-0.9602898564975363, -0.7966664774136267, -0.5255324099163290,
                                          -0.1834346424956498, 0.1834346424956498,  0.5255324099163290,
                                          0.7966664774136267,  0.9602898564975363};
constexpr std::array<double, 8> kWeights = {0.1012285362903763, 0.2223810344533745, 0.3137066458778873,
                                            0.3626837833783620, 0.3626837833783620, 0.3137066458778873,
                                            0.2223810344533745, 0.1012285362903763};

// A polynomial in s and its first two derivatives with respect to s.
std::array<double, 3> derivatives(std::span<const double> c, double s) {
  double value = 0, first = 0, second = 0;
  for (std::size_t k = c.size(); k-- > 0;) {
    second = second * s + 2 * first;
    first = first * s + value;
    value = value * s + c[k];
  }
  return {value, first, second};
}

// `chain` turns (F, F_t, F_tt) at parameter t into the derivatives wanted and gives the measure dx/dt.
template <class Chain>
GramMatrices integrate(const RangeSpace& space, const Chain& chain) {
  const int n = space.free_count();
  GramMatrices gram;
  for (auto& g : gram) g = Eigen::MatrixXd::Zero(n, n);
  for (int k = 0; k < space.intervals(); ++k) {
    const double lo = space.breaks()[static_cast<std::size_t>(k)], hi = space.breaks()[static_cast<std::size_t>(k) + 1];
    const double half = (hi - lo) / 2;
    const auto active = space.active(k);
    std::vector<std::array<double, 3>> values(active.size());
    for (std::size_t q = 0; q < kNodes.size(); ++q) {
      double measure = 1;
      for (std::size_t a = 0; a < active.size(); ++a) {
        auto d = derivatives(space.polynomial(k, static_cast<int>(a)), kNodes[q]);
        d[1] /= half;
        d[2] /= half * half;
        measure = chain(lo + half * (kNodes[q] + 1), d);
        values[a] = d;
      }
      const double weight = kWeights[q] * half * measure;
      for (std::size_t a = 0; a < active.size(); ++a)
        for (std::size_t b = 0; b < active.size(); ++b)
          for (std::size_t order = 0; order < 3; ++order)
            gram[order](active[a], active[b]) += weight * values[a][order] * values[b][order];
    }
  }
  return gram;
}

}  // namespace

GramMatrices gram_matrices(const RangeSpace& space) {
  return integrate(space, [](double, std::array<double, 3>&) { return 1.0; });
}

GramMatrices gram_matrices(const RangeSpace& space, const BaseArcs& arcs, double r_mean) {
  return integrate(space, [&](double v, std::array<double, 3>& d) {
    double theta_v = 1, theta_vv = 0;
    arcs.theta_derivatives(v, theta_v, theta_vv);
    const double s_v = r_mean * theta_v, s_vv = r_mean * theta_vv;
    // F_s = F_v / s_v,  F_ss = (F_vv - F_s s_vv) / s_v^2
    d[1] /= s_v;
    d[2] = (d[2] - d[1] * s_vv) / (s_v * s_v);
    return s_v;
  });
}

BendingEnergy spherical_energy(const RangeSpace& u, const RangeSpace& v, const BaseArcs& around) {
  const int n = u.free_count();
  BendingEnergy energy;
  energy.along_v = gram_matrices(v, around, 1);
  for (auto& g : energy.along_u) g = Eigen::MatrixXd::Zero(n, n);
  const BaseArcs& meridian = BaseSurface::meridian();
  const bool closed = around.closed();
  for (int k = 0; k < u.intervals(); ++k) {
    const double lo = u.breaks()[static_cast<std::size_t>(k)], hi = u.breaks()[static_cast<std::size_t>(k) + 1];
    const double half = (hi - lo) / 2;
    const auto active = u.active(k);
    std::vector<std::array<double, 3>> f(active.size());  // with respect to phi
    for (std::size_t q = 0; q < kNodes.size(); ++q) {
      const double w = lo + half * (kNodes[q] + 1), phi = meridian.theta_of_v(w), s = std::sin(phi), c = std::cos(phi);
      double phi_w = 1, phi_ww = 0;
      meridian.theta_derivatives(w, phi_w, phi_ww);
      for (std::size_t a = 0; a < active.size(); ++a) {
        auto d = derivatives(u.polynomial(k, static_cast<int>(a)), kNodes[q]);
        d[1] /= half * phi_w;
        d[2] = (d[2] / (half * half) - d[1] * phi_ww) / (phi_w * phi_w);
        f[a] = d;
      }
      const double weight = kWeights[q] * half * phi_w;
      for (std::size_t a = 0; a < active.size(); ++a)
        for (std::size_t b = 0; b < active.size(); ++b) {
          const double f00 = f[a][0] * f[b][0], f11 = f[a][1] * f[b][1], f01 = f[a][0] * f[b][1] + f[a][1] * f[b][0];
          // Beside V0, 2 V1 and V2. Around a closed circle the product of rho_tt and rho is -rho_t^2.
          energy.along_u[2](active[a], active[b]) += weight * (f[a][2] * f[b][2] * s + (closed ? f11 * c * c / s : 0));
          energy.along_u[1](active[a], active[b]) +=
              weight * ((f11 - c / s * f01 + c * c / (s * s) * f00) / s - (closed ? 0.5 * f01 * c / (s * s) : 0));
          energy.along_u[0](active[a], active[b]) += weight * f00 / (s * s * s);
        }
    }
  }
  return energy;
}

double BendingEnergy::trace() const {
  const auto &u = along_u, &v = along_v;
  return u[2].trace() * v[0].trace() + 2 * u[1].trace() * v[1].trace() + u[0].trace() * v[2].trace();
}

double BendingEnergy::of(const Eigen::MatrixXd& free) const {
  const auto part = [&](int k) {
    const auto at = static_cast<std::size_t>(k);
    return (along_u[2 - at] * free * along_v[at]).cwiseProduct(free).sum();
  };
  return part(0) + 2 * part(1) + part(2);
}

void BendingEnergy::add_to(StencilMatrix& matrix, double factor) const {
  const auto &u = along_u, &v = along_v;
  const int nu = matrix.count_u(), band = matrix.band_u();
  for (int j = 0; j < matrix.count_v(); ++j)
    for (int o = 0; o < matrix.planes_v(); ++o) {
      const int k = matrix.neighbour(j, o);
      const double v0 = factor * v[0](j, k), v1 = 2 * factor * v[1](j, k), v2 = factor * v[2](j, k);
      for (int du = -band; du <= band; ++du) {
        double* row = matrix.plane(o, du) + matrix.at(0, j);
        for (int i = std::max(0, -du); i < std::min(nu, nu - du); ++i)
          row[i] += v0 * u[2](i, i + du) + v1 * u[1](i, i + du) + v2 * u[0](i, i + du);
      }
    }
}

}  // namespace celadon
