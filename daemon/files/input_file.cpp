#include "daemon/files/input_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "daemon/files/file_problem.h"

namespace celadon {

tl::expected<InputFile, std::string> InputFile::open(const std::filesystem::path& file) {
  // O_NONBLOCK: opening a pipe that nobody writes to must not wait.
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor < 0) {
    return tl::make_unexpected(file_problem("cannot open", file, errno));
  }
  struct stat status {};
  const int failed = ::fstat(descriptor, &status) == 0 ? 0 : errno;
  const auto refuse = [&](std::string why) {
    ::close(descriptor);
    return tl::make_unexpected(std::move(why));
  };
  if (failed != 0) {
    return refuse(file_problem("cannot open", file, failed));
  }
  if (S_ISDIR(status.st_mode)) {
    return refuse(file_problem("cannot read", file, EISDIR));
  }
  if (!S_ISREG(status.st_mode)) {
    return refuse("cannot read " + file.string() + ": it is a pipe or device, and it is read more than once; " +
                  "save it as a file first");
  }
  if (status.st_size == 0) {
    return refuse(file.string() + " is empty (0 bytes); export or copy it again");
  }
  ::posix_fadvise(descriptor, 0, 0, POSIX_FADV_SEQUENTIAL);
  return InputFile(file, descriptor, static_cast<std::uint64_t>(status.st_size));
}

InputFile::InputFile(InputFile&& other) noexcept
    : path_(std::move(other.path_)),
      descriptor_(std::exchange(other.descriptor_, -1)),
      size_(other.size_),
      error_(std::move(other.error_)) {}

InputFile::~InputFile() {
  if (descriptor_ >= 0) {
    ::close(descriptor_);
  }
}

std::size_t InputFile::read_at(std::uint64_t offset, char* bytes, std::size_t count) const {
  std::size_t done = 0;
  while (done < count) {
    const ssize_t got = ::pread(descriptor_, bytes + done, count - done, static_cast<off_t>(offset + done));
    if (got < 0 && errno == EINTR) {
      continue;
    }
    if (got < 0) {
      error_ = file_problem("cannot read", path_, errno);
      break;
    }
    if (got == 0) {
      if (offset + done < size_) {
        error_ = path_.string() + " became shorter while it was read: it ends at byte " + grouped(offset + done) +
                 " instead of " + grouped(size_) + "; wait until it is complete";
      }
      break;
    }
    done += static_cast<std::size_t>(got);
  }
  return done;
}

ByteCursor::ByteCursor(const InputFile& file, std::uint64_t begin, std::uint64_t end, std::size_t buffer_bytes)
    : file_(&file), offset_(begin), end_(end), buffer_(buffer_bytes) {}

std::string_view ByteCursor::peek(std::size_t count) {
  if (filled_ - at_ < count) {
    std::memmove(buffer_.data(), buffer_.data() + at_, filled_ - at_);
    filled_ -= at_;
    at_ = 0;
    const auto room = static_cast<std::size_t>(std::min<std::uint64_t>(buffer_.size() - filled_, end_ - offset_));
    const std::size_t got = file_->read_at(offset_, buffer_.data() + filled_, room);
    if (got < room) {
      end_ = offset_ + got;
    }
    offset_ += got;
    filled_ += got;
  }
  return {buffer_.data() + at_, filled_ - at_};
}

void ByteCursor::seek(std::uint64_t offset) {
  const std::uint64_t buffered_from = offset_ - filled_;
  if (offset >= buffered_from && offset <= offset_) {
    at_ = static_cast<std::size_t>(offset - buffered_from);
    return;
  }
  offset_ = std::min(offset, end_);
  at_ = filled_ = 0;
}

bool ByteCursor::line(std::string_view& line, bool& too_long) {
  too_long = false;
  std::string_view bytes{buffer_.data() + at_, filled_ - at_};
  std::size_t end = bytes.find('\n');
  if (end == std::string_view::npos) {
    bytes = peek(buffer_.size());
    end = bytes.find('\n');
  }
  if (bytes.empty()) {
    return false;
  }
  if (end == std::string_view::npos) {
    too_long = bytes.size() == buffer_.size();
    end = bytes.size();
    at_ += end;
  } else {
    at_ += end + 1;
  }
  line = bytes.substr(0, end);
  if (!line.empty() && line.back() == '\r') {
    line.remove_suffix(1);
  }
  return true;
}

}  // namespace celadon
