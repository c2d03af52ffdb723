#include "daemon/checks/overlap_comparison.h"

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>

#include "daemon/checks/spread.h"

namespace celadon {
namespace {

constexpr std::size_t kFewestProfiles = 8;        // of the first look, for a cubic with something left over
constexpr std::size_t kFewestSecondProfiles = 4;  // for an uncertainty from their scatter
constexpr std::size_t kFewestSamples = 200;
constexpr double kRowScales = 3;      // rows that scatter more than this times the median are edges
constexpr double kOutlierScales = 4;  // of the differences' robust scale
constexpr double kLeastOverlap = 0.4;

using Vector = Eigen::Vector4d;

/// A row of the first look as a cubic in x = 2 angle/look - 1.
struct RowCurve {
  Vector c = Vector::Zero();
  Eigen::Matrix4d covariance = Eigen::Matrix4d::Zero();  ///< of c, for noise of variance 1
  double square = 0, freedom = 0;

  static constexpr double kScale = 2 / OverlapComparison::kFirstLook_rad;
  static double x_of(double angle_rad) { return kScale * angle_rad - 1; }
  double value(double x) const { return c[0] + x * (c[1] + x * (c[2] + x * c[3])); }
  double slope(double x) const { return kScale * (c[1] + x * (2 * c[2] + x * 3 * c[3])); }
  /// For noise of variance 1: variance of the slope, and covariance of slope and value.
  double slope_variance(double x) const {
    const Vector g(0, 1, 2 * x, 3 * x * x);
    return kScale * kScale * g.dot(covariance * g);
  }
  double slope_covariance(double x) const {
    return kScale * Vector(0, 1, 2 * x, 3 * x * x).dot(covariance * Vector(1, x, x * x, x * x * x));
  }
};

/// A sample of the second look and the first look's curve for its row.
struct Pair {
  const RowCurve* curve;
  std::size_t profile;
  double angle_rad, r_mm;
};

bool seen(double angle_rad) {
  return angle_rad >= 0 && angle_rad <= OverlapComparison::kFirstLook_rad;
}

/// Mean square of the second look against the first one turned by d; nullopt: too little of it is seen twice.
std::optional<double> mean_square(const std::vector<Pair>& pairs, double d) {
  double square = 0;
  std::size_t n = 0;
  for (const Pair& p : pairs) {
    if (!seen(p.angle_rad + d)) continue;
    const double e = p.r_mm - p.curve->value(RowCurve::x_of(p.angle_rad + d));
    square += e * e, ++n;
  }
  if (static_cast<double>(n) < kLeastOverlap * static_cast<double>(pairs.size())) return std::nullopt;
  return square / static_cast<double>(n);
}

/// Sums of one profile of the second look for one unknown x: difference = slope x.
struct Sums {
  double ss = 0, se = 0, n = 0;
};

/// The unknown from all profiles, and its standard uncertainty by the profiles' scatter, as a jackknife tells it.
struct Estimate {
  double x = 0, u = 0;
};
Estimate estimate_of(const std::vector<Sums>& profiles) {
  Sums all;
  for (const Sums& s : profiles) all.ss += s.ss, all.se += s.se;
  Estimate estimate{all.se / all.ss, 0};
  double square = 0, m = 0;
  for (const Sums& s : profiles) {
    if (s.n == 0 || !(all.ss > s.ss)) continue;
    const double without = (all.se - s.se) / (all.ss - s.ss);
    square += (without - estimate.x) * (without - estimate.x), ++m;
  }
  // Few profiles know their own scatter badly: the factor is that of Student's distribution.
  estimate.u = m > 3 ? std::sqrt(square * (m - 1) / m * (m - 1) / (m - 3)) : std::numeric_limits<double>::infinity();
  return estimate;
}

/// What is worth comparing: differences to the curve turned by d, shifted by s, without outliers.
std::vector<Pair> without_outliers(const std::vector<Pair>& pairs, double d, double s) {
  std::vector<double> sizes;
  for (const Pair& p : pairs) {
    if (seen(p.angle_rad + d)) sizes.push_back(std::abs(p.r_mm - s - p.curve->value(RowCurve::x_of(p.angle_rad + d))));
  }
  const double most = kOutlierScales * 1.4826 * median(std::move(sizes));
  std::vector<Pair> kept;
  for (const Pair& p : pairs) {
    if (seen(p.angle_rad + d) && std::abs(p.r_mm - s - p.curve->value(RowCurve::x_of(p.angle_rad + d))) <= most)
      kept.push_back(p);
  }
  return kept;
}

/// Variance of second minus first look by that of the second, for errors common to the samples of a profile as for
/// independent ones: what passes through the first look's cubics is the mean of their functions there.
double both_by_second(const std::vector<Pair>& pairs, double d, std::size_t second_profiles) {
  Vector mean = Vector::Zero();
  for (const Pair& p : pairs) {
    const double x = RowCurve::x_of(p.angle_rad + d);
    mean += Vector(1, x, x * x, x * x * x) / static_cast<double>(pairs.size());
  }
  return 1 + static_cast<double>(second_profiles) * mean.dot(pairs.front().curve->covariance * mean);
}

/// Shift and turn at the same time: is one needed beside the other? `noise_mm` with what correlation makes of it.
OverlapResult::Cause cause_of(const std::vector<Pair>& pairs, const OverlapResult& alone, double noise_mm,
                              std::size_t second_profiles) {
  using Cause = OverlapResult::Cause;
  constexpr double kSigmas = 4;
  // Differences count up to here: more is as wrong.
  const double most = std::pow(kOutlierScales * alone.noise_mm, 2);
  const auto left = [&](const Pair& p, double d, double s) {
    const double e = p.r_mm - s - p.curve->value(RowCurve::x_of(p.angle_rad + d));
    return std::min(e * e, most);
  };
  double gain = 0, compared = 0;
  for (const Pair& p : pairs) {
    if (!seen(p.angle_rad) || !seen(p.angle_rad + alone.turn_rad)) continue;
    gain += left(p, 0, alone.shift_mm) - left(p, alone.turn_rad, 0), ++compared;
  }
  // Less than that the uncertain ends of the first look's curves make of it.
  constexpr double kClear = 0.3;
  if (std::abs(gain) > kClear * compared * noise_mm * noise_mm) return gain > 0 ? Cause::turn : Cause::shift;
  // Linear about what leaves less.
  const double d = gain >= 0 ? alone.turn_rad : 0, s = gain >= 0 ? 0 : alone.shift_mm;
  const std::vector<Pair> kept = without_outliers(pairs, d, s);
  Eigen::Matrix2d normal = Eigen::Matrix2d::Zero();
  Eigen::Vector2d right = Eigen::Vector2d::Zero();
  double by_noise = 0;
  for (const Pair& p : kept) {
    const double x = RowCurve::x_of(p.angle_rad + d);
    const Eigen::Vector2d g(1, p.curve->slope(x));
    normal += g * g.transpose();
    right += g * (p.r_mm - s - p.curve->value(x));
    // Slopes that noise makes would hide a turn behind a shift.
    by_noise += noise_mm * noise_mm * p.curve->slope_variance(x);
    right[1] += alone.noise_mm * alone.noise_mm * p.curve->slope_covariance(x);
  }
  normal(1, 1) -= by_noise;
  // Where slopes differ by little more than noise, both unknowns are one.
  if (!(normal.determinant() > by_noise * normal(0, 0))) return Cause::either;
  const Eigen::Matrix2d inverse = normal.inverse();
  const Eigen::Vector2d both = Eigen::Vector2d(s, d) + inverse * right;
  const double noise = noise_mm * std::sqrt(both_by_second(kept, d, second_profiles));
  const bool shift = std::abs(both[0]) > kSigmas * noise * std::sqrt(inverse(0, 0)),
             turn = std::abs(both[1]) > kSigmas * noise * std::sqrt(inverse(1, 1));
  if (turn == shift) return !turn ? Cause::either : gain >= 0 ? Cause::turn : Cause::shift;
  return turn ? Cause::turn : Cause::shift;
}

}  // namespace

void OverlapComparison::first(double turned_rad, const Profile& profile) {
  if (!seen(turned_rad) || profile.row.empty()) return;
  for (std::size_t i = 0; i < profile.size(); ++i)
    first_[std::uint32_t{profile.laser} << 16 | profile.row[i]].push_back(
        {first_profiles_, turned_rad, profile.r_mm[i]});
  ++first_profiles_;
}

void OverlapComparison::again(double beyond_rad, const Profile& profile) {
  if (profile.row.empty()) return;
  for (std::size_t i = 0; i < profile.size(); ++i)
    again_.push_back(
        {std::uint32_t{profile.laser} << 16 | profile.row[i], {second_profiles_, beyond_rad, profile.r_mm[i]}});
  last_beyond_rad_ = std::max(last_beyond_rad_, beyond_rad);
  ++second_profiles_;
}

OverlapResult OverlapComparison::result() const {
  OverlapResult out;
  if (first_profiles_ < kFewestProfiles || second_profiles_ < kFewestSecondProfiles) {
    out.missing = std::to_string(first_profiles_) + " profiles of the first 20 degrees and " +
                  std::to_string(second_profiles_) +
                  " beyond the turn are too few to compare; scan with 200 profiles a turn or more";
    return out;
  }
  std::unordered_map<std::uint32_t, RowCurve> curves;
  std::vector<double> scales;
  for (const auto& [row, looks] : first_) {
    // All of the look, or an edge passes through the row.
    if (looks.size() < kFewestProfiles || 10 * looks.size() < 9 * first_profiles_) continue;
    Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
    Vector right = Vector::Zero();
    const double r0 = looks.front().r_mm;
    double squares = 0;
    for (const Look& look : looks) {
      const double x = RowCurve::x_of(look.angle_rad);
      const Vector g(1, x, x * x, x * x * x);
      normal += g * g.transpose();
      right += g * (look.r_mm - r0);
      squares += (look.r_mm - r0) * (look.r_mm - r0);
    }
    RowCurve curve;
    const Eigen::FullPivLU<Eigen::Matrix4d> lu(normal);
    if (!lu.isInvertible()) continue;
    curve.covariance = lu.inverse();
    curve.c = curve.covariance * right;
    curve.square = std::max(0., squares - right.dot(curve.c));
    curve.freedom = static_cast<double>(looks.size()) - 4;
    curve.c[0] += r0;
    scales.push_back(std::sqrt(curve.square / curve.freedom));
    curves.emplace(row, curve);
  }
  const double usual = median(scales);
  double square = 0, freedom = 0;
  for (auto it = curves.begin(); it != curves.end();) {
    if (std::sqrt(it->second.square / it->second.freedom) > kRowScales * usual) {
      it = curves.erase(it);
      continue;
    }
    square += it->second.square, freedom += it->second.freedom;
    ++it;
  }
  std::vector<Pair> all;
  for (const Second& s : again_) {
    const auto curve = curves.find(s.row);
    if (curve != curves.end()) all.push_back({&curve->second, s.look.profile, s.look.angle_rad, s.look.r_mm});
  }
  if (all.size() < kFewestSamples) {
    out.missing = "only " + std::to_string(all.size()) + " samples are seen at both ends of the turn";
    return out;
  }
  out.noise_mm = std::sqrt(square / freedom);
  // What the samples of a profile have in common, next to each other or all of them, shows in their sums. The fit's own
  // figure would be spoilt by the very faults that are looked for.
  std::vector<double> left(first_profiles_);
  double count = 0;
  for (const auto& [row, looks] : first_) {
    const auto curve = curves.find(row);
    if (curve == curves.end()) continue;
    for (const Look& look : looks)
      left[look.profile] += look.r_mm - curve->second.value(RowCurve::x_of(look.angle_rad));
    count += curve->second.freedom;
  }
  double left_square = 0;
  for (const double sum : left) left_square += sum * sum;
  const double kappa = std::max(1., left_square / (count * out.noise_mm * out.noise_mm));
  const auto from_noise = [&](double ss) { return out.noise_mm * std::sqrt(kappa / ss); };

  // Along r.
  std::vector<double> differences;
  for (const Pair& p : all)
    if (seen(p.angle_rad)) differences.push_back(p.r_mm - p.curve->value(RowCurve::x_of(p.angle_rad)));
  if (differences.size() < kFewestSamples) {
    out.missing = "the profiles beyond the turn lie at no angle of its beginning";
    return out;
  }
  std::vector<Sums> sums(second_profiles_);
  std::vector<Pair> pairs = without_outliers(all, 0, median(differences));
  for (const Pair& p : pairs) {
    Sums& s = sums[p.profile];
    s.ss += 1, s.n += 1, s.se += p.r_mm - p.curve->value(RowCurve::x_of(p.angle_rad));
  }
  out.samples = pairs.size();
  const Estimate shift = estimate_of(sums);
  out.shift_mm = shift.x;
  out.shift_u_mm = std::max(shift.u, from_noise(static_cast<double>(pairs.size()))) *
                   std::sqrt(both_by_second(pairs, 0, second_profiles_));
  // By a turn: from the best of a fine grid on, since one of several degrees is far from linear.
  constexpr double kStep_rad = 0.1 * std::numbers::pi / 180;
  double turn = 0, least = mean_square(all, 0).value_or(std::numeric_limits<double>::infinity());
  const int last = static_cast<int>(kFirstLook_rad / kStep_rad);
  for (int k = -static_cast<int>(last_beyond_rad_ / kStep_rad); k <= last; ++k) {
    const double d = k * kStep_rad;
    const auto there = mean_square(all, d);
    if (there && *there < least) least = *there, turn = d;
  }
  Estimate step;
  double steepness = 0;
  for (int round = 0; round < 5; ++round) {
    pairs = without_outliers(all, turn, 0);
    std::fill(sums.begin(), sums.end(), Sums{});
    steepness = 0;
    for (const Pair& p : pairs) {
      const double x = RowCurve::x_of(p.angle_rad + turn), slope = p.curve->slope(x);
      const double e = p.r_mm - p.curve->value(x);
      Sums& s = sums[p.profile];
      s.ss += slope * slope, s.se += slope * e, s.n += 1;
      // Noise makes slopes too.
      steepness += slope * slope - out.noise_mm * out.noise_mm * kappa * p.curve->slope_variance(x);
    }
    if (pairs.size() < kFewestSamples || !(steepness > 0)) {
      out.turn_u_rad = std::numeric_limits<double>::infinity();
      out.cause = OverlapResult::Cause::shift;
      return out;
    }
    step = estimate_of(sums);
    if (std::abs(step.x) > 10 * kStep_rad) break;
    turn += step.x;
  }
  out.turn_rad = turn;
  out.turn_u_rad = std::max(step.u, from_noise(steepness)) * std::sqrt(both_by_second(pairs, turn, second_profiles_));
  out.cause = cause_of(all, out, std::sqrt(kappa) * out.noise_mm, second_profiles_);
  return out;
}

}  // namespace celadon
