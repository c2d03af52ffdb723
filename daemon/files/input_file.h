#pragma once
// A regular file read in pieces, from several places at once if need be.

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <tl/expected.hpp>

namespace celadon {

/// An open regular file of known size. Immovable reads: any number of cursors share it.
class InputFile {
 public:
  /// Errors: one sentence with the remedy (not found, no permission, a folder, a pipe or device, empty).
  static tl::expected<InputFile, std::string> open(const std::filesystem::path& file);
  InputFile(InputFile&& other) noexcept;
  InputFile& operator=(InputFile&&) = delete;
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;
  ~InputFile();

  const std::filesystem::path& path() const { return path_; }
  std::uint64_t size() const { return size_; }
  /// Reads up to `count` bytes at `offset`: fewer only at the end of the file or after an error, which is kept.
  std::size_t read_at(std::uint64_t offset, char* bytes, std::size_t count) const;
  /// Not empty once a read failed or the file became shorter: the sentence.
  const std::string& error() const { return error_; }

 private:
  InputFile(std::filesystem::path path, int descriptor, std::uint64_t size)
      : path_(std::move(path)), descriptor_(descriptor), size_(size) {}

  std::filesystem::path path_;
  int descriptor_ = -1;
  std::uint64_t size_ = 0;
  mutable std::string error_;
};

/// Bytes of a file one after the other, through a buffer of fixed size.
class ByteCursor {
 public:
  /// @pre file outlives the cursor, begin <= end <= file.size()
  ByteCursor(const InputFile& file, std::uint64_t begin, std::uint64_t end, std::size_t buffer_bytes = 1U << 18);

  /// Offset in the file of the next byte.
  std::uint64_t offset() const { return offset_ - (filled_ - at_); }
  std::uint64_t end() const { return end_; }
  /// At least `count` bytes if the range holds them, else what is left. Valid until the next call.
  /// @pre count <= the buffer's size
  std::string_view peek(std::size_t count);
  /// @pre count <= size of the last peek
  void skip(std::size_t count) { at_ += count; }
  /// Jumps; a jump to an offset inside of what is buffered reads nothing.
  void seek(std::uint64_t offset);
  /// The next line without its end (LF, CR LF), or false at the end of the range. A line longer than the buffer comes
  /// in pieces that `too_long` marks.
  bool line(std::string_view& line, bool& too_long);

 private:
  const InputFile* file_;
  std::uint64_t offset_, end_;
  std::vector<char> buffer_;
  std::size_t at_ = 0, filled_ = 0;
};

}  // namespace celadon
