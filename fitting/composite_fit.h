#pragma once
// Bodies of several pieces: ranges over a cylinder, one above the other with plane shoulders between them, and over a
// sphere where an end is closed by a head or a dome.
// Source: README.md, "Composites", "Shoulders"; the gear-shift knob of Bae and Choi 2002, section 5.

#include <optional>
#include <vector>

#include <tl/expected.hpp>

#include "fitting/piece_join.h"
#include "fitting/range_fit.h"
#include "fitting/shoulders.h"

namespace celadon {

/// The heights at which a body ends and a head about that point of the axis begins, and the shoulders between its
/// walls. One of them at least, ascending: below, shoulders, above.
struct CompositeSplit {
  std::optional<double> below_mm, above_mm;
  std::vector<Shoulder> shoulders{};
  bool any() const { return below_mm || above_mm || !shoulders.empty(); }
};

/// A rim that a wall and a head share.
struct CompositeJoint {
  double height_mm = 0;
  bool top = true;        ///< the head is above
  Meeting before, after;  ///< of the pieces as each was fitted alone, and as they are
};

struct CompositeFit {
  /// From bottom to top: a head below, the walls of the body, a head above. `deviation` is that of the joined surface,
  /// `errors` are those of the piece alone.
  std::vector<RangeFit> pieces;
  std::vector<CompositeJoint> joints;
  std::vector<Shoulder> shoulders;  ///< between the walls, from below: plane rings across the axis
  /// Of all samples; `model`, degrees, control points and the band are those of the pieces.
  RangeFitReport report;
};

/// Fits every piece to the samples on its side of the splits, walls to those beyond the edges of their shoulders, which
/// they reach; then joins the heads. The samples are in the cylinder's frame; so are the surfaces, heads with their
/// centre at the split. Models are chosen for each piece by itself. `options.model` and fixed intervals hold for the
/// pieces alike, reach_start and reach_end for walls without a head; `options.base` is not looked at. Errors: no split,
/// splits not ascending or beyond the samples, an open range of angles, degree 1 along pieces that a head joins, walls
/// that cross at a shoulder, and those of fit_surface, with the piece named.
/// The same parts give the same bits whatever the executor.
tl::expected<CompositeFit, FitError> fit_composite(ProfileParts samples, const CompositeSplit& split,
                                                   const RangeFitOptions& options, const Executor& executor);
/// The same of one stream, in turn.
tl::expected<CompositeFit, FitError> fit_composite(ProfileStream& samples, const CompositeSplit& split,
                                                   const RangeFitOptions& options = {});

}  // namespace celadon
