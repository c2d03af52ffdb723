#pragma once
// After every scan: what its own samples say of whether it can be trusted. Source: README.md, "Self-checks".

#include <filesystem>
#include <optional>
#include <vector>

#include "acquisition/calibration.h"
#include "daemon/body_fit.h"
#include "daemon/checks/overlap_comparison.h"
#include "daemon/checks/profile_jitter.h"
#include "daemon/checks/self_check.h"
#include "daemon/checks/stop_comparison.h"
#include "daemon/report.h"

namespace celadon {

/// What the checks look at.
struct CheckedScan {
  const BodyFit& fit;  ///< with its errors measured
  const Calibration& calibration;
  OverlapResult overlap;                      ///< of the beginning and the end of the turn
  std::optional<ClosureError> closure;        ///< as the capture compared it
  std::optional<AgreementError> agreement{};  ///< of two lasers; nullopt: not measured
  std::optional<StopComparison> stops{};      ///< of head and lift; nullopt: there was one
  std::optional<JitterResult> jitter{};       ///< of the profiles of all turns; nullopt: too few
};

/// Closure, angle of a turn, harmonics, steadiness, jitter, and what lasers and stops differ by, in this order. Limits
/// are four standard uncertainties of the check itself and, added in squares, twice what the calibration says that it
/// does not know.
std::vector<SelfCheck> self_checks(const CheckedScan& scan);

/// The beginning and the end of the turn in the log of a whole scan, compared; of several turns, with lasers or at
/// stops of head and lift, the one whose ends differ most for their uncertainty.
OverlapResult compare_overlap(const std::filesystem::path& log_file);

}  // namespace celadon
