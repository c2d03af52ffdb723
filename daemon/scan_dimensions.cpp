#include "daemon/scan_dimensions.h"

#include <algorithm>
#include <cstddef>
#include <optional>

#include "daemon/dimensions.h"
#include "daemon/logged_points.h"

namespace celadon {
namespace {

constexpr std::size_t kMostPoints = 2000;

std::optional<RoundShape> shape_of(const BodyFit& fit) {
  const auto pieces = fit.pieces();
  if (pieces.size() != 1 || pieces[0].report.model != SurfaceModel::cylinder) return std::nullopt;
  return pieces[0].function.base().spherical() ? RoundShape::sphere : RoundShape::cylinder;
}

}  // namespace

std::vector<Dimension> dimensions_of_scan(const BodyFit& fit, const Calibration& calibration,
                                          const std::filesystem::path& log_file) {
  const auto shape = shape_of(fit);
  if (!shape) return {};
  auto log = ProfileLogReader::open(log_file);
  if (!log) return {};
  // Not a divisor of what repeats from profile to profile.
  const std::size_t every = std::max<std::size_t>(1, fit.whole().points / kMostPoints) | 1;
  const auto found = dimensions_of(*shape, logged_points(**log, every), calibration);
  return found ? found->values : std::vector<Dimension>{};
}

}  // namespace celadon
