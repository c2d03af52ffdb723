#pragma once
// Sums of some of the samples, as a file that is merged with others. Grammar: PARTIAL_SUMS.md.

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/grid_file.h"
#include "fitting/first_look.h"

namespace celadon {

struct PartialSums {
  SumsGrid grid;
  GatheredSamples samples;          ///< over grid.cells, of scattered points without covariances
  std::vector<std::string> inputs;  ///< names of the files that were summed
};

/// The bytes of a part file. Deterministic.
std::string format_part(const PartialSums& part);
/// The inverse. Errors: one sentence with `source`, what is wrong and the remedy.
tl::expected<PartialSums, std::string> parse_part(std::string_view bytes, const std::string& source);

/// A part and what it is told from others by.
struct NamedPart {
  std::string name;
  std::uint32_t checksum = 0;  ///< of its file
  PartialSums sums;
};
tl::expected<NamedPart, std::string> read_part(const std::filesystem::path& file);

/// All as one, in the order of their checksums. Errors: one sentence that names two of them and what they differ in, or
/// that they are the same. @pre at least one
tl::expected<PartialSums, std::string> merge_parts(std::vector<NamedPart> parts);

}  // namespace celadon
