#pragma once
// The grid that several reductions share, so that their sums can be added. Grammar: PARTIAL_SUMS.md.

#include <Eigen/Geometry>
#include <filesystem>
#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "fitting/moment_grid.h"

namespace celadon {

struct SumsGrid {
  GridSpecification cells;
  Eigen::Isometry3d X_FL = Eigen::Isometry3d::Identity();  ///< frame of the sums in the inputs' frame (mm)
  double millimetres_per_unit = 1;                         ///< of the inputs' coordinates
  WeightRule weights = WeightRule::unit;
};

/// Text of a grid file; every number reads back as the same double.
std::string format_grid(const SumsGrid& grid);
/// The inverse, checked field by field. Errors: one sentence with `source`, field, value and remedy.
tl::expected<SumsGrid, std::string> parse_grid(const std::string& text, const std::string& source);
tl::expected<SumsGrid, std::string> read_grid(const std::filesystem::path& file);

/// What sums over the grids cannot be added for, with both values, as "A has ..., B has ..."; nullopt: they can.
std::optional<std::string> difference(const SumsGrid& a, const std::string& name_a, const SumsGrid& b,
                                      const std::string& name_b);

}  // namespace celadon
