#include "fitting/prolongation.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>

#include "fitting/bending_energy.h"

namespace celadon {
namespace {

double value(std::span<const double> c, double s) {
  double result = 0;
  for (std::size_t k = c.size(); k-- > 0;) result = result * s + c[k];
  return result;
}

// Gauss - Legendre, exact to degree 11: products of two quintics.
constexpr std::array<double, 6> kNodes = {-0.9324695142031521, -0.6612093864662645, -0.2386191860831969,
                                          0.2386191860831969,  0.6612093864662645,  0.9324695142031521};
constexpr std::array<double, 6> kWeights = {0.1713244923791704, 0.3607615730481386, 0.4679139345726910,
                                            0.4679139345726910, 0.3607615730481386, 0.1713244923791704};

}  // namespace

// The projection onto fine is the identity on its subspaces: K = G^-1 (integrals of fine times coarse functions).
Eigen::MatrixXd prolongation(const RangeSpace& coarse, const RangeSpace& fine) {
  Eigen::MatrixXd mixed = Eigen::MatrixXd::Zero(fine.free_count(), coarse.free_count());
  int at = 0;
  for (int k = 0; k < fine.intervals(); ++k) {
    const double lo = fine.breaks()[static_cast<std::size_t>(k)], hi = fine.breaks()[static_cast<std::size_t>(k) + 1];
    while (at + 1 < coarse.intervals() && coarse.breaks()[static_cast<std::size_t>(at) + 1] < (lo + hi) / 2) ++at;
    const double from = coarse.breaks()[static_cast<std::size_t>(at)],
                 to = coarse.breaks()[static_cast<std::size_t>(at) + 1];
    const auto fine_active = fine.active(k), coarse_active = coarse.active(at);
    for (std::size_t q = 0; q < kNodes.size(); ++q) {
      const double t = lo + (hi - lo) / 2 * (kNodes[q] + 1), s = 2 * (t - from) / (to - from) - 1;
      const double weight = kWeights[q] * (hi - lo) / 2;
      for (std::size_t a = 0; a < fine_active.size(); ++a) {
        const double f = weight * value(fine.polynomial(k, static_cast<int>(a)), kNodes[q]);
        for (std::size_t b = 0; b < coarse_active.size(); ++b)
          mixed(fine_active[a], coarse_active[b]) += f * value(coarse.polynomial(at, static_cast<int>(b)), s);
      }
    }
  }
  return gram_matrices(fine)[0].llt().solve(mixed);
}

}  // namespace celadon
