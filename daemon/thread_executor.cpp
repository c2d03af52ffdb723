#include "daemon/thread_executor.h"

#include <algorithm>
#include <atomic>
#include <future>
#include <thread>
#include <vector>

namespace celadon {

void run_on_all_cores(int count, const std::function<void(int)>& task) {
  std::atomic<int> next{0};
  const auto work = [&] {
    for (int k = next++; k < count; k = next++) task(k);
  };
  std::vector<std::future<void>> others;
  const int threads = std::min(count, static_cast<int>(std::thread::hardware_concurrency()));
  for (int k = 1; k < threads; ++k) others.push_back(std::async(std::launch::async, work));
  work();
  for (auto& other : others) other.get();
}

}  // namespace celadon
