#pragma once
// Bodies of several pieces: a range over a cylinder, and over a sphere where an end is closed by a head or a dome.
// Source: README.md, "Composites"; the gear-shift knob of Bae and Choi 2002, section 5.

#include <optional>
#include <vector>

#include <tl/expected.hpp>

#include "fitting/piece_join.h"
#include "fitting/range_fit.h"

namespace celadon {

/// The heights at which a body ends and a head about that point of the axis begins. One of them at least; below <
/// above.
struct CompositeSplit {
  std::optional<double> below_mm, above_mm;
};

/// A rim that two pieces share.
struct CompositeJoint {
  double height_mm = 0;
  bool top = true;        ///< the head is above
  Meeting before, after;  ///< of the pieces as each was fitted alone, and as they are
};

struct CompositeFit {
  std::vector<RangeFit> pieces;  ///< from bottom to top: a head below, the body, a head above
  std::vector<CompositeJoint> joints;
  /// Of all samples; `model`, degrees, control points and the band are those of the pieces.
  RangeFitReport report;
};

/// Fits every piece to the samples on its side of the splits, then joins them. The samples are in the cylinder's frame;
/// so are the surfaces, heads with their centre at the split. Models are chosen for each piece by itself.
/// `options.model` and fixed intervals hold for the pieces alike; `options.base` is not looked at. Errors: no split, a
/// split beyond the samples, an open range of angles, degree 1 along the pieces, and those of fit_surface, with the
/// piece named.
tl::expected<CompositeFit, FitError> fit_composite(ProfileStream& samples, const CompositeSplit& split,
                                                   const RangeFitOptions& options = {});

}  // namespace celadon
