#pragma once
// Where an artefact stands on the table, from samples of it. README.md, "Acceptance".

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/checks/artefact.h"

namespace celadon {

/// The artefact's frame is turned about z, then moved: p_S = R_z(turn) p_A + shift.
struct ArtefactPlacement {
  double turn_rad = 0;
  Eigen::Vector3d shift_mm = Eigen::Vector3d::Zero();

  Eigen::Vector3d direction(const Eigen::Vector3d& d_A) const;
  Eigen::Vector3d point(const Eigen::Vector3d& p_A) const { return direction(p_A) + shift_mm; }
};

/// The turn and the place beside the axis, up to 25 mm off it, about which most points lie within 4 mm of the balls;
/// good to a few millimetres. Errors: one sentence, where another placement explains the points as well.
/// @param points  spread over the whole scan; some thousands are enough
tl::expected<ArtefactPlacement, std::string> find_placement(const Artefact& artefact, const Eigen::Matrix3Xd& points);

/// The placement by which balls of the artefact lie nearest to where they were found, least squares.
/// @param centres_mm  one a sphere of the artefact; nullopt: not found. @pre two or more were found
ArtefactPlacement placement_through(const Artefact& artefact,
                                    const std::vector<std::optional<Eigen::Vector3d>>& centres_mm);

}  // namespace celadon
