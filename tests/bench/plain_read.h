#pragma once
// The physical limit of a pass over memory.

#include <cstddef>
#include <cstdint>

namespace celadon {

/// Adds up the values' bits as integers: whole vectors, no chain of additions to wait for.
std::uint64_t plain_read(const double* values, std::size_t count);

}  // namespace celadon
