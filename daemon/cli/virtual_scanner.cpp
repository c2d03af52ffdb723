#include "daemon/cli/virtual_scanner.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <utility>

namespace celadon::cli {
namespace {

namespace fs = std::filesystem;

constexpr int kStartTime_ms = 20'000;
constexpr int kEndTime_ms = 2'000;

std::string tail_of(const fs::path& log) {
  std::ifstream in(log);
  const std::string text(std::istreambuf_iterator<char>(in), {});
  return text.size() > 600 ? text.substr(text.size() - 600) : text;
}

// The first line from a pipe, or what came before the end or the time limit.
std::string read_line(int fd, int time_ms) {
  std::string line;
  char c = 0;
  pollfd ready{fd, POLLIN, 0};
  while (line.size() < 65536 && ::poll(&ready, 1, time_ms) > 0 && ::read(fd, &c, 1) == 1) {
    if (c == '\n') return line;
    line += c;
  }
  return {};
}

}  // namespace

std::string program_beside(const std::string& name) {
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  const fs::path beside = self.parent_path() / name;
  return !error && fs::exists(beside, error) ? beside.string() : name;
}

ChildProcess::ChildProcess(ChildProcess&& other) noexcept : pid_(std::exchange(other.pid_, -1)) {}
ChildProcess& ChildProcess::operator=(ChildProcess&& other) noexcept {
  if (this != &other) {
    end();
    pid_ = std::exchange(other.pid_, -1);
  }
  return *this;
}
ChildProcess::~ChildProcess() {
  end();
}

tl::expected<std::string, std::string> ChildProcess::start(const std::vector<std::string>& command,
                                                           const fs::path& log) {
  std::array<int, 2> pipe_ends{};
  if (::pipe2(pipe_ends.data(), O_CLOEXEC) != 0) return tl::unexpected("no pipe: " + std::string(std::strerror(errno)));
  std::vector<char*> arguments;
  for (const auto& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  const pid_t parent = ::getpid();
  pid_ = ::fork();
  if (pid_ == 0) {
    ::prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (::getppid() != parent) ::_exit(127);
    // Ctrl-C is for this command, which then ends its children in order.
    ::setpgid(0, 0);
    const int log_fd = ::open(log.c_str(), O_CREAT | O_WRONLY | O_APPEND, 0600);
    ::dup2(pipe_ends[1], STDOUT_FILENO);
    ::dup2(log_fd, STDERR_FILENO);
    ::execvp(arguments[0], arguments.data());
    ::dprintf(STDERR_FILENO, "%s: %s\n", arguments[0], std::strerror(errno));
    ::_exit(127);
  }
  ::close(pipe_ends[1]);
  const std::string line = pid_ > 0 ? read_line(pipe_ends[0], kStartTime_ms) : std::string();
  // The pipe stays open in no one's hands: a later line of the child must not kill it.
  if (pid_ > 0 && !line.empty()) {
    ::fcntl(pipe_ends[0], F_SETFD, FD_CLOEXEC);
    return line;
  }
  ::close(pipe_ends[0]);
  end();
  return tl::unexpected("'" + command[0] + "' did not start: " + tail_of(log));
}

void ChildProcess::end() noexcept {
  if (pid_ <= 0) return;
  ::kill(pid_, SIGTERM);
  for (int waited = 0; waited < kEndTime_ms; waited += 20) {
    if (::waitpid(pid_, nullptr, WNOHANG) == pid_) {
      pid_ = -1;
      return;
    }
    ::poll(nullptr, 0, 20);
  }
  ::kill(pid_, SIGKILL);
  ::waitpid(pid_, nullptr, 0);
  pid_ = -1;
}

tl::expected<VirtualScanner, std::string> VirtualScanner::start(const VirtualScannerOptions& options) {
  VirtualScanner scanner;
  std::string pattern = (fs::temp_directory_path() / "celadon-simulate-XXXXXX").string();
  if (::mkdtemp(pattern.data()) == nullptr) {
    return tl::unexpected("no folder for the virtual scanner's sockets in '" + fs::temp_directory_path().string() +
                          "': " + std::strerror(errno) + "; set TMPDIR");
  }
  scanner.folder_ = pattern;
  const auto in_folder = [&](const char* name) { return (scanner.folder_ / name).string(); };
  const auto ready = scanner.simulator_.start(
      {program_beside("celadon-sim"), "--scene", options.scene, "--seed", std::to_string(options.seed), "--speed",
       "max", "--modbus-tcp", "127.0.0.1:0", "--socket-dir", scanner.folder_.string()},
      in_folder("sim.log"));
  if (!ready) return tl::unexpected(ready.error());
  const auto description = nlohmann::json::parse(*ready, nullptr, false);
  if (!description.is_object() || !description.contains("modbus_url")) {
    return tl::unexpected("celadon-sim said '" + *ready +
                          "' instead of where it serves; do both programs come from one build?");
  }

  ChildProcess truth;
  const auto written = truth.start({program_beside("celadon-sim"), "calibration", "--socket-dir",
                                    scanner.folder_.string(), "-o", in_folder("calibration.toml")},
                                   in_folder("sim.log"));
  if (!written) return tl::unexpected(written.error());

  scanner.server_ = "unix:" + in_folder("api.sock");
  const auto serving = scanner.daemon_.start(
      {program_beside("celadond"), "--device", description["modbus_url"].get<std::string>(), "--camera",
       "sim:" + scanner.folder_.string(), "--calibration", in_folder("calibration.toml"), "--store", in_folder("store"),
       "--http", "0", "--unix-socket", in_folder("api.sock")},
      in_folder("daemon.log"));
  if (!serving) return tl::unexpected(serving.error());
  return scanner;
}

VirtualScanner::~VirtualScanner() {
  daemon_.end();
  simulator_.end();
  std::error_code ignored;
  if (!folder_.empty()) fs::remove_all(folder_, ignored);
}

}  // namespace celadon::cli
