#pragma once
// Coloured samples as a point cloud for viewers: a binary PLY.

#include <cstdint>
#include <filesystem>
#include <string>

#include <tl/expected.hpp>

#include "daemon/files/atomic_file.h"
#include "fitting/profile.h"

namespace celadon {

struct SampleCloud {
  std::uint64_t points = 0, coloured = 0;  ///< of these with a colour
};

/// Writes every sample as x, y, z (floats, mm) and red, green, blue (uchar; black: not known), in the order of the
/// stream, unless none has a colour: then there is no file. `header` is one line.
tl::expected<SampleCloud, WriteError> write_coloured_samples(ProfileStream& samples, const std::string& header,
                                                             const std::filesystem::path& file);

}  // namespace celadon
