#pragma once
// Which buffers of a source are lent to frames: a lease that is given back twice or outlives its source would read
// freed memory, so both end the program.

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

namespace celadon {

class LeaseBook {
 public:
  explicit LeaseBook(std::string device) : device_(std::move(device)) {}

  void resize(std::size_t buffers) { lent_.assign(buffers, false); }
  void add_buffer() { lent_.push_back(false); }
  bool is_lent(std::uint32_t buffer) const { return lent_.at(buffer); }
  std::size_t count() const { return static_cast<std::size_t>(std::count(lent_.begin(), lent_.end(), true)); }

  void lend(std::uint32_t buffer) { lent_.at(buffer) = true; }
  void take_back(std::uint32_t buffer) noexcept {
    if (buffer >= lent_.size() || !lent_[buffer]) end("a frame was given back that was not lent");
    lent_[buffer] = false;
  }
  /// Ends the program if a frame is still out.
  void require_none(const char* operation) const noexcept {
    if (count() != 0) end(operation);
  }

 private:
  [[noreturn]] void end(const char* what) const noexcept {
    std::fprintf(stderr, "%s: %s with %zu frames lent; destroy every Frame before its FrameSource is stopped\n",
                 device_.c_str(), what, count());
    std::abort();
  }

  std::string device_;
  std::vector<bool> lent_;
};

}  // namespace celadon
