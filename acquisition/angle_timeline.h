#pragma once
// The table angle at any instant of the host clock, with uncertainty, from position samples that carry the controller's
// own time stamps. README.md, "Angle at an instant".

#include <cstddef>
#include <cstdint>
#include <deque>

#include <tl/expected.hpp>

#include "acquisition/clock_offset.h"

namespace celadon {

/// One position sample: read between host_before_ns and host_after_ns, taken by the controller at device_time_us (when
/// it was asked, or at most one of its sampling periods before).
struct PositionSample {
  std::uint32_t counter = 0;
  std::uint64_t device_time_us = 0;
  double angle_rad = 0;  ///< unwrapped
  std::int64_t host_before_ns = 0, host_after_ns = 0;
  std::uint64_t device_reply_us =
      0;  ///< the controller's clock when it answered: not older by a sampling period; 0: not told
};

struct AngleAtInstant {
  double angle_rad = 0, sigma_rad = 0, speed_rad_per_s = 0;
};

/// The angle while one frame is exposed and read out: that of its middle, and constant speed about it.
struct FrameAngle {
  AngleAtInstant middle;
  std::int64_t middle_ns = 0;

  AngleAtInstant at(std::int64_t host_ns) const {
    const double after_s = static_cast<double>(host_ns - middle_ns) * 1e-9;
    return {middle.angle_rad + middle.speed_rad_per_s * after_s, middle.sigma_rad, middle.speed_rad_per_s};
  }
};

/// Who says when a position was taken: the controller, or only the exchange that brought it.
enum class StampedBy : std::uint8_t { controller, host };

class AngleTimeline {
 public:
  /// quantisation_rad: resolution of the encoder. Stamped by the host, device_time_us is not used: a sample counts as
  /// taken in the middle of its exchange, with a standard uncertainty of the whole exchange over sqrt(12).
  /// @throws std::invalid_argument unless it is finite and >= 0
  explicit AngleTimeline(double quantisation_rad, StampedBy stamped_by = StampedBy::controller);
  /// Repeated counters are used for the clock offset only. A device time that falls means that the controller was
  /// restarted: everything known before is forgotten.
  /// @throws std::invalid_argument for an angle that is not finite or host_after_ns < host_before_ns
  void add(const PositionSample& sample);
  /// Forget the samples but keep the estimate of the clock offset.
  void clear_positions();
  /// Host time of the newest position sample; INT64_MIN without any.
  std::int64_t newest_ns() const;
  /// Exact for constant acceleration between the samples around the instant; sigma_rad holds the encoder's quantisation
  /// (q / sqrt(12) a sample, as the interpolation weighs it), the uncertainty of the clocks times the speed, and how
  /// far the motion is from constant acceleration. At the ends the last samples are extrapolated.
  /// @returns the error's text when the instant lies more than max_extrapolation_ns outside the samples, or none are
  /// there
  tl::expected<AngleAtInstant, const char*> at(std::int64_t host_ns,
                                               std::int64_t max_extrapolation_ns = 50'000'000) const;
  /// Estimated host time of a controller time stamp. @pre stamped by the controller
  std::int64_t host_time_ns(std::uint64_t device_time_us) const { return clock_.host_time_ns(device_time_us); }

 private:
  struct Point {
    std::uint64_t device_time_us;  ///< of the host's clock where that stamps
    double angle_rad;
    double sigma_ns;  ///< of the time, where the host stamps
  };
  std::int64_t host_time_of(const Point& point) const;
  void add_point(std::uint64_t time_us, const PositionSample& sample, double sigma_ns);
  std::deque<Point> points_;
  ClockOffset clock_;
  double quantisation_rad_;
  StampedBy stamped_by_;
  std::uint32_t newest_counter_ = 0;
  std::uint64_t newest_device_us_ = 0;  ///< that the clocks were compared by
};

}  // namespace celadon
