#include "daemon/closure_test.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace celadon {

void ClosureTest::first(double turned_rad, const Profile& profile) {
  if (turned_rad > overlap_rad_ || profile.row.empty()) return;
  Kept kept{turned_rad, {}};
  kept.r_mm.resize(std::size_t{*std::max_element(profile.row.begin(), profile.row.end())} + 1, 0.f);
  for (std::size_t i = 0; i < profile.size(); ++i) kept.r_mm[profile.row[i]] = static_cast<float>(profile.r_mm[i]);
  const auto place = std::upper_bound(kept_.begin(), kept_.end(), turned_rad,
                                      [](double turned, const Kept& k) { return turned < k.turned_rad; });
  kept_.insert(place, std::move(kept));
}

void ClosureTest::again(double turned_rad, const Profile& profile) {
  const double at = turned_rad - 2 * std::numbers::pi;
  const auto after = std::upper_bound(kept_.begin(), kept_.end(), at,
                                      [](double turned, const Kept& k) { return turned < k.turned_rad; });
  if (after == kept_.begin() || after == kept_.end() || profile.row.empty()) return;
  const Kept &a = *(after - 1), &b = *after;
  const double t = (at - a.turned_rad) / (b.turned_rad - a.turned_rad);
  for (std::size_t i = 0; i < profile.size(); ++i) {
    const std::size_t row = profile.row[i];
    if (row >= std::min(a.r_mm.size(), b.r_mm.size()) || a.r_mm[row] <= 0 || b.r_mm[row] <= 0) continue;
    const double difference = profile.r_mm[i] - ((1 - t) * double{a.r_mm[row]} + t * double{b.r_mm[row]});
    sum_ += difference;
    squares_ += difference * difference;
    ++samples_;
  }
}

std::optional<ClosureError> ClosureTest::result() const {
  if (samples_ == 0) return std::nullopt;
  const auto n = static_cast<double>(samples_);
  return ClosureError{sum_ / n, std::sqrt(squares_ / n), samples_};
}

}  // namespace celadon
