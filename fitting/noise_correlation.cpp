#include "fitting/noise_correlation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

namespace celadon {
namespace {
constexpr double kSmallestCorrelation = 0.03;
constexpr double kMostTaken = 0.3;
constexpr std::size_t kLineSamples = 1 << 18;  // along the line, more samples than this add nothing

// The power of a correlated line over the frequencies up to one cycle in 2 `step` samples, on average; white: 1.
double mean_power(const std::vector<double>& rho, double step) {
  double power = rho.front();
  for (std::size_t k = 1; k < rho.size(); ++k) {
    const double x = std::numbers::pi * static_cast<double>(k) / step;
    power += 2 * rho[k] * std::sin(x) / x;
  }
  return power;
}

// Of the lowest frequencies.
double power_of(const std::vector<double>& rho) {
  return 2 * std::accumulate(rho.begin(), rho.end(), 0.0) - rho.front();
}

}  // namespace

double Inflation::mean(double unknowns, double around) const {
  double finer = 1;
  if (along.size() > 1 && rows > 0)
    finer = mean_power(along, std::max(1.0, rows * around / unknowns)) / power_of(along);
  return within * finer + common * around / unknowns;
}

NoiseCorrelation::NoiseCorrelation(const Setting& setting) : setting_(setting) {
  stride_ = std::max<std::size_t>(1, setting.samples / kLineSamples);
  // Four cells an unknown, so that the fit can take up a quarter of their means at most; three samples a cell at least.
  const double cells = std::clamp(4.0 * setting.unknowns, 16.0,
                                  std::max(16.0, std::min(65536.0, static_cast<double>(setting.samples) / 3)));
  const int around = std::max(4, 2 * setting.unknowns_around);
  cells_v_ = std::min(around, static_cast<int>(cells));
  cells_z_ = std::max(1, static_cast<int>(cells / cells_v_));
}

// Of the part of the variance above `plateau`, a covariance that all lags share. What the fit, a low pass, has taken up
// is missing at lag 0 and at lags up to `reach`.
std::vector<double> NoiseCorrelation::Lags::correlations(double plateau, double taken, double reach) const {
  if (!(count[0] > 0) || !(sum[0] > 0)) return {1};
  const double variance = sum[0] / count[0] / (1 - taken);
  std::vector<double> rho{1 - plateau / variance};
  for (std::size_t k = 1; k < kLags; ++k) {
    if (!(count[k] > 0)) break;
    const double x = std::numbers::pi * static_cast<double>(k) / reach;
    const double back = x < std::numbers::pi ? taken * variance * std::sin(x) / x : 0;
    const double next = (sum[k] / count[k] - plateau + back) / variance;
    // A correlation that its own scatter explains is none.
    if (next < std::max(kSmallestCorrelation, 3 / std::sqrt(count[k]))) break;
    rho.push_back(next);
  }
  return rho;
}

// What the errors of a line have in common, however far apart: the covariance of its longest lags. 0: none.
double NoiseCorrelation::Lags::plateau() const {
  double far = 0, pairs = 0;
  for (std::size_t k = kLags / 2; k < kLags; ++k) far += sum[k], pairs += count[k];
  if (!(count[0] > 0) || !(pairs > 0)) return 0;
  const double variance = sum[0] / count[0], common = std::min(far / pairs, variance);
  return common > std::max(kSmallestCorrelation, 3 / std::sqrt(pairs)) * variance ? common : 0;
}

void NoiseCorrelation::add(const Profile& profile, const double* v, const double* residual) {
  double sum = 0, square = 0, count = 0;
  for (std::size_t k = 0; k < profile.size(); ++k) {
    if (std::isnan(residual[k])) continue;
    sum += residual[k];
    square += residual[k] * residual[k];
    ++count;
  }
  if (count == 0) return;
  if (profile.order == ProfileOrder::scattered) {
    scattered_square_ += square;
    scattered_count_ += count;
    add_cells(profile, v, residual);
    return;
  }
  square_ += square;
  count_ += count;
  mean_square_ += sum * sum / count;
  ++profiles_with_mean_;
  if (lines_++ % stride_ == 0) add_line(profile, residual);
  add_slots(profile, residual);
}

void NoiseCorrelation::Lags::merge(const Lags& other) {
  for (std::size_t k = 0; k < kLags; ++k) sum[k] += other.sum[k], count[k] += other.count[k];
}

// Pairs of profiles on both sides of the seam are not among those that count.
void NoiseCorrelation::merge(const NoiseCorrelation& later) {
  along_.merge(later.along_);
  across_.merge(later.across_);
  square_ += later.square_;
  count_ += later.count_;
  mean_square_ += later.mean_square_;
  profiles_with_mean_ += later.profiles_with_mean_;
  scattered_square_ += later.scattered_square_;
  scattered_count_ += later.scattered_count_;
  if (cell_sum_.size() < later.cell_sum_.size()) {
    cell_sum_.resize(later.cell_sum_.size());
    cell_count_.resize(later.cell_count_.size());
  }
  for (std::size_t k = 0; k < later.cell_sum_.size(); ++k) {
    cell_sum_[k] += later.cell_sum_[k];
    cell_count_[k] += later.cell_count_[k];
  }
}

void NoiseCorrelation::add_line(const Profile& profile, const double* residual) {
  const std::size_t n = profile.size();
  const auto row = [&](std::size_t k) -> std::size_t { return profile.row.empty() ? k : profile.row[k]; };
  std::size_t first = std::numeric_limits<std::size_t>::max(), last = 0;
  for (std::size_t k = 0; k < n; ++k) {
    first = std::min(first, row(k));
    last = std::max(last, row(k));
  }
  const std::size_t length = last - first + 1;
  line_.assign(2 * length, 0.0);  // values, then 1 where there is one
  for (std::size_t k = 0; k < n; ++k) {
    if (std::isnan(residual[k])) continue;
    line_[row(k) - first] = residual[k];
    line_[length + row(k) - first] = 1;
  }
  for (std::size_t lag = 0; lag < kLags && lag < length; ++lag) {
    double sum = 0, count = 0;
    for (std::size_t k = 0; k + lag < length; ++k) {
      sum += line_[k] * line_[k + lag];
      count += line_[length + k] * line_[length + k + lag];
    }
    along_.sum[lag] += sum;
    along_.count[lag] += count;
  }
}

// At fixed heights, the sample nearest to each, against the same height in the profiles before.
void NoiseCorrelation::add_slots(const Profile& profile, const double* residual) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  auto [entry, fresh] = lasers_.try_emplace(profile.laser);
  Laser& laser = entry->second;
  if (fresh)
    for (auto& slot : laser.history) slot.fill(kNone);
  const std::size_t now = laser.profiles++ % kLags;
  std::array<double, kSlots> distance;
  distance.fill(1.5 * kSlots / static_cast<double>(profile.size()));  // in slots: one and a half sample spacings
  for (auto& slot : laser.history) slot[now] = kNone;
  const double scale = kSlots / (setting_.z_end_mm - setting_.z_start_mm);
  for (std::size_t k = 0; k < profile.size(); ++k) {
    if (std::isnan(residual[k])) continue;
    const double x = (profile.z_mm[k] - setting_.z_start_mm) * scale;
    if (!(x >= 0 && x < kSlots)) continue;
    const auto slot = static_cast<std::size_t>(x);
    const double away = std::abs(x - static_cast<double>(slot) - 0.5);
    if (away >= distance[slot]) continue;
    distance[slot] = away;
    laser.history[slot][now] = residual[k];
  }
  for (const auto& slot : laser.history) {
    if (std::isnan(slot[now])) continue;
    for (std::size_t lag = 0; lag < kLags && lag < laser.profiles; ++lag) {
      const double before = slot[(now + kLags - lag) % kLags];
      if (std::isnan(before)) continue;
      across_.sum[lag] += slot[now] * before;
      across_.count[lag] += 1;
    }
  }
}

