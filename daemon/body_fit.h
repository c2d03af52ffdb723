#pragma once
// A fit of one piece or of several.

#include <Eigen/Geometry>
#include <optional>
#include <span>
#include <variant>

#include "daemon/report.h"
#include "fitting/composite_fit.h"
#include "fitting/range_fit.h"

namespace celadon {

struct BodyFit {
  std::variant<RangeFit, CompositeFit> fit;
  std::span<const RangeFit> pieces() const;
  /// Of the whole body.
  const RangeFitReport& whole() const;
  nlohmann::ordered_json report(const ResultNotes& notes) const;
  /// The lowest piece over a cylinder; nullptr: there is none.
  const RangeFit* wall() const;
  bool wall_is_round() const;
  /// Where the wall's axis is, in its own frame, if that may make it round.
  std::optional<Eigen::Isometry3d> better_axis() const;
};

/// The surface of a fit in a local frame as one in the frame outside.
void place(RangeFit& fitted, const Eigen::Isometry3d& X_WL);

}  // namespace celadon
