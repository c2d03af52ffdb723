#pragma once
// surface.json: the exact surface, the single-valued function and the base geometry. Grammar: RESULTS.md.

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "fitting/deviation_map.h"
#include "fitting/nurbs_surface.h"
#include "fitting/range_function.h"

namespace celadon {

struct SurfacePiece {
  RangeFunction function;
  NurbsSurface surface;
  std::optional<DeviationMap> deviation{};  ///< of the function, if it is known
};

/// All that surface.json holds.
struct SurfaceFile {
  std::vector<SurfacePiece> pieces;  ///< one, or those of a composite from bottom to top
  std::string name, date;
  bool simulated = false;
};

/// Text of surface.json; every number reads back as the same double. Deterministic.
std::string format_surface_json(const SurfaceFile& file);
/// The inverse, checked field by field. Errors: one sentence with `source` (a file name), field, value and remedy.
tl::expected<SurfaceFile, std::string> parse_surface_json(const std::string& text, const std::string& source);
/// Reads at most 256 MB.
tl::expected<SurfaceFile, std::string> read_surface_json(const std::filesystem::path& file);

}  // namespace celadon
