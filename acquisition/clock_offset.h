#pragma once
// The host time of a controller's time stamps. README.md, "Clocks".

#include <cstdint>
#include <vector>

namespace celadon {

/// Offset and drift between two clocks from exchanges: the host knows only that a stamp was taken before it had the
/// answer, and not more than one round trip (and one sampling period of the controller) before that.
class ClockOffset {
 public:
  /// @pre host_after_ns >= host_before_ns; device times do not fall (a fall is taken as a restart of the controller and
  /// forgets everything)
  void add(std::uint64_t device_time_us, std::int64_t host_before_ns, std::int64_t host_after_ns);

  bool empty() const { return anchors_.empty(); }
  std::int64_t host_time_ns(std::uint64_t device_time_us) const;
  /// Standard uncertainty of host_time_ns() at that time: the asymmetry of the quickest round trip, which nobody can
  /// see, and the drift.
  double sigma_ns(std::uint64_t device_time_us) const;

 private:
  /// The best of one interval of device time.
  struct Anchor {
    std::uint64_t device_time_us;
    double latest_ns;      ///< host_after - device time: upper bound of the offset, relative to base_ns_
    double round_trip_ns;  ///< smallest
  };
  void fit();

  std::vector<Anchor> anchors_;
  std::uint64_t interval_us_ = 500'000;  ///< doubles when the anchors become many
  std::uint64_t newest_us_ = 0;
  std::int64_t base_ns_ = 0;
  // The line: offset = offset_ns_ + drift_ * (device time - centre).
  double offset_ns_ = 0, drift_ = 0, centre_us_ = 0, round_trip_ns_ = 0, scatter_ns_ = 0, spread_us_ = 0;
};

}  // namespace celadon
