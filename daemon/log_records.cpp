#include "daemon/log_records.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "daemon/crc32c.h"

namespace celadon {
namespace {

constexpr std::uint16_t kMajor = 1;
constexpr std::uint32_t kMarker = 0x52504C43;  // "CLPR"
constexpr std::uint32_t kLongest = 256u << 20;
constexpr std::size_t kPreambleBytes = 16, kHeadBytes = 24, kHeadSummed = 20, kReadAhead = 1 << 20;

struct Preamble {
  std::uint8_t magic[8];
  std::uint16_t major, minor;
  std::uint32_t zero;
};
static_assert(sizeof(Preamble) == kPreambleBytes);

struct Head {
  std::uint32_t marker;
  std::uint16_t type, zero;
  std::uint32_t length, number, payload_crc, head_crc;
};
static_assert(sizeof(Head) == kHeadBytes);

constexpr std::uint64_t padded(std::uint64_t length) {
  return (length + 7) & ~std::uint64_t{7};
}

bool good_head(const Head& head) {
  return head.marker == kMarker && head.zero == 0 && head.length <= kLongest &&
         head.head_crc == crc32c(&head, kHeadSummed);
}

}  // namespace

// --- writer ---

tl::expected<std::unique_ptr<RecordWriter>, LogError> RecordWriter::create(const std::filesystem::path& file,
                                                                           std::uint16_t minor) {
  const int fd = ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC, 0644);
  if (fd < 0) {
    const int code = errno;
    return tl::make_unexpected(
        LogError{code, "Creating the profile log " + file.string() + " failed: " + std::strerror(code) +
                           (code == EEXIST ? "; a log is never overwritten, give another name."
                                           : "; check that the folder exists, may be written and has free space.")});
  }
  std::unique_ptr<RecordWriter> writer(new RecordWriter(file, fd));
  Preamble preamble{{}, kMajor, minor, 0};
  std::memcpy(preamble.magic, kLogMagic, sizeof kLogMagic);
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(&preamble);
  writer->buffer_.assign(bytes, bytes + sizeof preamble);
  if (auto flushed = writer->flush(); !flushed) return tl::make_unexpected(flushed.error());
  const auto folder = std::filesystem::absolute(file).parent_path();
  const int folder_fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder_fd >= 0) {
    ::fsync(folder_fd);  // file systems without synced folders report an error here that changes nothing
    ::close(folder_fd);
  }
  return writer;
}

RecordWriter::RecordWriter(std::filesystem::path file, int fd) : file_(std::move(file)), fd_(fd) {
  thread_ = std::thread([this] { sync_loop(); });
}

