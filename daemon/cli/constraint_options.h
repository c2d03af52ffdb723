#pragma once
// What is known of a part beforehand, as options of a fit.

#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include <tl/expected.hpp>

#include "daemon/shape_fit.h"
#include "fitting/constraints.h"

namespace celadon::cli {

struct ConstraintArguments {
  std::vector<std::string> radii;
  std::optional<double> angle_below_deg, angle_above_deg;
  int fold = 1;
  std::string mirror = "none";
  bool any() const { return !radii.empty() || angle_below_deg || angle_above_deg || fold > 1 || mirror != "none"; }
};

void add_constraint_options(CLI::App& command, ConstraintArguments& arguments);
/// Errors: a radius that is not HEIGHT=RADIUS.
tl::expected<Constraints, std::string> constraints_of(const ConstraintArguments& arguments);
SymmetryRequest symmetry_of(const ConstraintArguments& arguments);

}  // namespace celadon::cli
