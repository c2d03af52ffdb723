#include "fitting/coverage.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace celadon {
namespace {

// z cells are judged in groups large enough to hold samples of an even scan in every sector.
constexpr double kSamplesPerBin = 16;
// A bin with less than this share of the usual count holds stray samples, not the object.
constexpr double kStrayShare = 0.05;

// A gap at a pole is closed if it is no wider than the cells, or if so few samples would lie in it, were they as dense
// as around it, that a sector has none by chance.
constexpr double kGapCells = 1.5, kExpectedInSector = 10;

void close_poles(const MomentGrid& sums, const Eigen::VectorXd& row_count, CoveredBand& band) {
  const BaseArcs& meridian = BaseSurface::meridian();
  const int nz = sums.z_cells();
  const double cell = BaseSurface::kMeridianEnd / nz;
  const auto closes = [&](double gap_w, bool south) {
    if (gap_w <= kGapCells * cell) return true;
    const double gap = meridian.theta_of_v(gap_w), far = meridian.theta_of_v(std::min(2 * gap_w, 1.0));
    double around = 0;
    for (int i = 0; i < nz; ++i) {
      const double middle = (i + 0.5) * cell;
      if (middle > gap_w && middle < 2 * gap_w) around += row_count[south ? nz - 1 - i : i];
    }
    const double cap = 1 - std::cos(gap), ring = std::cos(gap) - std::cos(far);
    return ring > 0 && around * cap / ring / band.sectors < kExpectedInSector;
  };
  band.cells.poles.start = closes(band.z_start_mm, false);
  band.cells.poles.end = closes(BaseSurface::kMeridianEnd - band.z_end_mm, true);
  if (band.cells.poles.start) band.cells.first = 0, band.z_start_mm = 0;
  if (band.cells.poles.end) band.cells.last = nz, band.z_end_mm = BaseSurface::kMeridianEnd;
}

int sector_count(const MomentGrid& sums) {
  return std::min(SectorExtents::kSectors, sums.v_cells());
}

}  // namespace

SectorExtents::SectorExtents(const MomentGrid& sums)
    : z_start_(sums.specification().z_start_mm),
      z_scale_(sums.z_cells() / (sums.specification().z_end_mm - sums.specification().z_start_mm)),
      v_scale_(static_cast<double>(sector_count(sums)) / sums.arcs().count()),
      z_cells_(sums.z_cells()),
      lowest_(static_cast<std::size_t>(z_cells_ * kSectors), std::numeric_limits<double>::infinity()),
      highest_(lowest_.size(), -std::numeric_limits<double>::infinity()) {}

void SectorExtents::add(double v, double z_mm) {
  const int row = std::clamp(static_cast<int>((z_mm - z_start_) * z_scale_), 0, z_cells_ - 1);
  const int sector = std::clamp(static_cast<int>(v * v_scale_), 0, kSectors - 1);
  const std::size_t at = index(row, sector);
  lowest_[at] = std::min(lowest_[at], z_mm);
  highest_[at] = std::max(highest_[at], z_mm);
}

void SectorExtents::merge(const SectorExtents& other) {
  for (std::size_t k = 0; k < lowest_.size(); ++k) {
    lowest_[k] = std::min(lowest_[k], other.lowest_[k]);
    highest_[k] = std::max(highest_[k], other.highest_[k]);
  }
}

