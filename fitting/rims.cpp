#include "fitting/rims.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include "fitting/bending_energy.h"
#include "fitting/bspline_basis.h"
#include "fitting/common_knots.h"
#include "fitting/even_points.h"
#include "fitting/fit_report.h"
#include "fitting/range_space.h"
#include "fitting/robust_least_squares.h"

namespace celadon {
namespace {

constexpr double kFewest = 2000;                 // samples
constexpr double kPerColumn = 300, kPerBin = 8;  // samples of an even scan
constexpr std::size_t kGatePoints = 65536;
constexpr double kGateScales = 8;
constexpr double kFewestOfColumns = 64, kMostColumns = 1024;
constexpr double kCovered = 0.25;        // of the usual count: such a bin is of the wall
constexpr int kBelow = 3, kOfThose = 2;  // bins below the last one that are of the wall, too
constexpr double kFewestColumns = 0.75;  // of all, in which an end was found
constexpr int kEndsPerUnknown = 3;       // of the finest spline through ends
constexpr double kCharge = 2;            // of an unknown in cross validation: weights that follow residuals cheat
constexpr double kAsWell = 1.05;         // of the least error that is predicted
constexpr double kInside = 1;            // standard deviations that the rims keep from the ends of the samples
constexpr int kRimRounds = 10;           // of reweighting
constexpr double kBridging = 1e-9;       // bending energy that carries a rim over angles without ends
constexpr double kRounding = 1e-9;       // of what the ends vary
constexpr double kLeastHeight = 0.05;    // of the tallest, that is between the rims everywhere

bool usable(const Profile& p, std::size_t k) {
  return p.r_mm[k] > 0 && std::isfinite(p.r_mm[k]) && std::isfinite(p.theta_rad[k]) && std::isfinite(p.z_mm[k]);
}

// Which samples may be of the wall, by the ranges around them in an even choice: strays beyond a rim would move it.
class Gate {
 public:
  Gate(const Eigen::Matrix3Xd& points, double low, double high) : low_(low), per_mm_(kRows / (high - low)) {
    std::vector<std::vector<double>> ranges(kColumns * kRows);
    for (const auto& p : points.colwise())
      ranges[index(std::atan2(p.y(), p.x()), p.z())].push_back(std::hypot(p.x(), p.y()));
    middle_.resize(ranges.size()), reach_.assign(ranges.size(), 0);
    for (std::size_t k = 0; k < ranges.size(); ++k) {
      if (ranges[k].size() < 3) continue;
      middle_[k] = median(ranges[k]);
      for (double& r : ranges[k]) r = std::abs(r - middle_[k]);
      reach_[k] = kGateScales * 1.4826 * median(ranges[k]) + 1e-6 * middle_[k];
    }
  }
  /// Where too few are known, all pass.
  bool passes(double r_mm, double theta_rad, double z_mm) const {
    const std::size_t k = index(theta_rad, z_mm);
    return reach_[k] == 0 || std::abs(r_mm - middle_[k]) <= reach_[k];
  }

 private:
  static constexpr std::size_t kColumns = 64, kRows = 32;
  static double median(std::vector<double>& of) {
    const auto at = of.begin() + static_cast<std::ptrdiff_t>(of.size() / 2);
    std::nth_element(of.begin(), at, of.end());
    return *at;
  }
  std::size_t index(double theta_rad, double z_mm) const {
    const double turn = theta_rad / (2 * std::numbers::pi), share = turn - std::floor(turn);
    const auto column = std::min(static_cast<std::size_t>(share * kColumns), kColumns - 1);
    const auto row = static_cast<std::size_t>(std::clamp((z_mm - low_) * per_mm_, 0.0, kRows - 1.0));
    return column * kRows + row;
  }
  double low_, per_mm_;
  std::vector<double> middle_, reach_;
};

// Samples counted by columns around and bins along, with the highest and the lowest of each bin.
struct Bins {
  int columns = 0, rows = 0;
  double low = 0, per_mm = 0;
  struct Bin {
    int count = 0;
    double highest = -std::numeric_limits<double>::infinity(), at_highest_rad = 0;
    double lowest = std::numeric_limits<double>::infinity(), at_lowest_rad = 0;
  };
  std::vector<Bin> bins;

