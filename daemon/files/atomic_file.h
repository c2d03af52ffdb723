#pragma once
// Files appear under their final names whole or not at all: written beside, synced, renamed.

#include <filesystem>
#include <string>
#include <string_view>

#include <tl/expected.hpp>

namespace celadon {

struct WriteError {
  int errno_value = 0;
  std::string message;
};  ///< ENOSPC and the like, with the remedy

/// Replaces `file` with `bytes`.
tl::expected<void, WriteError> write_file_atomically(const std::filesystem::path& file, std::string_view bytes);

}  // namespace celadon
