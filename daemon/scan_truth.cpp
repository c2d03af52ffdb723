#include "daemon/scan_truth.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

namespace celadon {

tl::expected<std::vector<TruthPoint>, std::string> SimTruth::points() {
  constexpr int kHeights = 64, kAngles = 64;
  const auto scene = control_->ask("scene");
  if (!scene) return tl::make_unexpected(scene.error());
  const double low = scene->value("z_min_mm", 0.), high = scene->value("z_max_mm", 0.);
  std::vector<TruthPoint> points;
  std::vector<std::string> requests;
  for (int i = 0; i < kHeights; ++i) {
    const double z = low + (high - low) * (i + 0.5) / kHeights;
    for (int j = 0; j < kAngles; ++j) {
      // The golden ratio keeps the angles of the rows apart: no knot grid can hide between them.
      const double turn = (j + std::fmod(i * std::numbers::phi, 1.)) / kAngles;
      points.push_back({2 * std::numbers::pi * turn, z, 0});
      char request[96];
      std::snprintf(request, sizeof request, "truth %.17g %.17g", points.back().theta_rad, z);
      requests.emplace_back(request);
    }
  }
  const auto answers = control_->ask_all(requests);
  if (!answers) return tl::make_unexpected(answers.error());
  std::vector<TruthPoint> known;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const nlohmann::json& answer = (*answers)[i];
    if (!answer.is_object() || !answer.contains("r_mm") || !answer["r_mm"].is_number()) continue;
    points[i].r_mm = answer["r_mm"].get<double>();
    known.push_back(points[i]);
  }
  return known;
}

std::optional<TruthError> truth_error(std::span<const RangeFunction* const> pieces, std::span<const TruthPoint> truth) {
  TruthError error;
  double sum = 0, squares = 0;
  int n = 0;
  for (const TruthPoint& t : truth) {
    const Eigen::Vector3d p(t.r_mm * std::cos(t.theta_rad), t.r_mm * std::sin(t.theta_rad), t.z_mm);
    const auto at = std::find_if(pieces.begin(), pieces.end(), [&](const auto* f) { return f->membership(p).in_band; });
    if (at == pieces.end()) continue;
    const double e = -(*at)->membership(p).ray_mm;
    sum += e;
    squares += e * e;
    error.max = std::max(error.max, std::abs(e));
    ++n;
  }
  if (n == 0) return std::nullopt;
  error.bias = sum / n;
  error.rms = std::sqrt(squares / n);
  return error;
}

}  // namespace celadon
