#pragma once
// A grey picture with the found line drawn over it, as PNG bytes.

#include <span>
#include <string>

#include "acquisition/image_file.h"
#include "acquisition/laser_line.h"

namespace celadon::cli {

/// PNG file contents: the picture in grey; found rows (columns) green, saturated yellow, ambiguous marked red at the
/// left (upper) edge.
/// @pre rows.size() == image.height_px, along columns image.width_px  @throws std::runtime_error with libpng's words
std::string overlay_png(const GreyImage& image, std::span<const LineRow> rows, LineAlong along);

}  // namespace celadon::cli