RecordWriter::~RecordWriter() {
  (void)flush();
  {
    const MutexLock lock(mutex_);
    wanted_ = written_;
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
  ::close(fd_);
}

void RecordWriter::put(std::uint16_t type, std::span<const std::uint8_t> payload) {
  if (payload.size() > kLongest) {
    std::fprintf(stderr, "RecordWriter::put: a payload of %zu bytes is over the limit of %u\n", payload.size(),
                 kLongest);
    std::abort();
  }
  Head head{
      kMarker, type, 0, static_cast<std::uint32_t>(payload.size()), number_++, crc32c(payload.data(), payload.size()),
      0};
  head.head_crc = crc32c(&head, kHeadSummed);
  const std::size_t start = buffer_.size();
  buffer_.resize(start + kHeadBytes + padded(payload.size()));
  std::memcpy(buffer_.data() + start, &head, kHeadBytes);
  if (!payload.empty()) std::memcpy(buffer_.data() + start + kHeadBytes, payload.data(), payload.size());
}

LogError RecordWriter::failure(const char* operation, std::uint64_t wanted, int code) const {
  return {code, std::string(operation) + " " + std::to_string(wanted) + " bytes of the profile log " + file_.string() +
                    " failed: " + std::strerror(code) + "; the " + std::to_string(written_) +
                    " bytes written before are kept" +
                    (code == ENOSPC || code == EDQUOT || code == EFBIG ? ", free space on that disk and scan again."
                                                                       : ", check the disk.")};
}

tl::expected<void, LogError> RecordWriter::flush() {
  if (failed_) return tl::make_unexpected(*failed_);
  std::size_t done = 0;
  while (done < buffer_.size()) {
    const ssize_t n = ::write(fd_, buffer_.data() + done, buffer_.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) {
      failed_ = std::make_unique<LogError>(failure("Writing", buffer_.size(), n < 0 ? errno : ENOSPC));
      buffer_.clear();
      // Whole records only. A disk that refuses even this leaves a torn tail, which readers expect.
      [[maybe_unused]] const int cut = ::ftruncate(fd_, static_cast<off_t>(written_));
      return tl::make_unexpected(*failed_);
    }
    done += static_cast<std::size_t>(n);
  }
  written_ += buffer_.size();
  buffer_.clear();
  return {};
}

void RecordWriter::start_sync() {
  const MutexLock lock(mutex_);
  wanted_ = written_;
  wake_.notify_all();
}

tl::expected<void, LogError> RecordWriter::wait_synced() {
  const MutexLock lock(mutex_);
  wanted_ = written_;
  wake_.notify_all();
  while (done_ < wanted_ && sync_errno_ == 0) synced_.wait(mutex_);
  if (sync_errno_ != 0) return tl::make_unexpected(failure("Syncing", wanted_, sync_errno_));
  return {};
}

void RecordWriter::sync_loop() {
  while (true) {
    std::uint64_t target = 0;
    {
      const MutexLock lock(mutex_);
      while (!stop_ && (done_ >= wanted_ || sync_errno_ != 0)) wake_.wait(mutex_);
      if (done_ >= wanted_ || sync_errno_ != 0) return;
      target = wanted_;
    }
    const int code = ::fdatasync(fd_) == 0 ? 0 : errno;
    const MutexLock lock(mutex_);
    if (code != 0 && code != EINVAL) sync_errno_ = code;  // EINVAL: a special file that cannot be synced
    done_ = target;
    synced_.notify_all();
  }
}

// --- reader ---

tl::expected<std::unique_ptr<RecordReader>, LogError> RecordReader::open(const std::filesystem::path& file) {
  const auto refused = [&](int code, const std::string& why) {
    return tl::make_unexpected(LogError{code, "The profile log " + file.string() + " cannot be read: " + why});
  };
  const int fd = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return refused(errno, std::strerror(errno) + std::string("; give an existing log."));
  struct stat status {};
  const bool known = ::fstat(fd, &status) == 0 && S_ISREG(status.st_mode);
  std::unique_ptr<RecordReader> reader(
      new RecordReader(file, fd, known ? static_cast<std::uint64_t>(status.st_size) : 0));
  if (!known) return refused(0, "it is not a regular file; give a log that celadond wrote.");

  const std::uint8_t* bytes = reader->fetch(0, kPreambleBytes);
  if (bytes == nullptr) {
    return refused(0,
                   "it has " + std::to_string(reader->size_) + " bytes, fewer than its preamble; it was never begun.");
  }
  Preamble preamble{};
  std::memcpy(&preamble, bytes, sizeof preamble);
  if (std::memcmp(preamble.magic, kLogMagic, sizeof kLogMagic) != 0) {
    return refused(0, "it does not begin like one (offset 0); give a log that celadond wrote.");
  }
  if (preamble.major != kMajor) {
    return refused(0, "its version is " + std::to_string(preamble.major) + "." + std::to_string(preamble.minor) +
                          "; this program reads version 1, use the program that wrote it.");
  }
  return reader;
}

RecordReader::RecordReader(std::filesystem::path file, int fd, std::uint64_t size)
    : file_(std::move(file)), fd_(fd), size_(size), begin_{kPreambleBytes, 0}, end_(size), buffer_(kReadAhead / 8) {
  rewind();
}

void RecordReader::confine(const RecordMark& begin, const RecordMark& end) {
  begin_ = begin;
  end_ = end.offset;
  confined_ = true;
  rewind();
}

RecordReader::~RecordReader() {
  ::close(fd_);
}

void RecordReader::rewind() {
  offset_ = begin_.offset;
  number_ = begin_.number;
  torn_ = 0;
  error_.clear();
}

/// The bytes at an offset that is a multiple of 8; nullptr when the file ends before or cannot be read.
const std::uint8_t* RecordReader::fetch(std::uint64_t offset, std::size_t bytes) {
  if (offset + bytes > size_) return nullptr;
  auto* data = reinterpret_cast<std::uint8_t*>(buffer_.data());
  if (offset < buffer_start_ || offset + bytes > buffer_start_ + buffer_bytes_) {
    std::size_t kept = 0;
    if (offset >= buffer_start_ && offset < buffer_start_ + buffer_bytes_) {
      kept = static_cast<std::size_t>(buffer_start_ + buffer_bytes_ - offset);
      std::memmove(data, data + (offset - buffer_start_), kept);
    }
    const auto want = static_cast<std::size_t>(std::min<std::uint64_t>(std::max(bytes, kReadAhead), size_ - offset));
    if (buffer_.size() * 8 < want) buffer_.resize((want + 7) / 8);
    data = reinterpret_cast<std::uint8_t*>(buffer_.data());
    buffer_start_ = offset;
    buffer_bytes_ = kept;
    while (buffer_bytes_ < want) {
      const ssize_t n =
          ::pread(fd_, data + buffer_bytes_, want - buffer_bytes_, static_cast<off_t>(offset + buffer_bytes_));
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) {
        error_ = "Reading the profile log " + file_.string() + " failed at offset " +
                 std::to_string(offset + buffer_bytes_) + ": " + (n < 0 ? std::strerror(errno) : "the file was cut") +
                 "; check the disk.";
        return nullptr;
      }
      buffer_bytes_ += static_cast<std::size_t>(n);
    }
  }
  return data + (offset - buffer_start_);
}

