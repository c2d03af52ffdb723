#pragma once
// Balls, spacings and flat of an artefact as a scan shows them, each with what is not known of it. README.md,
// "Acceptance".

#include <Eigen/Core>
#include <cstddef>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibration.h"
#include "acquisition/remeasured_points.h"
#include "daemon/checks/artefact.h"
#include "daemon/checks/artefact_placement.h"

namespace celadon {

/// Less of a ball's surface than this, and of a flat's rectangle, shows neither size nor form.
inline constexpr double kLeastOfSphere = 0.25, kLeastOfFlat = 0.5;
/// Points further from the fitted ball or plane than this are of something else.
inline constexpr double kOfSurface_mm = 1;
/// Left out: of a ball what lies within this angle of its lowest point, where it is held; of a flat its border.
inline constexpr double kHeld_rad = 0.7, kBorder_mm = 1.5;

/// A length in mm with the standard uncertainties that the points' scatter and the calibration leave.
struct MeasuredLength {
  double mm = 0, u_scatter_mm = 0, u_calibration_mm = 0;
};

/// Width of the shell about the fitted ball, or of the layer about the fitted plane, that holds points; with the
/// standard uncertainty by which it scatters.
struct MeasuredForm {
  double all_mm = 0, u_all_mm = 0;  ///< all points
  double p95_mm = 0, u_p95_mm = 0;  ///< the narrowest that holds 95 % of them
  std::size_t points = 0;
};

struct MeasuredSphere {
  std::string missing;  ///< why nothing can be said; empty: the rest holds
  double seen = 0;      ///< share of the whole surface
  Eigen::Vector3d centre_mm = Eigen::Vector3d::Zero();
  MeasuredLength diameter;
  MeasuredForm form;
};

struct MeasuredSpacing {
  std::string missing;
  MeasuredLength distance;
};

struct MeasuredFlat {
  std::string missing;
  double seen = 0;  ///< share of its rectangle within the border
  MeasuredForm form;
};

struct ArtefactMeasurement {
  ArtefactPlacement placement;
  std::vector<MeasuredSphere> spheres;    ///< as in the artefact
  std::vector<MeasuredSpacing> spacings;  ///< as in the artefact
  std::optional<MeasuredFlat> flat;       ///< where the artefact has one
};

/// Errors: one sentence, where the artefact is not found in the points.
/// @pre every laser, and every axis that stood off 0, is in the calibration
tl::expected<ArtefactMeasurement, std::string> measure_artefact(const Artefact& artefact, const ScannedPoints& points,
                                                                const Calibration& calibration);

}  // namespace celadon