  Bin& at(int column, int row) { return bins[static_cast<std::size_t>(column * rows + row)]; }
  void add(double theta_rad, double z_mm) {
    const double turn = theta_rad / (2 * std::numbers::pi), share = turn - std::floor(turn);
    Bin& bin = at(std::min(static_cast<int>(share * columns), columns - 1),
                  std::clamp(static_cast<int>((z_mm - low) * per_mm), 0, rows - 1));
    ++bin.count;
    if (z_mm > bin.highest) bin.highest = z_mm, bin.at_highest_rad = theta_rad;
    if (z_mm < bin.lowest) bin.lowest = z_mm, bin.at_lowest_rad = theta_rad;
  }
};

// Ends of the samples in their columns: (theta, z).
using Ends = std::vector<std::pair<double, double>>;

Ends ends_of(Bins& bins, bool upper) {
  std::vector<int> filled;
  for (const auto& bin : bins.bins)
    if (bin.count > 0) filled.push_back(bin.count);
  std::nth_element(filled.begin(), filled.begin() + static_cast<std::ptrdiff_t>(filled.size() / 2), filled.end());
  const double usual = filled[filled.size() / 2];
  Ends ends;
  for (int column = 0; column < bins.columns; ++column) {
    // Rows counted from the end.
    const auto bin = [&](int k) -> const Bins::Bin& { return bins.at(column, upper ? bins.rows - 1 - k : k); };
    const auto covered = [&](int k) { return k < bins.rows && bin(k).count >= std::max(2.0, kCovered * usual); };
    for (int k = 0; k < bins.rows; ++k) {
      int below = 0;
      for (int b = 1; b <= kBelow; ++b) below += covered(k + b);
      if (!covered(k) || below < kOfThose) continue;
      // What is left of the column lies in the bin beyond.
      const auto& last = k > 0 && bin(k - 1).count > 0 ? bin(k - 1) : bin(k);
      upper ? ends.emplace_back(last.at_highest_rad, last.highest) : ends.emplace_back(last.at_lowest_rad, last.lowest);
      break;
    }
  }
  return ends;
}

struct RimSpline {
  SplineRows spline;  // of one row
  double scatter_mm = 0, generalised_error = 0;
};

// Tukey's least squares on a closed spline of some intervals.
RimSpline spline_through(const Ends& ends, int intervals_per_arc, const RangeFitOptions& options) {
  const RangeSpace space = RangeSpace::over(options.degree_v, options.arcs, intervals_per_arc, options.continuity);
  const auto rows = static_cast<Eigen::Index>(ends.size()), unknowns = Eigen::Index{space.free_count()};
  Eigen::MatrixXd design = Eigen::MatrixXd::Zero(rows, Eigen::Index{space.extraction().rows()});
  Eigen::VectorXd z(rows);
  for (Eigen::Index k = 0; k < rows; ++k) {
    const auto [theta, height] = ends[static_cast<std::size_t>(k)];
    const double v = options.arcs.v_of_theta(theta);
    const int span = find_span(space.knots(), space.degree(), v);
    const BasisValues N = basis_derivatives(space.knots(), space.degree(), span, v)[0];
    for (int j = 0; j <= space.degree(); ++j) design(k, span - space.degree() + j) = N[static_cast<std::size_t>(j)];
    z[k] = height;
  }
  const Eigen::MatrixXd A = design * space.extraction();
  const double size = z.maxCoeff() - z.minCoeff();
  const Eigen::MatrixXd bending = kBridging * gram_matrices(space, options.arcs, 1)[2];
  Eigen::VectorXd weight = Eigen::VectorXd::Ones(rows), x(unknowns), residual(rows);
  double scale = 0;
  for (int round = 0; round < kRimRounds; ++round) {
    const Eigen::MatrixXd weighted = weight.asDiagonal() * A;
    x = (A.transpose() * weighted + bending).ldlt().solve(weighted.transpose() * z);
    residual = z - A * x;
    scale = std::max(median_scale(residual, weight), kRounding * size);
    for (Eigen::Index k = 0; k < rows; ++k) weight[k] = tukey_weight(residual[k], scale);
  }
  RimSpline rim;
  const double n = weight.sum(), square = weight.dot(residual.cwiseAbs2());
  const auto left = [&](double charge) { return std::max(n - charge * static_cast<double>(unknowns), 1.0); };
  rim.scatter_mm = std::sqrt(square / left(1));
  rim.generalised_error = square * n / std::pow(left(kCharge), 2) + std::pow(kRounding * size, 2);
  rim.spline = {space.degree(), space.knots(), (space.extraction() * x).transpose()};
  return rim;
}

// With the fewest knots that predict the ends as well as any, and kept inside of them.
RimSpline spline_through(const Ends& ends, const RangeFitOptions& options, bool upper) {
  std::vector<RimSpline> ladder;
  for (int per_arc = 1; per_arc * options.arcs.count() * kEndsPerUnknown <= static_cast<int>(ends.size()); per_arc *= 2)
    ladder.push_back(spline_through(ends, per_arc, options));
  double least = std::numeric_limits<double>::infinity();
  for (const RimSpline& rim : ladder) least = std::min(least, rim.generalised_error);
  RimSpline best = *std::find_if(ladder.begin(), ladder.end(),
                                 [&](const RimSpline& rim) { return rim.generalised_error <= kAsWell * least; });
  best.spline.coefficients.array() += (upper ? -kInside : kInside) * best.scatter_mm;
  return best;
}

}  // namespace

tl::expected<Rims, FitError> find_rims(ProfileStream& samples, const RangeFitOptions& options) {
  double count = 0, low = std::numeric_limits<double>::infinity(), high = -low;
  samples.rewind();
  while (const Profile* p = samples.next())
    for (std::size_t k = 0; k < p->size(); ++k) {
      if (!usable(*p, k)) continue;
      ++count;
      low = std::min(low, p->z_mm[k]), high = std::max(high, p->z_mm[k]);
    }
  if (count < kFewest || !(low < high))
    return tl::unexpected(FitError{text(
        "%.0f usable samples are too few to show rims that are not plane (%.0f are); let the rims be plane, or take "
        "more samples",
        count, kFewest)});
  Bins bins;
  bins.columns = static_cast<int>(std::clamp<double>(count / kPerColumn, kFewestOfColumns, kMostColumns));
  bins.rows = static_cast<int>(std::clamp(count / (bins.columns * kPerBin), 16.0, 1024.0));
  bins.low = low;
  bins.per_mm = bins.rows / (high - low);
  bins.bins.resize(static_cast<std::size_t>(bins.columns * bins.rows));
  const Gate gate(even_points(samples, kGatePoints), low, high);
  samples.rewind();
  while (const Profile* p = samples.next())
    for (std::size_t k = 0; k < p->size(); ++k)
      if (usable(*p, k) && gate.passes(p->r_mm[k], p->theta_rad[k], p->z_mm[k])) bins.add(p->theta_rad[k], p->z_mm[k]);

  RimSpline rims[2];
  for (const bool upper : {false, true}) {
    const Ends ends = ends_of(bins, upper);
    if (static_cast<double>(ends.size()) < kFewestColumns * bins.columns)
      return tl::unexpected(
          FitError{text("the %s rim shows at %zu of %d angles only; let the rims be plane, or scan what is missing",
                        upper ? "upper" : "lower", ends.size(), bins.columns)});
    rims[upper] = spline_through(ends, options, upper);
  }
  SplineRows &lower = rims[0].spline, &upper = rims[1].spline;
  share_knots(lower, upper);
  const Eigen::RowVectorXd between = upper.coefficients - lower.coefficients;
  // A spline is no lower than its least coefficient.
  if (!(between.minCoeff() > kLeastHeight * between.maxCoeff()))
    return tl::unexpected(FitError{
        text("the rims come within %.3g mm of each other, %.3g mm elsewhere; let the rims be plane, or cut off what is "
             "not of the object",
             between.minCoeff(), between.maxCoeff())});
  BaseSurface base;
  base.arcs = options.arcs;
  base.band_start = lower.coefficients.mean();
  base.band_end = upper.coefficients.mean();
  Eigen::MatrixXd both(2, between.size());
  both << lower.coefficients, upper.coefficients;
  Rims found{.heights = std::make_shared<const RangeFunction>(base, 1, lower.degree, std::vector<double>{0, 0, 1, 1},
                                                              lower.knots, std::move(both)),
             .lower_scatter_mm = rims[0].scatter_mm,
             .upper_scatter_mm = rims[1].scatter_mm};
  RimmedStream between_them(samples, found.heights);
  between_them.rewind();
  while (between_them.next()) {
  }
  found.share_beyond = static_cast<double>(between_them.beyond()) / count;
  return found;
}

const Profile* RimmedStream::next() {
  const Profile* const from = from_.next();
  if (!from) return nullptr;
  const std::size_t n = from->size();
  const double start = heights_->base().band_start, end = heights_->base().band_end;
  profile_ = *from;
  lower_.resize(n), upper_.resize(n);
  along_.assign(n, start);
  heights_->evaluate(from->theta_rad.data(), along_.data(), n, lower_.data());
  along_.assign(n, end);
  heights_->evaluate(from->theta_rad.data(), along_.data(), n, upper_.data());
  std::size_t kept = 0;
  for (std::size_t k = 0; k < n; ++k) {
    const double share = (from->z_mm[k] - lower_[k]) / (upper_[k] - lower_[k]);
    if (!(share >= 0 && share <= 1)) {  // samples without numbers are nowhere
      beyond_ += !std::isnan(share);
      continue;
    }
    profile_.r_mm[kept] = from->r_mm[k];
    profile_.theta_rad[kept] = from->theta_rad[k];
    profile_.z_mm[kept] = start + share * (end - start);
    if (!from->row.empty()) profile_.row[kept] = from->row[k];
    if (!from->covariance.empty()) {
      // d along = s dz + t dtheta.
      const RangeDerivatives z = heights_->derivatives(from->theta_rad[k], profile_.z_mm[kept]);
      const double s = 1 / z.r_z, t = -z.r_theta * s;
      const SampleCovariance& c = from->covariance[k];
      profile_.covariance[kept] = {.rr = c.rr,
                                   .rt = c.rt,
                                   .rz = static_cast<float>(s * c.rz + t * c.rt),
                                   .tt = c.tt,
                                   .tz = static_cast<float>(s * c.tz + t * c.tt),
                                   .zz = static_cast<float>(s * s * c.zz + 2 * s * t * c.tz + t * t * c.tt)};
    }
    ++kept;
  }
  profile_.r_mm.resize(kept), profile_.theta_rad.resize(kept), profile_.z_mm.resize(kept);
  if (!from->row.empty()) profile_.row.resize(kept);
  if (!from->covariance.empty()) profile_.covariance.resize(kept);
  return &profile_;
}

void put_between_rims(RangeFit& fit, std::shared_ptr<const RangeFunction> heights) {
  const RangeFunction& f = fit.function;
  BaseSurface base = f.base();
  base.heights = std::move(heights);
  fit.function = RangeFunction(base, f.degree_u(), f.degree_v(), f.knots_u(), f.knots_v(), f.coefficients());
  fit.surface = symbolic_product(fit.function);
  fit.report.degree_u = fit.surface.degree_u;
  fit.report.degree_v = fit.surface.degree_v;
  fit.report.control_points_u = fit.surface.count_u();
  fit.report.control_points_v = fit.surface.count_v();
}

}  // namespace celadon
