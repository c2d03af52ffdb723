#pragma once
// Do the lasers agree? Where two of them saw the same place of the object, what they say of its radius is compared. A
// plane that left its calibration, or an object that moved between two turns, shows as a difference.

#include <array>
#include <cstddef>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "daemon/report.h"
#include "fitting/moment_grid.h"
#include "fitting/profile.h"

namespace celadon {

/// Gathers the samples of each laser in cells of (theta, z) while the table turns. In each cell that two lasers saw, r
/// is a plane over (theta, z), the same for both but for its height; the difference of the heights is what they
/// disagree by. Source: analysis of covariance with a common slope, e.g. Draper & Smith, Applied Regression Analysis,
/// ch. 14.
class LaserAgreement {
 public:
  /// @param band      heights that are compared
  /// @param lasers    of the scan; with one there is nothing to do
  /// @param profiles  a turn: cells are so wide that each laser has some in every cell
  LaserAgreement(const GridSpecification& band, std::span<const int> lasers, int profiles);

  /// Samples outside the band are passed over.
  void add(const Profile& profile) { add(profile, profile.laser); }
  /// The same of whatever was seen in several ways, `way` being one of the numbers given as lasers.
  void add(const Profile& profile, int way);

  /// Of the two lasers that disagree most for their standard error; nullopt unless two saw 16 cells in common.
  std::optional<AgreementError> result() const;

 private:
  /// Sums over the samples of one laser in one cell; a and h count from the cell's middle in widths of a cell.
  struct Cell {
    double n = 0, a = 0, h = 0, r = 0, aa = 0, ah = 0, hh = 0, ar = 0, hr = 0, rr = 0;
  };
  struct Difference {
    double mm = 0, variance_mm2 = 0, scatter_mm2 = 0;  ///< scatter: of the samples about their plane
    double theta_rad = 0, height = 0;                  ///< of the cell's middle; height -1 .. 1 over the band
  };
  std::optional<Difference> difference(const std::vector<Cell>& first, const std::vector<Cell>& second,
                                       std::size_t cell) const;
  std::optional<AgreementError> compare(int first, int second) const;
  void add_around(const std::vector<Difference>& seen, AgreementError& error) const;

  double z_start_mm_, z_end_mm_;
  int around_, along_;
  std::map<int, std::vector<Cell>> cells_;  ///< by laser, heights inside; empty with one laser
};

/// What lasers that differ are suspected of, by how the difference lies over the object, and what to do.
struct AgreementCause {
  std::string cause, remedy;
};
AgreementCause cause_of(const AgreementError& agreement);

}  // namespace celadon