CoveredBand find_covered_band(const MomentGrid& sums, const SectorExtents* extents) {
  CoveredBand band;
  const int nz = sums.z_cells(), sectors = sector_count(sums), per_sector = sums.v_cells() / sectors;
  const bool spherical = sums.specification().base == BaseKind::sphere;
  band.sectors = sectors;
  band.base = sums.specification().base;
  const MomentLayout& layout = sums.layout();
  // Weight and first moment along z of each (row, sector).
  Eigen::MatrixXd count = Eigen::MatrixXd::Zero(nz, sectors), first = count;
  int used_rows = 0;
  for (int i = 0; i < nz; ++i) {
    for (int j = 0; j < sums.v_cells(); ++j) {
      count(i, j / per_sector) += sums.cell(i, j)[layout.weight(0, 0)];
      first(i, j / per_sector) += sums.cell(i, j)[layout.weight(1, 0)];
    }
    used_rows += count.row(i).sum() > 0;
  }
  const double total = count.sum();
  if (!(total > 0)) return band;

  int group = 1;
  while (group < nz && total / (static_cast<double>(used_rows) / group * sectors) < kSamplesPerBin) group *= 2;
  const int rows = nz / group;
  Eigen::MatrixXd bins = Eigen::MatrixXd::Zero(rows, sectors);
  for (int i = 0; i < nz; ++i) bins.row(i / group) += count.row(i);
  std::vector<double> filled;
  for (Eigen::Index k = 0; k < bins.size(); ++k)
    if (bins.data()[k] > 0) filled.push_back(bins.data()[k]);
  std::nth_element(filled.begin(), filled.begin() + static_cast<std::ptrdiff_t>(filled.size() / 2), filled.end());
  const double usual = filled[filled.size() / 2], needed = kStrayShare * usual;
  // Towards a pole of a sphere the cells become smaller.
  const auto size = [&](int row) {
    return spherical ? std::sin(BaseSurface::meridian().theta_of_v(sums.z_edge_mm(row * group) / 2 +
                                                                   sums.z_edge_mm((row + 1) * group) / 2))
                     : 1.0;
  };
  const auto covered = [&](int row, int sector) {
    return bins(row, sector) > 0 && bins(row, sector) >= needed * size(row);
  };

  int occupied = 0;
  for (int row = 0; row < rows; ++row) {
    bool any = false;
    for (int s = 0; s < sectors; ++s) any = any || covered(row, s);
    occupied += any;
  }
  std::vector<bool> active(static_cast<std::size_t>(sectors));
  for (int s = 0; s < sectors; ++s) {
    int covered_rows = 0;
    for (int row = 0; row < rows; ++row) covered_rows += covered(row, s);
    active[static_cast<std::size_t>(s)] = 2 * covered_rows >= occupied && covered_rows > 0;
    band.sectors_with_samples += active[static_cast<std::size_t>(s)];
  }
  int lo = rows, hi = -1;
  for (int row = 0; row < rows; ++row) {
    bool all = band.sectors_with_samples > 0;
    for (int s = 0; s < sectors; ++s) all = all && (!active[static_cast<std::size_t>(s)] || covered(row, s));
    if (!all) continue;
    lo = std::min(lo, row);
    hi = std::max(hi, row);
  }
  band.lowest_mm = std::numeric_limits<double>::infinity();
  band.highest_mm = -band.lowest_mm;
  const auto cell_extent = [&](int i, int s, double& low, double& high) {
    if (extents) {
      low = extents->lowest(i, s), high = extents->highest(i, s);
      return;
    }
    // Samples spread evenly from the rim to the far edge of its cell have their mean half-way.
    const double bottom = sums.z_edge_mm(i), top = sums.z_edge_mm(i + 1), half = (top - bottom) / 2;
    const double mean = (bottom + top) / 2 + half * first(i, s) / count(i, s);
    low = std::clamp(2 * mean - top, bottom, top);
    high = std::clamp(2 * mean - bottom, bottom, top);
  };
  for (int i = 0; i < nz; ++i)
    for (int s = 0; s < sectors; ++s) {
      if (!covered(i / group, s) || count(i, s) == 0) continue;
      double low = 0, high = 0;
      cell_extent(i, s, low, high);
      band.lowest_mm = std::min(band.lowest_mm, low);
      band.highest_mm = std::max(band.highest_mm, high);
    }
  if (lo > hi) return band;

  band.z_start_mm = -std::numeric_limits<double>::infinity();
  band.z_end_mm = std::numeric_limits<double>::infinity();
  for (int s = 0; s < sectors; ++s) {
    if (!active[static_cast<std::size_t>(s)]) continue;
    int i = lo * group, k = (hi + 1) * group - 1;
    while (count(i, s) == 0) ++i;
    while (count(k, s) == 0) --k;
    double low = 0, high = 0, unused = 0;
    cell_extent(i, s, low, unused);
    cell_extent(k, s, unused, high);
    band.z_start_mm = std::max(band.z_start_mm, low);
    band.z_end_mm = std::min(band.z_end_mm, high);
  }
  if (!(band.z_start_mm < band.z_end_mm)) return band;
  const auto& spec = sums.specification();
  const double scale = nz / (spec.z_end_mm - spec.z_start_mm);
  const int a = std::clamp(static_cast<int>((band.z_start_mm - spec.z_start_mm) * scale), 0, nz - 1);
  const int b = std::clamp(static_cast<int>(std::ceil((band.z_end_mm - spec.z_start_mm) * scale)), a + 1, nz);
  band.cells = {a, b};
  if (spherical && sums.arcs().closed()) close_poles(sums, count.rowwise().sum(), band);
  return band;
}

double covered_share(const MomentGrid& sums, const CoveredBand& band) {
  const int nz = band.cells.last - band.cells.first, nv = sums.v_cells();
  double total = 0;
  for (int j = 0; j < nv; ++j)
    for (int i = band.cells.first; i < band.cells.last; ++i) total += sums.cell_weight(i, j);
  int du = 1, dv = 1;
  while (total < 10.0 * nz * nv / (du * dv) && (du < nz || dv < nv)) {
    if ((dv <= du && dv < nv) || du >= nz) {
      dv *= 2;
    } else {
      du *= 2;
    }
  }
  const auto size = [&](int row) {
    if (sums.specification().base != BaseKind::sphere) return 1.0;
    const auto& meridian = BaseSurface::meridian();
    return std::cos(meridian.theta_of_v(sums.z_edge_mm(row))) - std::cos(meridian.theta_of_v(sums.z_edge_mm(row + 1)));
  };
  double covered = 0, all = 0;
  for (int j = 0; j < nv; j += dv)
    for (int i = band.cells.first; i < band.cells.last; i += du) {
      const int last = std::min(i + du, band.cells.last);
      double weight = 0, area = 0;
      for (int ii = i; ii < last; ++ii) {
        area += size(ii);
        for (int jj = j; jj < j + dv; ++jj) weight += sums.cell_weight(ii, jj);
      }
      all += area;
      covered += weight > 0 ? area : 0;
    }
  return all > 0 ? covered / all : 0;
}

}  // namespace celadon
