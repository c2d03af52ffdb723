#pragma once
// Which base a body asks for: cylinder, sphere, or pieces of both. Source: README.md, "Composites".

#include <cstdint>
#include <string>

#include <tl/expected.hpp>

#include "fitting/composite_fit.h"

namespace celadon {

enum class BodyShape : std::uint8_t { cylinder, sphere, composite };
/// "cylinder", "sphere", "composite"
const char* to_string(BodyShape shape);

struct ShapeChoice {
  BodyShape shape = BodyShape::cylinder;
  double centre_z_mm = 0;  ///< of a sphere
  CompositeSplit split;    ///< of a composite
  std::string reason;      ///< in one sentence, with numbers
};

/// By the angle psi between normals and the rays that see them, from planes through the neighbours of an even sample of
/// points. A cylinder will do where next to nothing is seen at more than 75 degrees; flat ends do not count, they are
/// its discs. Else the least mean of sin^2 psi decides between a sphere and heads above, below or on both sides; each
/// split is where it is least. Shoulders of the wall make it several (find_shoulders). `wanted` automatic chooses the
/// shape, a shape its centre or splits only. The stream is in the cylinder's frame. Errors: fewer than 50 samples with
/// numbers; a composite of an object that has neither heads nor shoulders.
tl::expected<ShapeChoice, FitError> choose_shape(ProfileStream& samples,
                                                 std::optional<BodyShape> wanted = std::nullopt);

}  // namespace celadon
