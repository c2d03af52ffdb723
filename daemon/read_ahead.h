#pragma once
// Profiles read a few ahead in a thread of its own: a fit's passes compute while the log is read, checked and decoded.

#include <cstddef>
#include <deque>
#include <thread>
#include <vector>

#include "daemon/thread_annotations.h"
#include "fitting/profile.h"

namespace celadon {

/// The same profiles in the same order as the stream behind it, which is used by nobody else meanwhile.
class ReadAhead final : public ProfileStream {
 public:
  /// Begins at the first profile. @pre `source` outlives it
  explicit ReadAhead(ProfileStream& source);
  /// The source stands anywhere afterwards and is free to be used.
  ~ReadAhead() override { halt(); }
  ReadAhead(const ReadAhead&) = delete;
  ReadAhead& operator=(const ReadAhead&) = delete;

  void rewind() override CELADON_EXCLUDES(mutex_);
  const Profile* next() override CELADON_EXCLUDES(mutex_);

 private:
  void halt() CELADON_EXCLUDES(mutex_);
  void work() CELADON_EXCLUDES(mutex_);

  ProfileStream& source_;  ///< of the thread while it runs
  Profile current_;        ///< what next() gave last
  Mutex mutex_;
  Condition changed_;
  std::deque<Profile> ready_ CELADON_GUARDED_BY(mutex_);
  std::vector<Profile> spare_ CELADON_GUARDED_BY(mutex_);  ///< their memory is used again
  bool ended_ CELADON_GUARDED_BY(mutex_) = false, stop_ CELADON_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

}  // namespace celadon
