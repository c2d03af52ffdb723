#pragma once
// Sizes of what was scanned, where it is a round object of which workshops say a size.

#include <filesystem>
#include <vector>

#include "acquisition/calibration.h"
#include "daemon/body_fit.h"
#include "daemon/dimension.h"

namespace celadon {

/// Of an exact cylinder or sphere its diameter, from points of the log spread evenly over the scan; of others nothing.
std::vector<Dimension> dimensions_of_scan(const BodyFit& fit, const Calibration& calibration,
                                          const std::filesystem::path& log_file);

}  // namespace celadon
