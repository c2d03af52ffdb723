#pragma once
// The fit error while the table still turns, computed beside the capture so that it never waits.

#include <chrono>
#include <memory>
#include <optional>
#include <thread>

#include "daemon/thread_annotations.h"
#include "fitting/range_fit.h"

namespace celadon {

/// A thread of its own that fits copies of the sums, at most one every interval.
class RunningFit {
 public:
  explicit RunningFit(const RangeFitOptions& options,
                      std::chrono::nanoseconds interval = std::chrono::milliseconds(700));
  ~RunningFit();
  RunningFit(const RunningFit&) = delete;
  RunningFit& operator=(const RunningFit&) = delete;

  /// Copies the sums if the thread is idle and the interval has passed; never waits for a fit.
  void offer(const MomentGrid& sums) CELADON_EXCLUDES(mutex_);
  /// RMS of the newest finished fit along the ray.
  std::optional<double> rms_mm() const CELADON_EXCLUDES(mutex_);

 private:
  void work() CELADON_EXCLUDES(mutex_);

  const RangeFitOptions options_;
  const std::chrono::nanoseconds interval_;
  std::chrono::steady_clock::time_point last_offer_;  ///< of the capture's thread
  mutable Mutex mutex_;
  Condition wake_;
  std::unique_ptr<const MomentGrid> next_ CELADON_GUARDED_BY(mutex_);
  bool busy_ CELADON_GUARDED_BY(mutex_) = false, stop_ CELADON_GUARDED_BY(mutex_) = false;
  std::optional<double> rms_mm_ CELADON_GUARDED_BY(mutex_);
  std::thread thread_;
};

}  // namespace celadon
