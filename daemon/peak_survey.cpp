#include "daemon/peak_survey.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

namespace celadon {
namespace {

constexpr double kLeftShare = 0.05;  // of the rows of a sector

}  // namespace

double PeakHistogram::middle_of(std::size_t bin) {
  return std::exp2((static_cast<double>(bin) + 0.5) / kBinsPerOctave + kLowest_octave);
}

void PeakHistogram::add(double levels_per_ms, double weight) {
  if (!(levels_per_ms > 0)) return;
  const double bin = (std::log2(levels_per_ms) - kLowest_octave) * kBinsPerOctave;
  bins_[static_cast<std::size_t>(std::clamp(bin, 0., static_cast<double>(kBins - 1)))] += weight;
}

void PeakHistogram::add(const PeakHistogram& other, double weight) {
  for (std::size_t k = 0; k < kBins; ++k) bins_[k] += weight * other.bins_[k];
}

double PeakHistogram::weight() const {
  return std::accumulate(bins_.begin(), bins_.end(), 0.);
}

double PeakHistogram::quantile(double share) const {
  const double wanted = share * weight();
  double below = 0;
  std::size_t bin = 0;
  while (bin + 1 < kBins && (below += bins_[bin]) < wanted) ++bin;
  return std::exp2((static_cast<double>(bin) + 1) / kBinsPerOctave + kLowest_octave);
}

double PeakHistogram::darker_than(double levels_per_ms) const {
  double sum = 0;
  for (std::size_t k = 0; k < kBins && middle_of(k) < levels_per_ms; ++k) sum += bins_[k];
  return sum;
}

PeakHistogram PeakHistogram::darker_part(double levels_per_ms) const {
  PeakHistogram part;
  for (std::size_t k = 0; k < kBins && middle_of(k) < levels_per_ms; ++k) part.bins_[k] = bins_[k];
  return part;
}

std::size_t PeakSurvey::sector_of(double turn_rad) {
  double turns = turn_rad / (2 * std::numbers::pi);
  turns -= std::floor(turns);
  return std::min(static_cast<std::size_t>(turns * kSectors), kSectors - 1);
}

void PeakSurvey::begin_pass(double exposure_ms, double room_levels) {
  passes_.push_back({exposure_ms, std::min(kBrightest, std::max(kTop - room_levels, 1.)), {}});
}

void PeakSurvey::see(std::span<const LineRow> rows, const Profile& profile, double turn_rad) {
  Pass& pass = passes_.back();
  Sector& sector = pass.sectors[sector_of(turn_rad)];
  sector.profiles += 1;
  // What the pass before could tell is told.
  const bool first = passes_.size() == 1;
  const double told = first ? 0 : passes_[passes_.size() - 2].brightest / passes_[passes_.size() - 2].exposure_ms;
  for (const std::uint16_t row : profile.row) {
    const LineRow& line = rows[row];
    const double levels_per_ms = static_cast<double>(line.amplitude) / pass.exposure_ms;
    if (levels_per_ms <= told) continue;
    const bool left = line.status == RowStatus::saturated || static_cast<double>(line.amplitude) > pass.brightest;
    (left ? sector.too_bright : sector.peaks).add(levels_per_ms, 1);
  }
}

bool PeakSurvey::asks_for_another() const {
  const Pass& last = passes_.back();
  const auto all = reading();
  for (std::size_t k = 0; k < kSectors; ++k) {
    const Sector& sector = last.sectors[k];
    if (sector.profiles > 0 && sector.too_bright.weight() / sector.profiles > kLeftShare * all[k].weight()) return true;
  }
  return false;
}

std::array<PeakHistogram, PeakSurvey::kSectors> PeakSurvey::reading() const {
  std::array<PeakHistogram, kSectors> out;
  for (const Pass& pass : passes_) {
    for (std::size_t k = 0; k < kSectors; ++k) {
      const Sector& sector = pass.sectors[k];
      if (sector.profiles == 0) continue;
      out[k].add(sector.peaks, 1 / sector.profiles);
      if (&pass == &passes_.back()) out[k].add(sector.too_bright, 1 / sector.profiles);
    }
  }
  return out;
}

}  // namespace celadon
