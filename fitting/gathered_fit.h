#pragma once
// A fit when the samples themselves are not at hand any more. Source: README.md, "Without the samples".

#include <tl/expected.hpp>

#include "fitting/first_look.h"
#include "fitting/range_fit.h"

namespace celadon {

/// The surface of sums and of the look over the same samples, whose even choice stands for all of them wherever a fit
/// reads samples: for kappa, outliers and errors. Where outliers are found, the sums are of no use and the surface is
/// fitted to that choice alone. What this means for the result is among the report's warnings. Errors: as fit_surface.
tl::expected<RangeFit, FitError> fit_gathered(const GatheredSamples& samples, const RangeFitOptions& options = {});

}  // namespace celadon
