#include "tests/integration/process.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <stdexcept>

#include "tests/build_paths.h"

namespace celadon::testing {

Program::Program(const std::vector<std::string>& command, std::size_t file_size_limit, Input input) {
  std::array<int, 2> in{-1, -1}, out{}, err{};
  if (::pipe2(out.data(), O_CLOEXEC) != 0 || ::pipe2(err.data(), O_CLOEXEC) != 0 ||
      (input == Input::answers && ::pipe2(in.data(), O_CLOEXEC) != 0))
    throw std::runtime_error("no pipe");
  std::vector<std::string> words = command;
  words[0] = std::string(CELADON_BIN_DIR) + "/" + words[0];
  std::vector<char*> arguments;
  for (auto& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  pid_ = ::fork();
  if (pid_ == 0) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    ::dup2(input == Input::answers ? in[0] : ::open("/dev/null", O_RDONLY), STDIN_FILENO);
    ::dup2(out[1], STDOUT_FILENO);
    ::dup2(err[1], STDERR_FILENO);
    if (file_size_limit != 0) {
      std::signal(SIGXFSZ, SIG_IGN);
      const rlimit limit{file_size_limit, file_size_limit};
      ::setrlimit(RLIMIT_FSIZE, &limit);
    }
    ::execv(arguments[0], arguments.data());
    ::_exit(126);
  }
  if (input == Input::answers) ::close(in[0]);
  ::close(out[1]);
  ::close(err[1]);
  in_fd_ = in[1];
  out_fd_ = out[0];
  err_fd_ = err[0];
}

Program::~Program() {
  if (pid_ > 0) {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  hang_up();
  if (out_fd_ >= 0) ::close(out_fd_);
  if (err_fd_ >= 0) ::close(err_fd_);
}

void Program::read_until(const std::string* text, std::size_t from) {
  while (out_fd_ >= 0 || err_fd_ >= 0) {
    if (text != nullptr && out_.find(*text, from) != std::string::npos) return;
    std::array<pollfd, 2> fds{pollfd{out_fd_, POLLIN, 0}, pollfd{err_fd_, POLLIN, 0}};
    ::poll(fds.data(), fds.size(), -1);
    const auto drain = [](int& fd, short events, std::string& into) {
      if (fd < 0 || events == 0) return;
      std::array<char, 65536> piece{};
      const ssize_t got = ::read(fd, piece.data(), piece.size());
      if (got <= 0) {
        ::close(fd);
        fd = -1;
      } else {
        into.append(piece.data(), static_cast<std::size_t>(got));
      }
    };
    drain(out_fd_, fds[0].revents, out_);
    drain(err_fd_, fds[1].revents, err_);
  }
}

bool Program::wait_for_output(const std::string& text) {
  read_until(&text);
  return out_.find(text) != std::string::npos;
}

bool Program::answer(const std::string& question, const std::string& line) {
  read_until(&question, answered_);
  const std::size_t at = out_.find(question, answered_);
  if (at == std::string::npos) return false;
  answered_ = at + question.size();
  const std::string whole = line + "\n";
  return ::write(in_fd_, whole.data(), whole.size()) == static_cast<ssize_t>(whole.size());
}

void Program::hang_up() {
  if (in_fd_ >= 0) ::close(in_fd_);
  in_fd_ = -1;
}

void Program::signal(int number) const {
  ::kill(pid_, number);
}

Outcome Program::wait() {
  read_until(nullptr);
  int status = 0;
  ::waitpid(pid_, &status, 0);
  pid_ = -1;
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status), out_, err_};
}

Outcome run(const std::vector<std::string>& command, std::size_t file_size_limit) {
  return Program(command, file_size_limit).wait();
}

}  // namespace celadon::testing
