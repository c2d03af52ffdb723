#pragma once
// The table angle at any instant of the host clock, with uncertainty, from position samples that carry the controller's
// own time stamps.

#include <cstdint>
#include <deque>

#include <tl/expected.hpp>

namespace celadon {

/// One position sample: read between host_before_ns and host_after_ns, taken by the controller at device_time_us.
struct PositionSample {
  std::uint32_t counter = 0;
  std::uint64_t device_time_us = 0;
  double angle_rad = 0;  ///< unwrapped
  std::int64_t host_before_ns = 0, host_after_ns = 0;
};

struct AngleAtInstant {
  double angle_rad = 0, sigma_rad = 0, speed_rad_per_s = 0;
};

class AngleTimeline {
 public:
  /// quantisation_rad: resolution of the encoder.
  explicit AngleTimeline(double quantisation_rad);
  /// Repeated counters are used for the clock offset only.
  void add(const PositionSample& sample);
  /// Forget the samples but keep the estimate of the clock offset.
  void clear_positions();
  /// Host time of the newest position sample; INT64_MIN without any.
  std::int64_t newest_ns() const;
  /// @returns nullopt-like error text when the instant lies more than max_extrapolation_ns outside the samples
  tl::expected<AngleAtInstant, const char*> at(std::int64_t host_ns,
                                               std::int64_t max_extrapolation_ns = 50'000'000) const;
  /// Estimated host time of a controller time stamp.
  std::int64_t host_time_ns(std::uint64_t device_time_us) const;

 private:
  struct Point {
    std::uint64_t device_time_us;
    double angle_rad;
  };
  std::deque<Point> points_;
  double quantisation_rad_;
  std::int64_t best_round_trip_ns_ = INT64_MAX;
  double offset_ns_ = 0, offset_sigma_ns_ = 0;
};

}  // namespace celadon
