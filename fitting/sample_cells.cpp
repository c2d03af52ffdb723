#include "fitting/sample_cells.h"

#include <algorithm>
#include <cmath>

namespace celadon {
namespace {
constexpr double kCells = 2048, kSamplesPerCell = 12;
constexpr int kGapColumns = 16;  // more than anything looks ahead
// Mean range, but for a few values that stand for "no reading", such as 1e30, and would make every cell a sliver: with
// these it is far from the median, which is taken then.
double usual_range(const MomentGrid& sums, const std::vector<SamplePoint>& samples) {
  constexpr double kFar = 4;
  const double mean = sums.sum_weight() > 0 ? sums.sum_weighted_range() / sums.sum_weight() : 1;
  if (samples.empty()) return mean;
  std::vector<double> r;
  r.reserve(samples.size());
  for (const SamplePoint& sample : samples) r.push_back(sample.r_mm);
  const auto middle = r.begin() + static_cast<std::ptrdiff_t>(r.size() / 2);
  std::nth_element(r.begin(), middle, r.end());
  return mean < kFar * *middle ? mean : *middle;
}

}  // namespace

const Cluster* SampleCell::accepted() const {
  for (const Cluster& c : clusters)
    if (c.accepted) return &c;
  return nullptr;
}

SampleCells::SampleCells(const MomentGrid& sums, const std::vector<SamplePoint>& samples)
    : spherical_(sums.specification().base == BaseKind::sphere),
      z_start_(sums.specification().z_start_mm),
      z_end_(sums.specification().z_end_mm),
      turn_v_(sums.arcs().count()),
      arc_rad_(sums.arcs().arc_rad()) {
  const double weight = static_cast<double>(std::max<std::size_t>(sums.samples(), 1));
  const double r = usual_range(sums, samples);
  int lowest = sums.z_cells(), highest = 0;
  for (int j = 0; j < sums.v_cells(); ++j)
    for (int i = 0; i < sums.z_cells(); ++i)
      if (sums.cell_weight(i, j) > 0) lowest = std::min(lowest, i), highest = std::max(highest, i + 1);
  const double used = std::max(highest - lowest, 1) / static_cast<double>(sums.z_cells());
  const double height = (z_end_ - z_start_) * used * (spherical_ ? BaseSurface::meridian().arc_rad() * r : 1);
  const double cells = std::clamp(weight / kSamplesPerCell, 1.0, kCells);
  cells_v_ = std::clamp(static_cast<int>(std::sqrt(cells * turn_v_ * arc_rad_ * r / height)), 4, 256);
  cells_z_ = std::clamp(static_cast<int>(cells / cells_v_ / used), 1, 1024);
  cell_height_ = (z_end_ - z_start_) / cells_z_;
  if (!sums.arcs().closed()) {
    turn_v_ *= 1 + static_cast<double>(kGapColumns) / cells_v_;
    cells_v_ += gap_ = kGapColumns;
  }
  cells_.resize(static_cast<std::size_t>(cells_z_) * static_cast<std::size_t>(cells_v_));
  for (const SamplePoint& sample : samples) keep(sample);
}

std::size_t SampleCells::index_of(double v, double z) const {
  const int i = std::clamp(static_cast<int>((z - z_start_) / cell_height_), 0, cells_z_ - 1);
  const int j = std::clamp(static_cast<int>(v * cells_v_ / turn_v_), 0, cells_v_ - 1);
  return index(i, j);
}

double SampleCells::width_mm(double r) const {
  return turn_v_ * arc_rad_ * r / cells_v_;
}

double SampleCells::diagonal_mm(double r) const {
  const double height_mm = spherical_ ? cell_height_ * BaseSurface::meridian().arc_rad() * r : cell_height_;
  return std::hypot(height_mm, width_mm(r));
}

// Each cell keeps an even sample of what falls into it, chosen by a fixed hash of the order of arrival.
void SampleCells::keep(const SamplePoint& sample) {
  const CellPoint p{sample, sample.r_mm};
  SampleCell& cell = cells_[index_of(p.v, p.z_mm)];
  ++cell.seen;
  if (cell.points.size() < kPerCell) {
    cell.points.push_back(p);
    return;
  }
  const std::size_t slot = scrambled(cell.seen) % cell.seen;
  if (slot < kPerCell) cell.points[slot] = p;
}

}  // namespace celadon
