#pragma once
// Whether a frame's time stamp is later than its exposure. Drivers that stamp frames as they arrive (uvcvideo does)
// stamp one late when the computer is busy; to a scan in steps a picture of a moving table then looks like one at rest.
// A camera that runs freely begins its exposures whole periods apart, so that a late frame shows: it comes late after
// the one before, and the next one soon after it.

#include <algorithm>
#include <cstdint>

namespace celadon {

class ArrivalWatch {
 public:
  /// A frame by its number among all that the camera exposed, lost ones too, and when its exposure seems to have begun.
  struct Exposure {
    std::uint64_t sequence = 0;
    std::int64_t began_ns = 0;
  };

  /// @param period_ns  of the camera, as its driver states it. A true one more than 2 % longer makes frames be doubted
  /// for nothing, which costs the time to the next; one more than 5 % shorter makes all of those late.
  explicit ArrivalWatch(std::int64_t period_ns) : period_ns_(period_ns) {}

  /// Frames in the order in which they came.
  void see(const Exposure& frame) {
    const std::int64_t before_ns = expected_ns_;
    expected_ns_ = frame.began_ns;
    if (any_seen_ && frame.sequence > seen_.sequence) {
      const auto periods = static_cast<double>(frame.sequence - seen_.sequence);
      expected_ns_ = std::min(expected_ns_, before_ns + static_cast<std::int64_t>(periods * kLongest * period()));
    }
    seen_ = frame;
    any_seen_ = true;
  }

  /// Whether the newest frame came later than those before it tell. A camera that made a pause looks alike: then the
  /// next frame decides, by is_late().
  bool may_be_late() const { return static_cast<double>(seen_.began_ns - expected_ns_) > kWorthAsking * period(); }

  /// Whether a frame that may have come late did: the one after it follows too soon. @pre next.sequence is larger
  bool is_late(const Exposure& frame, const Exposure& next) const {
    const auto periods = static_cast<double>(next.sequence - frame.sequence);
    return static_cast<double>(next.began_ns - frame.began_ns) < periods * kShortest * period();
  }

  /// A frame was found to be on time: what comes is judged by it. @pre it was seen, and `newest` was seen last
  void trust(const Exposure& frame, const Exposure& newest) {
    expected_ns_ = frame.began_ns;
    seen_ = frame;
    see(newest);
  }

 private:
  double period() const { return static_cast<double>(period_ns_); }

  // Shares of the stated period: what the true one is at least and at most; how late a frame may be that is not
  // doubted.
  static constexpr double kShortest = 0.95, kLongest = 1.02, kWorthAsking = 0.1;
  std::int64_t period_ns_;
  std::int64_t expected_ns_ = 0;  ///< when the newest exposure began if all came as early as the most punctual one
  Exposure seen_;                 ///< the newest frame
  bool any_seen_ = false;
};

}  // namespace celadon
