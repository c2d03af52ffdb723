#pragma once
// A grey picture with the found line drawn over it, as PNG bytes.

#include <span>
#include <string>

#include "acquisition/image_file.h"
#include "acquisition/laser_line.h"

namespace celadon::cli {

/// PNG file contents: the picture in grey; found rows green, saturated rows yellow, ambiguous rows marked red at the
/// left edge.
/// @pre rows.size() == image.height_px  @throws std::runtime_error with libpng's words
std::string overlay_png(const GreyImage& image, std::span<const LineRow> rows);

}  // namespace celadon::cli
