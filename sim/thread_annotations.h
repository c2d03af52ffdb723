#pragma once
// Clang's thread-safety attributes (no effect under g++) and a mutex that carries them.

#include <condition_variable>
#include <mutex>

#if defined(__clang__)
#define CELADON_SIM_ATTRIBUTE(x) __attribute__((x))
#else
#define CELADON_SIM_ATTRIBUTE(x)
#endif

#define SIM_CAPABILITY(x) CELADON_SIM_ATTRIBUTE(capability(x))
#define SIM_SCOPED_CAPABILITY CELADON_SIM_ATTRIBUTE(scoped_lockable)
#define SIM_GUARDED_BY(x) CELADON_SIM_ATTRIBUTE(guarded_by(x))
#define SIM_REQUIRES(x) CELADON_SIM_ATTRIBUTE(requires_capability(x))
#define SIM_ACQUIRE(...) CELADON_SIM_ATTRIBUTE(acquire_capability(__VA_ARGS__))
#define SIM_RELEASE(...) CELADON_SIM_ATTRIBUTE(release_capability(__VA_ARGS__))

namespace celadon::sim {

/// std::mutex with annotations.
class SIM_CAPABILITY("mutex") Mutex {
 public:
  void lock() SIM_ACQUIRE() { mutex_.lock(); }
  void unlock() SIM_RELEASE() { mutex_.unlock(); }

 private:
  std::mutex mutex_;
};

/// Holds a Mutex for a scope.
class SIM_SCOPED_CAPABILITY MutexLock {
 public:
  explicit MutexLock(Mutex& mutex) SIM_ACQUIRE(mutex) : mutex_(mutex) { mutex_.lock(); }
  ~MutexLock() SIM_RELEASE() { mutex_.unlock(); }
  MutexLock(const MutexLock&) = delete;
  MutexLock& operator=(const MutexLock&) = delete;

 private:
  Mutex& mutex_;
};

}  // namespace celadon::sim
