#pragma once
// The calibration file of a machine, replaced by a newer one.

#include <filesystem>
#include <string>
#include <string_view>

#include <tl/expected.hpp>

#include "daemon/files/atomic_file.h"

namespace celadon {

/// Replaces the file whole, so that there is a calibration at every instant. The one before is kept beside it with its
/// date in the name: scanner.toml as scanner-2026-01-31T12-00-00Z.toml.
/// @param previous_date  of the calibration in the file; ignored if there is no file
/// @returns where the one before is kept; empty: there was none
tl::expected<std::filesystem::path, WriteError> replace_calibration(const std::filesystem::path& file,
                                                                    std::string_view text,
                                                                    const std::string& previous_date);

}  // namespace celadon
