#include "daemon/checks/profile_jitter.h"

#include <algorithm>
#include <cmath>

#include "daemon/checks/spread.h"

namespace celadon {
namespace {

constexpr std::size_t kFewestCompared = 60, kFewestRows = 64;
constexpr double kUnequal = 1.5;   // of the angles between profiles; more: a frame was lost, or a turn began
constexpr double kEdgeScales = 3;  // rows that are off by more than this times the robust scale are edges
constexpr std::size_t kBlocks = 16;

/// Weights of the four neighbours in the cubic through them, at the middle one's angle (Lagrange).
template <std::size_t Count>
std::array<double, Count> weights_at_middle(const std::array<double, Count>& x) {
  std::array<double, Count> weight{};
  constexpr std::size_t kMiddle = Count / 2;
  for (std::size_t i = 0; i < Count; ++i) {
    if (i == kMiddle) continue;
    weight[i] = 1;
    for (std::size_t j = 0; j < Count; ++j)
      if (j != i && j != kMiddle) weight[i] *= (x[kMiddle] - x[j]) / (x[i] - x[j]);
  }
  return weight;
}

}  // namespace

void ProfileJitter::add(const Profile& profile) {
  if (profile.row.empty()) return;
  std::rotate(window_.begin(), window_.begin() + 1, window_.end());
  Line& line = window_.back();
  line.laser = profile.laser;
  line.angle_rad = profile.table_angle_rad;
  line.r_mm.assign(*std::max_element(profile.row.begin(), profile.row.end()) + std::size_t{1},
                   std::numeric_limits<double>::quiet_NaN());
  for (std::size_t k = 0; k < profile.size(); ++k) line.r_mm[profile.row[k]] = profile.r_mm[k];
  compare();
}

void ProfileJitter::compare() {
  std::array<double, kWindow> angle{};
  double nearest = std::numeric_limits<double>::infinity(), farthest = 0;
  std::size_t rows = window_.front().r_mm.size();
  for (std::size_t i = 0; i < kWindow; ++i) {
    angle[i] = window_[i].angle_rad;
    rows = std::min(rows, window_[i].r_mm.size());
    if (window_[i].laser != window_.front().laser || std::isnan(angle[i])) return;
    if (i == 0) continue;
    nearest = std::min(nearest, std::abs(angle[i] - angle[i - 1]));
    farthest = std::max(farthest, std::abs(angle[i] - angle[i - 1]));
  }
  if (!(farthest <= kUnequal * nearest)) return;
  const std::array<double, kWindow> weight = weights_at_middle(angle);
  double variance = 1;
  for (const double w : weight) variance += w * w;

  off_mm_.clear();
  for (std::size_t row = 0; row < rows; ++row) {
    double off = window_[kMiddle].r_mm[row];
    for (std::size_t i = 0; i < kWindow; ++i)
      if (i != kMiddle) off -= weight[i] * window_[i].r_mm[row];
    if (!std::isnan(off)) off_mm_.push_back(off);
  }
  if (off_mm_.size() < kFewestRows) return;
  const double middle = median(off_mm_);
  const double most = kEdgeScales * robust_deviation(off_mm_, middle);
  std::erase_if(off_mm_, [&](double off) { return std::abs(off - middle) > most; });
  if (off_mm_.size() < kFewestRows) return;

  // Neighbouring rows may err alike; the means of whole blocks hardly do.
  double mean = 0, square = 0;
  for (std::size_t block = 0; block < kBlocks; ++block) {
    const std::size_t first = block * off_mm_.size() / kBlocks, end = (block + 1) * off_mm_.size() / kBlocks;
    double sum = 0;
    for (std::size_t k = first; k < end; ++k) sum += off_mm_[k];
    const double of_block = sum / static_cast<double>(end - first);
    mean += of_block / kBlocks, square += of_block * of_block / kBlocks;
  }
  common_mm_.push_back(mean / std::sqrt(variance));
  noise_mm2_.push_back(std::max(0., square - mean * mean) / (kBlocks - 1) / variance);
}

std::optional<JitterResult> ProfileJitter::result() const {
  if (common_mm_.size() < kFewestCompared) return std::nullopt;
  JitterResult result;
  result.profiles = common_mm_.size();
  result.mm = robust_deviation(common_mm_, 0);
  result.noise_mm = std::sqrt(median(noise_mm2_));
  // A median of sizes knows a standard deviation within 1.17 / sqrt(n) of it; neighbours share samples.
  result.u_mm = result.noise_mm * 1.17 * std::sqrt(2 / static_cast<double>(result.profiles));
  return result;
}

}  // namespace celadon
