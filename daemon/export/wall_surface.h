#pragma once
// Walls as surfaces of OpenCASCADE, checked.

#include <Geom_BSplineSurface.hxx>
#include <optional>
#include <string>

#include "fitting/nurbs_surface.h"

namespace celadon {

/// OpenCASCADE's own confusion distance; also the uncertainty written into the file.
inline constexpr double tolerance_mm = 1e-7;

std::string number(double value);

/// Knots that are not ascending or too multiple, control points that are not finite, weights that are not positive.
std::optional<std::string> wall_problem(const NurbsSurface& wall);

/// The surface as given, no re-approximation. @pre no problem
Handle(Geom_BSplineSurface) surface_of(const NurbsSurface& wall);

/// The control points of a row coincide.
bool is_pole(const NurbsSurface& wall, int row);

}  // namespace celadon
