#pragma once
// Asks the helper process celadon-cad for a CAD file of a surface; a crash or hang there cannot hurt the daemon.

#include <filesystem>
#include <string>

#include <tl/expected.hpp>

#include "fitting/nurbs_surface.h"

namespace celadon {

struct CadOptions {
  bool ap214 = false;              ///< AP242 otherwise
  std::string name = "object";     ///< product name in the file
  bool simulated = false;          ///< said in the file's header
  std::string date;                ///< ISO 8601 UTC; in the header in place of the present time
  int time_limit_s = 60;
};

struct CadResult { double volume_mm3 = 0; bool valid = false; int faces = 0; };

/// Writes a closed solid of positive volume: the exact wall, a disc at each end named and coloured as assumed.
/// Written beside `file`, synced and renamed. Errors: one sentence with the remedy.
tl::expected<CadResult, std::string> write_step(const NurbsSurface& wall, const std::filesystem::path& file,
                                                const CadOptions& options);

}  // namespace celadon
