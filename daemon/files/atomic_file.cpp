#include "daemon/files/atomic_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdio>

#include "daemon/files/file_problem.h"

namespace celadon {
namespace {

namespace fs = std::filesystem;

/// 0 or the errno of the first failure.
int write_all(int fd, std::string_view bytes) {
  while (!bytes.empty()) {
    // Linux writes at most 0x7ffff000 bytes a call; smaller pieces also let a signal through now and then.
    const ssize_t written = ::write(fd, bytes.data(), std::min<std::size_t>(bytes.size(), std::size_t{1} << 28));
    if (written < 0) {
      if (errno == EINTR) {
        continue;
      }
      return errno;
    }
    bytes.remove_prefix(static_cast<std::size_t>(written));
  }
  return 0;
}

/// A new file beside `file` that no other writer uses; its descriptor, or -1 with errno.
int create_beside(const fs::path& file, fs::path& partial) {
  static std::atomic<unsigned> counter{0};
  const fs::path folder = file.parent_path();
  std::string stem = ".";
  stem.append(file.filename().string(), 0, 200).append(".").append(std::to_string(::getpid())).append("-");
  for (;;) {
    partial = folder / (stem + std::to_string(counter++) + ".partial");
    const int fd = ::open(partial.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0666);
    if (fd >= 0 || errno != EEXIST) {
      return fd;
    }
  }
}

/// The rename itself must survive a power cut. File systems that cannot sync a folder say EINVAL.
int sync_folder(const fs::path& folder) {
  const int fd = ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) {
    // A folder that may be written but not read can hold the file; syncing it is then out of reach.
    return errno == EACCES ? 0 : errno;
  }
  const int error = ::fsync(fd) == 0 || errno == EINVAL || errno == EROFS ? 0 : errno;
  ::close(fd);
  return error;
}

tl::unexpected<WriteError> problem(const fs::path& file, int error) {
  return tl::make_unexpected(WriteError{error, file_problem("cannot write", file, error)});
}

}  // namespace

tl::expected<AtomicFile, WriteError> AtomicFile::create(const fs::path& file) {
  std::error_code ignored;
  if (file.filename().empty() || fs::is_directory(file, ignored)) return problem(file, EISDIR);
  fs::path partial;
  const int fd = create_beside(file, partial);
  if (fd < 0) return problem(file, errno);
  return AtomicFile(file, partial, fd);
}

AtomicFile::AtomicFile(AtomicFile&& other) noexcept
    : file_(std::move(other.file_)),
      partial_(std::exchange(other.partial_, {})),
      fd_(std::exchange(other.fd_, -1)),
      size_(other.size_) {}

AtomicFile::~AtomicFile() {
  if (fd_ >= 0) ::close(fd_);
  if (!partial_.empty()) ::unlink(partial_.c_str());
}

tl::expected<void, WriteError> AtomicFile::append(std::string_view bytes) {
  if (const int error = write_all(fd_, bytes); error != 0) return problem(file_, error);
  size_ += bytes.size();
  return {};
}

tl::expected<void, WriteError> AtomicFile::commit() {
  int error = ::fsync(fd_) == 0 ? 0 : errno;
  // Network file systems report a full disk as late as here.
  if (::close(std::exchange(fd_, -1)) != 0 && error == 0) error = errno;
  if (error == 0 && ::rename(partial_.c_str(), file_.c_str()) != 0) error = errno;
  if (error != 0) return problem(file_, error);
  partial_.clear();
  if (const int folder_error = sync_folder(file_.parent_path()); folder_error != 0) return problem(file_, folder_error);
  return {};
}

tl::expected<void, WriteError> write_file_atomically(const fs::path& file, std::string_view bytes) {
  auto target = AtomicFile::create(file);
  if (!target) return tl::make_unexpected(target.error());
  if (auto written = target->append(bytes); !written) return written;
  return target->commit();
}

}  // namespace celadon
