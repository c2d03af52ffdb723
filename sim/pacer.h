#pragma once
// How the device's clock runs: with real time, or in lock-step, only by declared waits and bus time while a client that
// waits is connected. CONTROL.md.

#include <poll.h>

#include <cstdint>
#include <set>

#include "sim/device_model.h"

namespace celadon::sim {

/// CLOCK_MONOTONIC.
std::int64_t monotonic_ns();

class Pacer {
 public:
  Pacer(DeviceModel& model, bool lock_step);

  bool lock_step() const { return lock_step_; }
  /// Time stands still unless someone declares a wait.
  bool holds() const { return lock_step_ && (!ever_declared_ || !waiters_.empty()); }
  /// Unless time stands still: brings the device to the present.
  void catch_up();
  /// In lock-step: time that the bus takes. In real time it passes by itself.
  void spend(std::int64_t duration_ns);
  /// A client (any number that is unique among connections) waits: from now on time stands between its waits.
  void declare(std::uint64_t client);
  /// Its connection is closed; with the last waiter gone the device runs on in real time.
  void forget(std::uint64_t client);
  /// A new number for a connection.
  std::uint64_t new_client() { return ++clients_; }
  /// Real time left until the device's clock shows that instant; INT64_MAX is never.
  std::int64_t real_time_until(std::int64_t device_ns) const {
    return device_ns == INT64_MAX ? INT64_MAX : device_ns - offset_ns_ - monotonic_ns();
  }

 private:
  DeviceModel& model_;
  bool lock_step_, ever_declared_ = false;
  std::int64_t offset_ns_;  ///< device time - real time
  std::set<std::uint64_t> waiters_;
  std::uint64_t clients_ = 0;
};

/// One set of connections in the poll loop.
class Service {
 public:
  virtual ~Service() = default;
  /// Appends what it waits for.
  virtual void collect(std::vector<pollfd>& polls) = 0;
  /// Serves what is ready; `polls` are the entries it appended. Also called when nothing is, for replies whose time
  /// came.
  virtual void serve(const pollfd* polls, std::size_t count) = 0;
};

}  // namespace celadon::sim
