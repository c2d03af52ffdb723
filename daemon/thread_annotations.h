#pragma once
// Clang's thread-safety analysis (-Wthread-safety): which mutex protects which member is checked at compile time.

#include <chrono>
#include <condition_variable>
#include <mutex>

#if defined(__clang__)
#define CELADON_ANNOTATION(x) __attribute__((x))
#else
#define CELADON_ANNOTATION(x)
#endif

#define CELADON_CAPABILITY(x) CELADON_ANNOTATION(capability(x))
#define CELADON_SCOPED_CAPABILITY CELADON_ANNOTATION(scoped_lockable)
#define CELADON_GUARDED_BY(x) CELADON_ANNOTATION(guarded_by(x))
#define CELADON_REQUIRES(...) CELADON_ANNOTATION(requires_capability(__VA_ARGS__))
#define CELADON_EXCLUDES(...) CELADON_ANNOTATION(locks_excluded(__VA_ARGS__))
#define CELADON_ACQUIRE(...) CELADON_ANNOTATION(acquire_capability(__VA_ARGS__))
#define CELADON_RELEASE(...) CELADON_ANNOTATION(release_capability(__VA_ARGS__))

namespace celadon {

/// std::mutex that the analysis knows.
class CELADON_CAPABILITY("mutex") Mutex {
 public:
  void lock() CELADON_ACQUIRE() { mutex_.lock(); }
  void unlock() CELADON_RELEASE() { mutex_.unlock(); }

 private:
  std::mutex mutex_;
};

/// Holds a Mutex for its lifetime.
class CELADON_SCOPED_CAPABILITY MutexLock {
 public:
  explicit MutexLock(Mutex& mutex) CELADON_ACQUIRE(mutex) : mutex_(mutex) { mutex_.lock(); }
  ~MutexLock() CELADON_RELEASE() { mutex_.unlock(); }
  MutexLock(const MutexLock&) = delete;
  MutexLock& operator=(const MutexLock&) = delete;

 private:
  Mutex& mutex_;
};

/// A condition tied to a Mutex that the caller holds; check the condition in a loop around wait.
class Condition {
 public:
  void wait(Mutex& mutex) CELADON_REQUIRES(mutex) { condition_.wait(mutex); }
  void wait_for(Mutex& mutex, std::chrono::nanoseconds time) CELADON_REQUIRES(mutex) {
    condition_.wait_for(mutex, time);
  }
  void notify_all() { condition_.notify_all(); }

 private:
  std::condition_variable_any condition_;
};

}  // namespace celadon
