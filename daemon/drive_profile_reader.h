#pragma once
// Profiles of drives and of I/O devices from their files; the grammar is firmware_bridge/DRIVE_PROFILES.md.

#include <filesystem>
#include <string>

#include <tl/expected.hpp>

#include "firmware_bridge/drive_profile.h"

namespace celadon {

/// The error names `name`, line, field, value and remedy.
tl::expected<DriveProfile, std::string> parse_drive_profile(const std::string& text, const std::string& name);
tl::expected<IoProfile, std::string> parse_io_profile(const std::string& text, const std::string& name);

/// Of a file: a path, or the name of a profile that comes with Celadon ("leadshine-rs").
tl::expected<DriveProfile, std::string> read_drive_profile(const std::string& name_or_path);
tl::expected<IoProfile, std::string> read_io_profile(const std::string& name_or_path);

/// Where the profiles lie that come with Celadon: share/celadon/profiles beside the folder of the running program.
std::filesystem::path profile_folder();

}  // namespace celadon
