#pragma once
// Streaming decoder of LZF, the compression of binary_compressed PCD: items are either a run of 1 - 32 literal bytes or
// a copy of 3 - 264 bytes from at most 8192 bytes back.

#include <cstdint>
#include <string>
#include <vector>

#include "daemon/files/input_file.h"

namespace celadon {

/// Copyable: a copy goes on from the same place, which is how the columns of one block are read side by side.
class LzfStream {
 public:
  /// Decodes the compressed bytes [begin, end) of the file. @pre file outlives the stream
  LzfStream(const InputFile& file, std::uint64_t begin, std::uint64_t end);

  /// Decodes exactly `count` bytes; false at the end of the input or at a broken item, which error() names.
  /// @pre count <= 32768
  bool read(std::size_t count, char* bytes);
  /// Decodes and drops.
  bool skip(std::uint64_t count);
  std::uint64_t decoded() const { return decoded_ - (filled_ - at_); }
  /// All input used, all output taken.
  bool at_end() const { return at_ == filled_ && input_.offset() == input_.end(); }
  const std::string& error() const { return error_; }

 private:
  bool fill(std::size_t count);
  bool item();

  ByteCursor input_;
  std::uint64_t decoded_ = 0;  // bytes decoded so far, taken or not
  std::vector<char> buffer_;   // history, then what waits
  std::size_t at_ = 0, filled_ = 0;
  std::string error_;
};

}  // namespace celadon
