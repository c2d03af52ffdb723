#pragma once
// Files appear under their final names whole or not at all: written beside, synced, renamed.

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

#include <tl/expected.hpp>

namespace celadon {

struct WriteError {
  int errno_value = 0;
  std::string message;
};  ///< ENOSPC and the like, with the remedy

/// A file that grows beside its final name.
class AtomicFile {
 public:
  static tl::expected<AtomicFile, WriteError> create(const std::filesystem::path& file);
  AtomicFile(AtomicFile&& other) noexcept;
  AtomicFile& operator=(AtomicFile&&) = delete;
  /// Without commit() nothing is left.
  ~AtomicFile();

  tl::expected<void, WriteError> append(std::string_view bytes);
  std::uint64_t size() const { return size_; }
  /// Syncs it and gives it its name; another file of that name is replaced.
  /// @pre called once
  tl::expected<void, WriteError> commit();

 private:
  AtomicFile(std::filesystem::path file, std::filesystem::path partial, int fd)
      : file_(std::move(file)), partial_(std::move(partial)), fd_(fd) {}

  std::filesystem::path file_, partial_;  ///< partial_ is empty once it has its name
  int fd_ = -1;
  std::uint64_t size_ = 0;
};

/// Replaces `file` with `bytes`.
tl::expected<void, WriteError> write_file_atomically(const std::filesystem::path& file, std::string_view bytes);

}  // namespace celadon
