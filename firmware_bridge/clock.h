#pragma once
#include <cerrno>
#include <cstdint>
#include <ctime>

namespace celadon {

/// The host clock that device access runs on: real time, or the virtual scanner's declared waits. Used by one thread.
class Clock {
 public:
  virtual ~Clock() = default;
  virtual std::int64_t now_ns() = 0;
  /// Returns at or after the given time.
  virtual void sleep_until(std::int64_t time_ns) = 0;
  /// Whether its time passes by itself, so that a wait may also end early.
  virtual bool is_real() const { return false; }
};

/// CLOCK_MONOTONIC.
class MonotonicClock final : public Clock {
 public:
  std::int64_t now_ns() override {
    timespec t{};
    clock_gettime(CLOCK_MONOTONIC, &t);
    return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
  }
  void sleep_until(std::int64_t time_ns) override {
    const timespec t{time_ns / 1'000'000'000, time_ns % 1'000'000'000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr) == EINTR) {
    }
  }
  bool is_real() const override { return true; }
};

}  // namespace celadon