void NoiseCorrelation::add_cells(const Profile& profile, const double* v, const double* residual) {
  if (cell_sum_.empty()) {
    cell_sum_.assign(static_cast<std::size_t>(cells_z_) * static_cast<std::size_t>(cells_v_), 0.0);
    cell_count_ = cell_sum_;
  }
  const double z_scale = cells_z_ / (setting_.z_end_mm - setting_.z_start_mm), v_scale = cells_v_ / setting_.arcs;
  for (std::size_t k = 0; k < profile.size(); ++k) {
    if (std::isnan(residual[k])) continue;
    const int i = std::clamp(static_cast<int>((profile.z_mm[k] - setting_.z_start_mm) * z_scale), 0, cells_z_ - 1);
    const int j = std::clamp(static_cast<int>(v[k] * v_scale), 0, cells_v_ - 1);
    const auto at = static_cast<std::size_t>(j * cells_z_ + i);
    cell_sum_[at] += residual[k];
    cell_count_[at] += 1;
  }
}

// Means of cells have the variance kappa sigma^2 / n; the fit has taken up as many of their degrees as it has unknowns.
double NoiseCorrelation::scattered_kappa() const {
  double means = 0, cells = 0;
  for (std::size_t k = 0; k < cell_sum_.size(); ++k) {
    if (cell_count_[k] == 0) continue;
    means += cell_sum_[k] * cell_sum_[k] / cell_count_[k];
    ++cells;
  }
  const double free = cells - setting_.unknowns;
  if (free < 8 || !(scattered_square_ > 0)) return 1;
  const double variance = scattered_square_ / std::max(1.0, scattered_count_ - setting_.unknowns);
  const double kappa = means / free / variance, scatter = std::sqrt(2 / free);
  return kappa > 1 + 3 * scatter ? kappa : 1;
}

Inflation NoiseCorrelation::inflation(double lack_of_fit) const {
  if (scattered_count_ > count_) return {.within = scattered_kappa()};
  // Relative to the variance of the errors alone.
  const double share = std::clamp(lack_of_fit, 0.0, 0.99);
  // Steps of an interval along a line, and of one around.
  const double around = setting_.unknowns_around, lines = std::max(profiles_with_mean_, 1.0),
               rows = count_ / lines * around / setting_.unknowns, profiles = lines / around;
  Inflation result;
  double along = 1, across = 1, taken = 0;
  for (int k = 0; k < 4; ++k) {  // what is taken up grows with the inflation
    result.along = along_.correlations(std::max(along_.plateau(), share * along_.variance()), taken, rows);
    along = power_of(result.along) / (1 - share);
    across = power_of(across_.correlations(share * across_.variance(), taken, profiles)) / (1 - share);
    const double finer = mean_power(result.along, std::max(1.0, rows)) / power_of(result.along);
    taken = std::min(kMostTaken, along * across * finer * setting_.unknowns / count_);
  }
  const double free = profiles_with_mean_ - setting_.unknowns_around;
  double between = along;
  if (free >= 8 && square_ > 0) between = mean_square_ / free / (square_ / count_ / (1 - taken) * (1 - share));
  const bool common = between > along * (1 + 3 * std::sqrt(2 / std::max(free, 1.0)));
  result.within = along * across;
  result.common = common ? (between - along) * across : 0;
  result.rows = count_ / lines;
  return result;
}

}  // namespace celadon
