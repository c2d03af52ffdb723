#pragma once
// Framing of the profile log: numbered, checksummed records in an append-only file. Grammar: PROFILE_LOG.md.

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/thread_annotations.h"

namespace celadon {

/// The first bytes of every log.
inline constexpr std::uint8_t kLogMagic[8] = {0x89, 'C', 'E', 'L', '\r', '\n', 0x1A, '\n'};

/// What went wrong with a log: one sentence with file, offset or number of bytes, and the remedy.
struct LogError {
  int errno_value = 0;
  std::string message;
};

/// Where a record begins.
struct RecordMark {
  std::uint64_t offset = 0;
  std::uint32_t number = 0;
};

/// Appends records. One thread appends; data are synced by a thread of its own, so that a slow disk never holds up
/// capture.
class RecordWriter {
 public:
  /// Creates the file with its preamble, of version 1.`minor`; refuses an existing one. Syncs the folder entry.
  static tl::expected<std::unique_ptr<RecordWriter>, LogError> create(const std::filesystem::path& file,
                                                                      std::uint16_t minor);
  ~RecordWriter();  ///< flushes and syncs what it can
  RecordWriter(const RecordWriter&) = delete;
  RecordWriter& operator=(const RecordWriter&) = delete;

  /// Adds a record to the buffer. @pre payload has at most 256 MiB
  void put(std::uint16_t type, std::span<const std::uint8_t> payload);
  /// Writes the buffer. On failure the file is cut back to whole records, and every later call fails with the same
  /// error.
  tl::expected<void, LogError> flush();
  /// Asks for the data written so far to be synced; returns at once.
  void start_sync() CELADON_EXCLUDES(mutex_);
  /// Waits until everything written has been synced.
  tl::expected<void, LogError> wait_synced() CELADON_EXCLUDES(mutex_);
  /// Bytes in the file.
  std::uint64_t bytes() const { return written_; }
  /// Where the next record will begin.
  RecordMark mark() const { return {written_ + buffer_.size(), number_}; }

 private:
  RecordWriter(std::filesystem::path file, int fd);
  void sync_loop() CELADON_EXCLUDES(mutex_);
  LogError failure(const char* operation, std::uint64_t wanted, int code) const;

  const std::filesystem::path file_;
  const int fd_;
  std::vector<std::uint8_t> buffer_;
  std::uint64_t written_ = 0;
  std::uint32_t number_ = 0;
  std::unique_ptr<LogError> failed_;  ///< of a write

  Mutex mutex_;
  Condition wake_, synced_;
  std::uint64_t wanted_ CELADON_GUARDED_BY(mutex_) = 0, done_
                                                        CELADON_GUARDED_BY(mutex_) = 0;  ///< bytes to be, and synced
  int sync_errno_ CELADON_GUARDED_BY(mutex_) = 0;
  bool stop_ CELADON_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

/// One record as it lies in the reader's buffer, valid until the next call.
struct Record {
  std::uint16_t type = 0;
  std::uint32_t number = 0;
  std::uint64_t offset = 0;
  std::span<const std::uint8_t> payload;  ///< 8-byte aligned
};

/// Reads records, any number of times, in memory that does not grow with the file. Checksums are
/// computed on the first pass.
class RecordReader {
 public:
  /// Reads what the file holds now; what is appended later is not seen.
  static tl::expected<std::unique_ptr<RecordReader>, LogError> open(const std::filesystem::path& file);
  /// Only what lies from one mark to before another. @pre the file was whole up to there: what is not now is damage
  void confine(const RecordMark& begin, const RecordMark& end);
  ~RecordReader();
  RecordReader(const RecordReader&) = delete;
  RecordReader& operator=(const RecordReader&) = delete;

  void rewind();
  /// False at the end of the log, at its torn tail or at damage.
  bool next(Record& record);
  /// Not empty after damage: the sentence with the offsets. A torn tail is no error.
  const std::string& error() const { return error_; }
  /// Bytes at the end that hold no whole record; known after a pass.
  std::uint64_t torn_bytes() const { return torn_; }
  std::uint64_t offset() const { return offset_; }
  const std::filesystem::path& file() const { return file_; }

 private:
  RecordReader(std::filesystem::path file, int fd, std::uint64_t size);
  const std::uint8_t* fetch(std::uint64_t offset, std::size_t bytes);
  bool stop_at(const std::string& what);

  const std::filesystem::path file_;
  const int fd_;
  const std::uint64_t size_;
  RecordMark begin_;
  std::uint64_t end_;                  ///< of what is read
  bool confined_ = false;              ///< known to be whole up to there
  std::vector<std::uint64_t> buffer_;  // of words, for alignment
  std::uint64_t buffer_start_ = 0;
  std::size_t buffer_bytes_ = 0;
  std::uint64_t offset_ = 0, verified_ = 0, torn_ = 0;
  std::uint32_t number_ = 0;
  std::string error_;
};

}  // namespace celadon