/// Damage if a good record follows, else a torn tail.
bool RecordReader::stop_at(const std::string& what) {
  if (!error_.empty()) return false;
  for (std::uint64_t at = offset_ + 8; at + kHeadBytes <= size_; at += 8) {
    const std::uint8_t* bytes = fetch(at, kHeadBytes);
    if (bytes == nullptr) return false;
    Head head{};
    std::memcpy(&head, bytes, sizeof head);
    if (head.marker == kMarker && head.number > number_ && good_head(head)) {
      error_ = "The profile log " + file_.string() + " is damaged: the record number " + std::to_string(number_) +
               " at offset " + std::to_string(offset_) + " " + what + ", and good records go on at offset " +
               std::to_string(at) + "; use the log of another scan or a copy of this one.";
      return false;
    }
  }
  if (confined_) {
    error_ = "The profile log " + file_.string() + " is damaged: the record number " + std::to_string(number_) +
             " at offset " + std::to_string(offset_) + " " + what + ", and was whole up to offset " +
             std::to_string(end_) + " when it was written; use the log of another scan or a copy of this one.";
    return false;
  }
  torn_ = size_ - offset_;
  return false;
}

bool RecordReader::next(Record& record) {
  if (!error_.empty() || offset_ >= end_) return false;
  const std::uint8_t* bytes = fetch(offset_, kHeadBytes);
  if (bytes == nullptr) return stop_at("is cut short");
  Head head{};
  std::memcpy(&head, bytes, sizeof head);
  if (!good_head(head)) return stop_at("has a head that does not match its checksum");
  if (head.number != number_) return stop_at("has the number " + std::to_string(head.number));
  const std::uint64_t whole = kHeadBytes + padded(head.length);
  bytes = fetch(offset_, static_cast<std::size_t>(whole));
  if (bytes == nullptr) return stop_at("is cut short");
  record.payload = {bytes + kHeadBytes, head.length};
  if (offset_ >= verified_) {
    if (crc32c(record.payload.data(), head.length) != head.payload_crc) {
      return stop_at("has a payload that does not match its checksum");
    }
    for (std::size_t i = head.length; i < padded(head.length); ++i) {
      if (bytes[kHeadBytes + i] != 0) return stop_at("has padding that is not zero");
    }
    verified_ = offset_ + whole;
  }
  record.type = head.type;
  record.number = head.number;
  record.offset = offset_;
  offset_ += whole;
  ++number_;
  return true;
}

}  // namespace celadon
