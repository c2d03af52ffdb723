#include "sim/pacer.h"

#include <ctime>

namespace celadon::sim {

std::int64_t monotonic_ns() {
  timespec t{};
  clock_gettime(CLOCK_MONOTONIC, &t);
  return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
}

Pacer::Pacer(DeviceModel& model, bool lock_step)
    : model_(model), lock_step_(lock_step), offset_ns_(lock_step ? model.now_ns() - monotonic_ns() : 0) {}

void Pacer::catch_up() {
  if (!holds()) model_.advance_to(monotonic_ns() + offset_ns_);
}

void Pacer::spend(std::int64_t duration_ns) {
  if (holds()) {
    model_.advance_to(model_.now_ns() + duration_ns);
  } else {
    catch_up();
  }
}

void Pacer::declare(std::uint64_t client) {
  catch_up();
  ever_declared_ = true;
  waiters_.insert(client);
}

void Pacer::forget(std::uint64_t client) {
  if (waiters_.erase(client) != 0 && waiters_.empty()) offset_ns_ = model_.now_ns() - monotonic_ns();
}

}  // namespace celadon::sim
