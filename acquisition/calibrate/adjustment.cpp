#include "acquisition/calibrate/adjustment.h"

#include "acquisition/calibrate/bundle.h"
#include "acquisition/calibrate/outliers.h"

namespace celadon::calibrate {

tl::expected<Estimate, std::string> adjusted(Observations& observations, Estimate estimate) {
  constexpr int kSoftRounds = 3, kHardRounds = 12;
  for (int round = 0; round < kSoftRounds + kHardRounds; ++round) {
    update_residuals(estimate, observations);
    const bool changed = set_weights(observations, round < kSoftRounds ? Weighting::soft : Weighting::hard);
    if (!changed && round > kSoftRounds) break;
    auto solved = solve_bundle(observations, estimate);
    if (!solved) return solved;
    estimate = anchored(*solved);
  }
  update_residuals(estimate, observations);
  return estimate;
}

}  // namespace celadon::calibrate
