// What the memory allows: compiled for this very machine, so that nothing is compared with less than it can do.
#include "tests/bench/plain_read.h"

#include <cstring>

namespace celadon {

std::uint64_t plain_read(const double* values, std::size_t count) {
  std::uint64_t sum = 0;
  for (std::size_t k = 0; k < count; ++k) {
    std::uint64_t bits = 0;
    std::memcpy(&bits, values + k, sizeof bits);
    sum += bits;
  }
  return sum;
}

}  // namespace celadon
