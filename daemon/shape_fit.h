#pragma once
// Samples to the body that they show: faces, walls, heads, in the frame and with the knowledge that was asked for.

#include <Eigen/Geometry>
#include <functional>
#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "daemon/body_fit.h"
#include "daemon/report.h"
#include "fitting/range_fit.h"
#include "fitting/shape_choice.h"

namespace celadon {

/// The symmetry that was asked for; where the mirror plane is may be left to the samples.
struct SymmetryRequest {
  int fold = 1;
  bool mirrored = false;
  std::optional<double> plane_rad{};  ///< nullopt: to be found
  bool any() const { return fold > 1 || mirrored; }
};

/// The shape of that name ("auto": what the samples ask for), its centre, splits and shoulders where the samples show
/// them. Errors: one sentence.
tl::expected<ShapeChoice, std::string> shape_named(const std::string& name, ProfileStream& samples);

/// What becomes of a fit besides its surface.
struct FitSetting {
  Eigen::Isometry3d X_WL = Eigen::Isometry3d::Identity();  ///< samples are in L, surfaces in W
  bool off_centre_rule = false;                            ///< a part may be fitted about its own axis
  SymmetryRequest symmetry{};                              ///< of a body over a cylinder
  bool follow_rims = false;                                ///< its ends need not be plane
  std::function<void(const char* stage)> lap;              ///< ends a stage
};

/// The samples, all of them and in parts, as that shape. A part that was fitted about its own axis is told in the
/// notes.
tl::expected<BodyFit, std::string> fit_shape(const ShapeChoice& shape, ProfileStream& samples, ProfileParts parts,
                                             RangeFitOptions options, const FitSetting& setting, ResultNotes& notes);

}  // namespace celadon
