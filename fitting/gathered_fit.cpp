#include "fitting/gathered_fit.h"

#include <utility>

#include "fitting/fit_report.h"
#include "fitting/look_stream.h"

namespace celadon {

tl::expected<RangeFit, FitError> fit_gathered(const GatheredSamples& samples, const RangeFitOptions& options) {
  const std::size_t kept = samples.look.samples().size(), all = samples.sums.samples();
  const double share = all > 0 ? static_cast<double>(kept) / static_cast<double>(all) : 1;
  LookStream stream(samples.look);
  ProfileStream* const whole[] = {&stream};
  auto surface = fit_surface(samples.sums, samples.look, whole, options, run_in_turn, {}, share);
  if (!surface) return tl::unexpected(surface.error());
  const bool of_kept_alone = surface->judge != nullptr && kept < all;
  RangeFit fit = measure_errors(std::move(*surface), whole);

  RangeFitReport& report = fit.report;
  if (of_kept_alone)
    report.warnings.push_back(text(
        "There are outliers, and only sums of all samples: the surface was fitted to an even sample of %zu of %zu.",
        kept, all));
  if (kept < all)
    report.warnings.push_back(text("The errors are those of an even sample of %zu of %zu samples.", kept, all));
  return fit;
}

}  // namespace celadon
