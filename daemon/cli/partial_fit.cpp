#include "daemon/cli/partial_fit.h"

#include <cstdio>
#include <filesystem>
#include <utility>

#include "daemon/cli/commands.h"
#include "daemon/cli/fit_outputs.h"
#include "daemon/files/atomic_file.h"
#include "daemon/partial_sums.h"

namespace celadon::cli {

namespace {

tl::expected<GridInput, std::string> open_samples(const std::string& input, const SumsGrid& grid) {
  CloudOptions cloud;
  cloud.millimetres_per_unit = grid.millimetres_per_unit;
  if (!grid.X_FL.matrix().isIdentity(0)) cloud.X_SF = grid.X_FL.inverse();
  auto samples = open_cloud(input, cloud);
  if (!samples) return tl::make_unexpected(samples.error().message);
  GridInput result{grid, std::move(*samples), nullptr};
  if (grid.cells.base == BaseKind::sphere) result.spherical = std::make_unique<SphericalStream>(*result.samples, 0);
  return result;
}

}  // namespace

Eigen::Isometry3d frame_about(Axis axis) {
  Eigen::Isometry3d X_FL = Eigen::Isometry3d::Identity();
  const int third = axis == Axis::x ? 0 : axis == Axis::y ? 1 : 2;
  for (int k = 0; k < 3; ++k) X_FL.linear().col(k) = Eigen::Vector3d::Unit((third + 1 + k) % 3);
  return X_FL;
}

tl::expected<SumsGrid, std::string> choose_sums_grid(const std::string& input, const Eigen::Isometry3d& X_FL,
                                                     double millimetres_per_unit, const RangeFitOptions& options) {
  SumsGrid grid{{}, X_FL, millimetres_per_unit};
  grid.cells.base = options.base;
  auto opened = open_samples(input, grid);
  if (!opened) return tl::make_unexpected(opened.error());
  const auto cells = choose_grid(opened->stream(), options);
  if (!opened->samples->error().empty()) return tl::make_unexpected(opened->samples->error());
  if (!cells) return tl::make_unexpected(cells.error().message);
  grid.cells = *cells;
  return grid;
}

tl::expected<GridInput, std::string> open_on_grid(const std::string& input, const std::string& grid_file,
                                                  const std::optional<std::string>& named_unit) {
  auto grid = read_grid(grid_file);
  if (!grid) return tl::make_unexpected(grid.error());
  if (named_unit) {
    const auto unit = millimetres_per_unit(*named_unit);
    if (!unit) return tl::make_unexpected(unit.error());
    if (*unit != grid->millimetres_per_unit) {
      char text[400];
      std::snprintf(text, sizeof text,
                    "--unit %s is %g mm, but the unit of %s is %g mm; leave --unit out, or make a grid "
                    "in that unit",
                    named_unit->c_str(), *unit, grid_file.c_str(), grid->millimetres_per_unit);
      return tl::make_unexpected(std::string(text));
    }
  }
  return open_samples(input, *grid);
}

int write_part(GridInput& input, const std::string& name, const std::string& output) {
  if (const std::string missing = missing_folder(output); !missing.empty()) return fail(2, missing);
  GatheredSamples gathered = gather(input.stream(), input.grid.cells);
  if (!input.samples->error().empty()) return fail(2, input.samples->error());
  const std::size_t all = gathered.look.points(), used = gathered.sums.samples();
  if (used == 0)
    return fail(2, "'" + name + "': none of its " + std::to_string(all) +
                       " points lies within the grid; check the grid's band, frame and unit");
  const PartialSums part{input.grid, std::move(gathered), {std::filesystem::path(name).filename().string()}};
  const auto written = write_file_atomically(output, format_part(part));
  if (!written) return fail(4, written.error().message);
  std::printf("%s\n  summed      %zu of %zu points\n  wrote       %s\n", name.c_str(), used, all, output.c_str());
  return 0;
}

void take_from_grid(const SumsGrid& grid, RangeFitOptions& options) {
  options.base = grid.cells.base;
  options.arcs = grid.cells.arcs;
  options.degree_u = grid.cells.degree_u;
  options.degree_v = grid.cells.degree_v;
}

tl::expected<RangeFit, std::string> fit_on_grid(GridInput& input, RangeFitOptions options) {
  take_from_grid(input.grid, options);
  const GatheredSamples gathered = gather(input.stream(), input.grid.cells);
  ProfileStream* const whole[] = {&input.stream()};
  auto surface = fit_surface(gathered.sums, gathered.look, whole, options);
  if (!input.samples->error().empty()) return tl::make_unexpected(input.samples->error());
  if (!surface) return tl::make_unexpected(surface.error().message);
  RangeFit fitted = measure_errors(std::move(*surface), whole);
  if (!input.grid.X_FL.matrix().isIdentity(0)) place(fitted, input.grid.X_FL);
  return fitted;
}

}  // namespace celadon::cli
