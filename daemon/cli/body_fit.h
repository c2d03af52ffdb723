#pragma once
// A fit of one piece or of several, as `celadon fit` handles it.

#include <Eigen/Geometry>
#include <functional>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <variant>

#include <tl/expected.hpp>

#include "daemon/cli/constraint_options.h"
#include "daemon/report.h"
#include "fitting/composite_fit.h"
#include "fitting/range_fit.h"
#include "fitting/shape_choice.h"

namespace celadon::cli {

struct BodyFit {
  std::variant<RangeFit, CompositeFit> fit;
  std::span<const RangeFit> pieces() const;
  nlohmann::ordered_json report(const ResultNotes& notes) const;
  /// The piece over a cylinder; nullptr: there is none.
  const RangeFit* wall() const;
  bool wall_is_round() const;
  /// Where the wall's axis is, in its own frame, if that may make it round.
  std::optional<Eigen::Isometry3d> better_axis() const;
};

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

}  // namespace celadon::cli
