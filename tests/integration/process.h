#pragma once
// Programs of the build run as a user runs them: arguments in, exit code and text out.

#include <sys/types.h>

#include <string>
#include <vector>

#include "tests/temporary_folder.h"

namespace celadon::testing {

struct Outcome {
  int exit_code = -1;  ///< -SIGNAL when killed by one
  std::string out, err;
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

}  // namespace celadon::testing
