#pragma once
// The scene `artefact`: a plate with three balls on stems and an upright flat, for acceptance tests. Its sizes are
// exact.

#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "sim/body.h"

namespace celadon::sim {

/// Object frame, millimetres.
struct ArtefactBall {
  std::string name;
  double diameter_mm;
  Eigen::Vector3d centre_mm;
};

/// A rectangle that stands upright and faces away from the axis.
struct ArtefactFlat {
  Eigen::Vector3d centre_mm, normal;
  double width_mm, height_mm;
};

/// Two balls at different heights, and a smaller one nearer to the axis.
const std::vector<ArtefactBall>& artefact_balls();
const ArtefactFlat& artefact_flat();
std::shared_ptr<const Body> make_artefact();
/// Its certificate, without uncertainty: a file as daemon/ARTEFACT.md describes.
std::string artefact_certificate();

}  // namespace celadon::sim
