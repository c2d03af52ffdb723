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
  enum class Input { none, answers };
  /// first word: name of a program in the build's bin folder; file_size_limit: RLIMIT_FSIZE in bytes, 0: none
  explicit Program(const std::vector<std::string>& command, std::size_t file_size_limit = 0, Input input = Input::none);
  ~Program();
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;
  /// Blocks until the program wrote this text on standard output or ended. @returns whether it did
  bool wait_for_output(const std::string& text);
  /// The same, of text after what was answered last; then writes a line to it. @pre Input::answers
  bool answer(const std::string& question, const std::string& line);
  /// No more answers.
  void hang_up();
  void signal(int number) const;
  Outcome wait();
  pid_t pid() const { return pid_; }
  const std::string& out() const { return out_; }

 private:
  void read_until(const std::string* text, std::size_t from = 0);
  pid_t pid_ = -1;
  int in_fd_ = -1, out_fd_ = -1, err_fd_ = -1;
  std::string out_, err_;
  std::size_t answered_ = 0;  ///< of out_
};

Outcome run(const std::vector<std::string>& command, std::size_t file_size_limit = 0);

}  // namespace celadon::testing
