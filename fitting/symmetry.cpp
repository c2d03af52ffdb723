#include "fitting/symmetry.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>
#include <utility>
#include <vector>

#include "fitting/fit_report.h"

namespace celadon {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;

// Nodes of one sector as those of all: sector k is turned by `period`, every second one mirrored if asked for.
std::vector<double> repeated(const std::vector<double>& nodes, const Symmetry& symmetry) {
  const double period = nodes.back();
  std::vector<double> all;
  for (int k = 0; k < symmetry.sectors(); ++k)
    for (std::size_t i = k == 0 ? 0 : 1; i < nodes.size(); ++i)
      all.push_back(k * period + (symmetry.mirrored && k % 2 == 1 ? period - nodes[nodes.size() - 1 - i] : nodes[i]));
  return all;
}

// Columns of one sector, the last of which is the next one's first.
Eigen::MatrixXd repeated(const Eigen::MatrixXd& columns, const Symmetry& symmetry) {
  const Eigen::Index own = columns.cols() - 1;
  Eigen::MatrixXd all(columns.rows(), own * symmetry.sectors() + 1);
  for (Eigen::Index j = 0; j < all.cols(); ++j) {
    const Eigen::Index k = j / own, i = j % own;
    all.col(j) = columns.col(symmetry.mirrored && k % 2 == 1 ? own - i : i);
  }
  all.col(all.cols() - 1) = all.col(0);
  return all;
}

}  // namespace

BaseArcs Symmetry::sector() const {
  return BaseArcs::sector(mirrored ? plane_rad : 0, kTurn / sectors(),
                          mirrored ? ArcEnds::mirrored : ArcEnds::periodic);
}

const Profile* FoldedStream::next() {
  const Profile* const from = from_.next();
  if (!from) return nullptr;
  profile_ = *from;
  const double start = symmetry_.mirrored ? symmetry_.plane_rad : 0, period = kTurn / symmetry_.fold;
  for (std::size_t k = 0; k < profile_.size(); ++k) {
    double& theta = profile_.theta_rad[k];
    double within = std::fmod(theta - start, period);
    if (within < 0) within += period;
    if (symmetry_.mirrored && within > period / 2) {
      within = period - within;
      if (!profile_.covariance.empty()) {
        profile_.covariance[k].rt *= -1;
        profile_.covariance[k].tz *= -1;
      }
    }
    theta = start + within;
  }
  return &profile_;
}

RangeFunction unfolded(const RangeFunction& sector, const Symmetry& symmetry) {
  BaseSurface base = sector.base();
  const int arcs = base.arcs.count(), q = sector.degree_v();
  base.arcs = BaseArcs::circle(arcs * symmetry.sectors(), base.arcs.start_rad());
  if (q == 0)
    return {base,
            sector.degree_u(),
            q,
            sector.knots_u(),
            {0.0, static_cast<double>(base.arcs.count())},
            sector.coefficients()};
  // Where sectors meet, knots of multiplicity q: their shared coefficient is the value there.
  const std::vector<double> inner(sector.knots_v().begin() + 1, sector.knots_v().end() - 1);
  const std::size_t shared = static_cast<std::size_t>(q);
  std::vector<double> knots{0.0};
  for (int k = 0; k < symmetry.sectors(); ++k)
    for (std::size_t i = k == 0 ? 0 : shared; i < inner.size(); ++i)
      knots.push_back(k * arcs + (symmetry.mirrored && k % 2 == 1 ? arcs - inner[inner.size() - 1 - i] : inner[i]));
  knots.push_back(base.arcs.count());
  return {base, sector.degree_u(), q, sector.knots_u(), std::move(knots), repeated(sector.coefficients(), symmetry)};
}

RangeFit unfolded(RangeFit sector, const Symmetry& symmetry) {
  RangeFit whole = std::move(sector);
  const int sectors = symmetry.sectors();
  whole.function = unfolded(whole.function, symmetry);
  whole.surface = symbolic_product(whole.function);
  whole.report.control_points_v = whole.surface.count_v();
  whole.errors = nullptr;
  if (whole.deviation)
    whole.deviation = DeviationMap(whole.deviation->along(), repeated(whole.deviation->v(), symmetry),
                                   repeated(whole.deviation->sd_mm(), symmetry));
  if (!whole.geometric_errors.empty())
    whole.geometric_errors = whole.geometric_errors.repeated(sectors, symmetry.mirrored);
  return whole;
}

// <r, its mirror image about a> = sum over harmonics k of Re(c_k^2 exp(2 i k a)), c_k those of r(theta) = sum of
// 2 Re(c_k exp(i k theta)); over its norm it is 1 where both are the same.
tl::expected<double, FitError> find_mirror_plane(const RangeFunction& whole, int fold) {
  constexpr int kHeights = 32, kSteps = 720;
  constexpr double kRound = 1e-6, kAlike = 0.5;
  const BaseSurface& base = whole.base();
  const int around = std::max<int>(256, 2 * static_cast<int>(whole.coefficients().cols()));
  const int harmonics = around / 4;
  std::vector<std::complex<double>> squares(static_cast<std::size_t>(harmonics + 1));
  double norm = 0, range = 0;
  std::vector<double> theta(static_cast<std::size_t>(around)), along(theta.size()), r(theta.size());
  for (int j = 0; j < around; ++j) theta[static_cast<std::size_t>(j)] = kTurn * j / around;
  for (int i = 0; i < kHeights; ++i) {
    std::fill(along.begin(), along.end(), base.band_start + (base.band_end - base.band_start) * (i + 0.5) / kHeights);
    whole.evaluate(theta.data(), along.data(), theta.size(), r.data());
    for (int k = fold; k <= harmonics; k += fold) {
      std::complex<double> c = 0;
      for (int j = 0; j < around; ++j)
        c += r[static_cast<std::size_t>(j)] * std::polar(1.0 / around, -kTurn * (k * j % around) / around);
      squares[static_cast<std::size_t>(k)] += c * c;
      norm += std::norm(c);
    }
    for (const double x : r) range += x / around / kHeights;
  }
  if (std::sqrt(norm / kHeights) < kRound * range)
    return tl::unexpected(FitError{"a round surface is its own mirror image at every angle; leave the mirror out"});
  const auto likeness = [&](double a) {
    double sum = 0;
    for (int k = fold; k <= harmonics; k += fold)
      sum += (squares[static_cast<std::size_t>(k)] * std::polar(1.0, 2.0 * k * a)).real();
    return sum / norm;
  };
  // Planes repeat every pi/fold.
  const double period = std::numbers::pi / fold, step = period / kSteps;
  double best = 0;
  for (int s = 1; s < kSteps; ++s)
    if (likeness(s * step) > likeness(best)) best = s * step;
  double lo = best - step, hi = best + step;
  for (int k = 0; k < 60; ++k) {
    const double a = lo + (hi - lo) / 3, b = hi - (hi - lo) / 3;
    (likeness(a) < likeness(b) ? lo : hi) = likeness(a) < likeness(b) ? a : b;
  }
  best = (lo + hi) / 2;
  if (likeness(best) < kAlike)
    return tl::unexpected(FitError{
        text("no half plane makes the surface its own mirror image: at %.4g degrees, the best one, they are alike to "
             "%.2g (1: the same); leave the mirror out",
             best * 180 / std::numbers::pi, likeness(best))});
  return best < 0 ? best + period : best;
}

}  // namespace celadon
