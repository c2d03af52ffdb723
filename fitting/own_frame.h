#pragma once
// The off-centre rule: a part that stands off the axis is round about its own. Source: README.md, "Off-centre parts".

#include <optional>

#include "fitting/local_frame.h"
#include "fitting/moved_stream.h"
#include "fitting/range_fit.h"

namespace celadon {

/// A cylinder or a revolution.
bool is_round(SurfaceModel model);

/// Where the axis of a surface is whose sections are nearly circles about it, in the surface's base frame: a shift and
/// a tilt by its first harmonic. nullopt: sections miss circles by 1 % of their radius and more.
std::optional<Eigen::Isometry3d> axis_of_sections(const RangeFunction& surface);

/// A fit about a part's own axis.
struct OwnFrameFit {
  LocalFrame frame;    ///< X_SL as used: refined by the fit itself
  SurfaceFit surface;  ///< the function's base frame is X_SL
  MovedParts samples;  ///< that it was made from, in the part's frame
};

/// Refits a part about its own axis where that is simpler: where the fit in the scanner's frame is neither a cylinder
/// nor a revolution, the model was left to the samples, and about the axis that local_frame() finds it is one or the
/// other. The axis is refined by the first harmonic that a fit about it is left with. Sections of the surface that are
/// no circles, and fits to the look's samples alone, say no first: all samples are read only where a yes is likely.
/// @param look over the same parts
/// @return nullopt: the surface stays where it is
std::optional<OwnFrameFit> fit_in_own_frame(const SurfaceFit& in_scanner_frame, const FirstLook& look,
                                            ProfileParts parts, const RangeFitOptions& options,
                                            const Executor& executor = run_in_turn);

}  // namespace celadon
