#include "acquisition/clock_offset.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace celadon {
namespace {

constexpr std::size_t kMostAnchors = 64;
/// Drift is estimated from this many anchors on; before that it is zero within what crystals differ by.
constexpr std::size_t kAnchorsForDrift = 4;
constexpr double kCrystalDrift = 100e-6 / std::numbers::sqrt3;

}  // namespace

void ClockOffset::add(std::uint64_t device_time_us, std::int64_t host_before_ns, std::int64_t host_after_ns) {
  if (host_after_ns < host_before_ns)
    throw std::invalid_argument("ClockOffset: an exchange that ends before it begins");
  if (device_time_us < newest_us_) *this = {};
  newest_us_ = device_time_us;
  const auto device_ns = static_cast<std::int64_t>(device_time_us * 1000);
  if (anchors_.empty()) base_ns_ = host_after_ns - device_ns;
  const auto latest = static_cast<double>(host_after_ns - device_ns - base_ns_);
  const auto round_trip = static_cast<double>(host_after_ns - host_before_ns);
  if (anchors_.empty() || device_time_us / interval_us_ != anchors_.back().device_time_us / interval_us_) {
    anchors_.push_back({device_time_us, latest, round_trip});
  } else {
    Anchor& anchor = anchors_.back();
    const bool changes = latest < anchor.latest_ns || round_trip < anchor.round_trip_ns;
    anchor.round_trip_ns = std::min(anchor.round_trip_ns, round_trip);
    if (latest < anchor.latest_ns) {
      anchor.latest_ns = latest;
      anchor.device_time_us = device_time_us;
    }
    if (!changes) return;
  }
  if (anchors_.size() > kMostAnchors) {
    interval_us_ *= 2;
    std::vector<Anchor> merged;
    for (const Anchor& anchor : anchors_) {
      if (merged.empty() || anchor.device_time_us / interval_us_ != merged.back().device_time_us / interval_us_) {
        merged.push_back(anchor);
        continue;
      }
      const double quickest = std::min(merged.back().round_trip_ns, anchor.round_trip_ns);
      if (anchor.latest_ns < merged.back().latest_ns) merged.back() = anchor;
      merged.back().round_trip_ns = quickest;
    }
    anchors_ = std::move(merged);
  }
  fit();
}

void ClockOffset::fit() {
  // A line through the lower envelope: anchors whose every answer was slow lie above it and are left out.
  round_trip_ns_ = std::min_element(anchors_.begin(), anchors_.end(), [](const Anchor& a, const Anchor& b) {
                     return a.round_trip_ns < b.round_trip_ns;
                   })->round_trip_ns;
  std::vector<bool> use(anchors_.size(), true);
  for (int pass = 0; pass < 3; ++pass) {
    double n = 0, t = 0, o = 0;
    for (std::size_t i = 0; i < anchors_.size(); ++i) {
      if (!use[i]) continue;
      n += 1;
      t += static_cast<double>(anchors_[i].device_time_us);
      o += anchors_[i].latest_ns;
    }
    centre_us_ = t / n;
    offset_ns_ = o / n;
    double tt = 0, to = 0;
    for (std::size_t i = 0; i < anchors_.size(); ++i) {
      if (!use[i]) continue;
      const double dt = static_cast<double>(anchors_[i].device_time_us) - centre_us_;
      tt += dt * dt;
      to += dt * (anchors_[i].latest_ns - offset_ns_);
    }
    drift_ = n >= static_cast<double>(kAnchorsForDrift) && tt > 0 ? to / tt : 0;
    if (n < static_cast<double>(kAnchorsForDrift)) {
      // Too few for a line: the lowest bound is the best.
      offset_ns_ = std::min_element(anchors_.begin(), anchors_.end(), [](const Anchor& a, const Anchor& b) {
                     return a.latest_ns < b.latest_ns;
                   })->latest_ns;
    }
    const auto residual = [&](const Anchor& a) {
      return a.latest_ns - offset_ns_ - drift_ * (static_cast<double>(a.device_time_us) - centre_us_);
    };
    double sum = 0;
    for (std::size_t i = 0; i < anchors_.size(); ++i) sum += use[i] ? residual(anchors_[i]) * residual(anchors_[i]) : 0;
    scatter_ns_ = std::sqrt(sum / std::max(n - 2, 1.0));
    spread_us_ = std::sqrt(tt);
    bool same = true;
    for (std::size_t i = 0; i < anchors_.size(); ++i) {
      const bool good = residual(anchors_[i]) <= std::max(round_trip_ns_ / 4, scatter_ns_);
      same = same && good == use[i];
      use[i] = good;
    }
    if (same || std::count(use.begin(), use.end(), true) == 0) break;
  }
}

std::int64_t ClockOffset::host_time_ns(std::uint64_t device_time_us) const {
  const double since_centre_us = static_cast<double>(device_time_us) - centre_us_;
  // The bound is reached by an answer that takes no time; half the quickest round trip is the best guess.
  const double offset = offset_ns_ + drift_ * since_centre_us - round_trip_ns_ / 2;
  return static_cast<std::int64_t>(device_time_us * 1000) + base_ns_ + std::llround(offset);
}

double ClockOffset::sigma_ns(std::uint64_t device_time_us) const {
  const double since_centre_us = std::abs(static_cast<double>(device_time_us) - centre_us_);
  const double asymmetry = round_trip_ns_ / std::sqrt(12.0);
  const bool has_drift = anchors_.size() >= kAnchorsForDrift && spread_us_ > 0;
  const double drift = has_drift ? scatter_ns_ / spread_us_ : kCrystalDrift * 1000;  // ns per us
  return std::hypot(asymmetry, scatter_ns_ / std::sqrt(static_cast<double>(anchors_.size())), drift * since_centre_us);
}

}  // namespace celadon
