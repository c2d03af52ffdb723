#pragma once
// errors.svg: the errors of a surface, unrolled. What it shows is told in README.md, "Pictures of errors".

#include <span>
#include <string>

#include "fitting/base_surface.h"
#include "fitting/error_map.h"

namespace celadon {

/// A piece of a body and where it misses its samples.
struct PieceErrors {
  const BaseSurface& base;
  const ErrorMap& map;
};

/// A complete SVG document: fields of mean error in colour over angle and height (over a sphere the polar angle),
/// pieces above each other as they stand, the scale beside them. Deterministic.
/// @param pieces from bottom to top, with maps that are not empty
/// @param title and caption are lines of text, any UTF-8
std::string error_picture(std::span<const PieceErrors> pieces, const std::string& title, const std::string& caption);

}  // namespace celadon
