#pragma once
// celadon fit on a grid file: the whole input, or its sums alone.

#include <memory>
#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "daemon/files/cloud_files.h"
#include "daemon/grid_file.h"
#include "fitting/range_fit.h"
#include "fitting/spherical_stream.h"

namespace celadon::cli {

/// The frame in a file whose z axis is that axis of the file.
Eigen::Isometry3d frame_about(Axis axis);
/// A grid for the samples of an input in the frame X_FL of it; `options` of the base. Errors: one sentence.
tl::expected<SumsGrid, std::string> choose_sums_grid(const std::string& input, const Eigen::Isometry3d& X_FL,
                                                     double millimetres_per_unit, const RangeFitOptions& options);

/// An input as the samples of a grid.
struct GridInput {
  SumsGrid grid;
  std::unique_ptr<CloudFile> samples;
  std::unique_ptr<SphericalStream> spherical;  ///< of a grid over a sphere
  ProfileStream& stream() { return spherical ? static_cast<ProfileStream&>(*spherical) : *samples; }
};

/// `named_unit`: as on the command line, if it was; it has to be the grid's. Errors: one sentence.
tl::expected<GridInput, std::string> open_on_grid(const std::string& input, const std::string& grid_file,
                                                  const std::optional<std::string>& named_unit);

/// Writes the sums of an input. @returns the exit code
int write_part(GridInput& input, const std::string& name, const std::string& output);

/// The surface of an input on its grid, with all passes over the samples; in the input's frame. `options` of the grid's
/// base and degrees. Errors: one sentence.
tl::expected<RangeFit, std::string> fit_on_grid(GridInput& input, RangeFitOptions options);

/// Options that a grid fixes: base, arcs and degrees.
void take_from_grid(const SumsGrid& grid, RangeFitOptions& options);

}  // namespace celadon::cli
