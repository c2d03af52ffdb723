#pragma once
// The true shape of the scanned object where somebody knows it: the virtual scanner. Real machines have none.

#include <memory>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/report.h"
#include "daemon/sim_control.h"
#include "fitting/range_function.h"

namespace celadon {

/// A point of the true surface in the scanner frame.
struct TruthPoint {
  double theta_rad = 0, z_mm = 0, r_mm = 0;
};

class TruthSource {
 public:
  virtual ~TruthSource() = default;
  /// Points spread over the whole surface.
  virtual tl::expected<std::vector<TruthPoint>, std::string> points() = 0;
};

/// The closed form of the virtual scanner's scene, on a grid of 64 heights and 64 angles that shift from row to row.
class SimTruth final : public TruthSource {
 public:
  explicit SimTruth(std::unique_ptr<SimControl> control) : control_(std::move(control)) {}
  tl::expected<std::vector<TruthPoint>, std::string> points() override;

 private:
  std::unique_ptr<SimControl> control_;
};

/// Fitted range minus the true one along the ray, each point by the first piece whose band it is in; nullopt without
/// any.
std::optional<TruthError> truth_error(std::span<const RangeFunction* const> pieces, std::span<const TruthPoint> truth);

}  // namespace celadon
