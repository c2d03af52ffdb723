#include "daemon/read_ahead.h"

#include <utility>

namespace celadon {
namespace {

constexpr std::size_t kAhead = 16;  // profiles

}  // namespace

ReadAhead::ReadAhead(ProfileStream& source) : source_(source) {
  rewind();
}

void ReadAhead::halt() {
  {
    const MutexLock lock(mutex_);
    stop_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void ReadAhead::rewind() {
  halt();
  {
    const MutexLock lock(mutex_);
    for (Profile& profile : ready_) spare_.push_back(std::move(profile));
    ready_.clear();
    ended_ = stop_ = false;
  }
  source_.rewind();
  thread_ = std::thread([this] { work(); });
}

const Profile* ReadAhead::next() {
  {
    const MutexLock lock(mutex_);
    while (ready_.empty() && !ended_) changed_.wait(mutex_);
    if (ready_.empty()) return nullptr;
    std::swap(current_, ready_.front());
    spare_.push_back(std::move(ready_.front()));
    ready_.pop_front();
  }
  changed_.notify_all();
  return &current_;
}

void ReadAhead::work() {
  while (true) {
    Profile copy;
    {
      const MutexLock lock(mutex_);
      while (ready_.size() >= kAhead && !stop_) changed_.wait(mutex_);
      if (stop_) return;
      if (!spare_.empty()) {
        copy = std::move(spare_.back());
        spare_.pop_back();
      }
    }
    const Profile* profile = source_.next();
    if (profile != nullptr) copy = *profile;
    {
      const MutexLock lock(mutex_);
      if (profile == nullptr) {
        ended_ = true;
      } else {
        ready_.push_back(std::move(copy));
      }
    }
    changed_.notify_all();
    if (profile == nullptr) return;
  }
}

}  // namespace celadon
