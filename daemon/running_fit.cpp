#include "daemon/running_fit.h"

namespace celadon {

RunningFit::RunningFit(const RangeFitOptions& options, std::chrono::nanoseconds interval)
    : options_(options),
      interval_(interval),
      last_offer_(std::chrono::steady_clock::now()),
      thread_([this] { work(); }) {}

RunningFit::~RunningFit() {
  {
    const MutexLock lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

void RunningFit::offer(const MomentGrid& sums) {
  const auto now = std::chrono::steady_clock::now();
  if (now - last_offer_ < interval_) return;
  last_offer_ = now;
  const MutexLock lock(mutex_);
  if (busy_ || next_) return;
  next_ = std::make_unique<const MomentGrid>(sums);
  wake_.notify_all();
}

std::optional<double> RunningFit::rms_mm() const {
  const MutexLock lock(mutex_);
  return rms_mm_;
}

void RunningFit::work() {
  while (true) {
    std::unique_ptr<const MomentGrid> sums;
    {
      const MutexLock lock(mutex_);
      busy_ = false;
      while (!stop_ && !next_) wake_.wait(mutex_);
      if (stop_) return;
      sums = std::move(next_);
      busy_ = true;
    }
    const auto fit = fit_sums(*sums, options_);
    const MutexLock lock(mutex_);
    if (fit) rms_mm_ = fit->report.residual_mm.rms;
  }
}

}  // namespace celadon
