#pragma once
// Programs of the build run as a user runs them: arguments in, exit code and text out.

#include <sys/types.h>

#include <filesystem>
#include <string>
#include <vector>

namespace celadon::testing {

struct Outcome {
  int exit_code = -1;  ///< -SIGNAL when killed by one
  std::string out, err;
};

/// Folder that is removed at the end.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
  std::filesystem::path write(const std::string& name, const std::string& bytes) const;

 private:
  std::filesystem::path path_;
};

/// A program of the build folder that runs until it ends or is ended.
class Program {
 public:
  /// first word: name of a program in the build's bin folder; file_size_limit: RLIMIT_FSIZE in bytes, 0: none
  explicit Program(const std::vector<std::string>& command, std::size_t file_size_limit = 0);
  ~Program();
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;
  /// Blocks until the program wrote this text on standard output or ended. @returns whether it did
  bool wait_for_output(const std::string& text);
  void signal(int number) const;
  Outcome wait();
  pid_t pid() const { return pid_; }
  const std::string& out() const { return out_; }

 private:
  void read_until(const std::string* text);
  pid_t pid_ = -1;
  int out_fd_ = -1, err_fd_ = -1;
  std::string out_, err_;
};

Outcome run(const std::vector<std::string>& command, std::size_t file_size_limit = 0);
std::string read_file(const std::filesystem::path& file);

}  // namespace celadon::testing
