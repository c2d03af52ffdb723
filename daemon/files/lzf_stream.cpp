#include "daemon/files/lzf_stream.h"

#include <algorithm>
#include <cstring>

#include "daemon/files/file_problem.h"

namespace celadon {
namespace {

constexpr std::size_t history = 8192;
constexpr std::size_t largest_item = 264;
constexpr std::size_t largest_read = 32768;
constexpr std::size_t input_bytes = 1U << 16;

}  // namespace

LzfStream::LzfStream(const InputFile& file, std::uint64_t begin, std::uint64_t end)
    : input_(file, begin, end, input_bytes), buffer_(2 * (history + largest_read + largest_item)) {}

bool LzfStream::item() {
  const std::string_view bytes = input_.peek(largest_item);
  const auto broken = [&](const std::string& what) {
    error_ = what + " at byte " + grouped(input_.offset());
    return false;
  };
  if (bytes.empty()) {
    return broken("the compressed block ends too early");
  }
  const auto control = static_cast<unsigned char>(bytes[0]);
  if (control < 32) {
    const std::size_t length = control + 1U;
    if (bytes.size() < length + 1) {
      return broken("the compressed block ends inside a run of literals");
    }
    std::memcpy(buffer_.data() + filled_, bytes.data() + 1, length);
    filled_ += length;
    decoded_ += length;
    input_.skip(length + 1);
    return true;
  }
  std::size_t length = control >> 5U;
  const std::size_t head = length == 7 ? 3 : 2;
  if (bytes.size() < head) {
    return broken("the compressed block ends inside a copy");
  }
  if (length == 7) {
    length += static_cast<unsigned char>(bytes[1]);
  }
  length += 2;
  const std::size_t distance =
      ((control & 0x1FU) << 8U) + static_cast<std::size_t>(static_cast<unsigned char>(bytes[head - 1])) + 1;
  if (distance > decoded_) {
    return broken("a copy from before the start of the compressed block");
  }
  // Source and destination may overlap: byte by byte is the definition.
  for (std::size_t i = 0; i < length; ++i) {
    buffer_[filled_ + i] = buffer_[filled_ + i - distance];
  }
  filled_ += length;
  decoded_ += length;
  input_.skip(head);
  return true;
}

bool LzfStream::fill(std::size_t count) {
  if (buffer_.size() - at_ < count + largest_item) {
    const std::size_t keep = std::min(at_, history);
    std::memmove(buffer_.data(), buffer_.data() + at_ - keep, filled_ - at_ + keep);
    filled_ = filled_ - at_ + keep;
    at_ = keep;
  }
  while (filled_ - at_ < count) {
    if (!error_.empty() || !item()) {
      return false;
    }
  }
  return true;
}

bool LzfStream::read(std::size_t count, char* bytes) {
  if (!fill(count)) {
    return false;
  }
  std::memcpy(bytes, buffer_.data() + at_, count);
  at_ += count;
  return true;
}

bool LzfStream::skip(std::uint64_t count) {
  while (count > 0) {
    const auto piece = static_cast<std::size_t>(std::min<std::uint64_t>(count, largest_read));
    if (!fill(piece)) {
      return false;
    }
    at_ += piece;
    count -= piece;
  }
  return true;
}

}  // namespace celadon
