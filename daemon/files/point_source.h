#pragma once
// What every kind of cloud comes down to: three columns of numbers, read in pieces from the first record on.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

namespace celadon {

class PointSource {
 public:
  virtual ~PointSource() = default;
  /// Back to the first record; clears the error.
  virtual void rewind() = 0;
  /// The next up to `count` records into three columns; 0 at the end or after an error.
  virtual std::size_t read(std::size_t count, double* a, double* b, double* c) = 0;
  /// Number of records the header promises.
  virtual std::optional<std::uint64_t> promised() const = 0;
  /// Only records first .. first + count - 1 from now on, and back to the first of them; false: they have no places of
  /// their own. @pre first + count <= promised()
  virtual bool restrict_to(std::uint64_t first, std::uint64_t count) {
    static_cast<void>(first);
    static_cast<void>(count);
    return false;
  }
  /// Not empty after a broken record: one sentence with the place. Records before it were delivered.
  const std::string& error() const { return error_; }

 protected:
  std::string error_;
};

}  // namespace celadon
