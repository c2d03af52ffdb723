#pragma once
// The cores of this machine for independent tasks.

#include <functional>

namespace celadon {

/// An Executor (fitting/executor.h): runs task(0) .. task(count - 1) on as many threads as there are cores, the
/// caller's among them. Throws what a task threw, when all have ended.
void run_on_all_cores(int count, const std::function<void(int)>& task);

}  // namespace celadon
