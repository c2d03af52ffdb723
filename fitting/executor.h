#pragma once
// How a caller lends its threads.

#include <functional>

namespace celadon {

/// Runs task(0) .. task(count - 1), in parallel where it can, and returns when all are done. What a task gives must not
/// depend on the others, so that results have the same bits however many threads there are.
using Executor = std::function<void(int count, const std::function<void(int)>& task)>;

/// On the caller's thread alone.
inline void run_in_turn(int count, const std::function<void(int)>& task) {
  for (int k = 0; k < count; ++k) task(k);
}

}  // namespace celadon
