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

// Starts a program with its output to output_fd and its errors to the log; it ends when this process dies.
pid_t spawn(const std::vector<std::string>& command, int output_fd, const fs::path& log) {
  std::vector<char*> arguments;
  arguments.reserve(command.size() + 1);
  for (const auto& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  const pid_t parent = ::getpid();
  const pid_t child = ::fork();
  if (child != 0) return child;
  ::prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (::getppid() != parent) ::_exit(127);
  // Ctrl-C is for this command, which then ends its children in order.
  ::setpgid(0, 0);
  const int log_fd = ::open(log.c_str(), O_CREAT | O_WRONLY | O_APPEND, 0600);
  ::dup2(output_fd, STDOUT_FILENO);
  ::dup2(log_fd, STDERR_FILENO);
  ::execvp(arguments[0], arguments.data());
  ::dprintf(STDERR_FILENO, "%s: %s\n", arguments[0], std::strerror(errno));
  ::_exit(127);
}

// Runs a program that ends by itself.
tl::expected<void, std::string> run_to_end(const std::vector<std::string>& command, const fs::path& log) {
  const int nowhere = ::open("/dev/null", O_WRONLY | O_CLOEXEC);
  const pid_t child = spawn(command, nowhere, log);
  ::close(nowhere);
  int status = -1;
  if (child > 0) ::waitpid(child, &status, 0);
  if (child > 0 && status == 0) return {};
  return tl::unexpected("'" + command[0] + " " + command[1] + "' failed: " + tail_of(log));
}

}  // namespace

std::string program_beside(const std::string& name) {
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  const fs::path beside = self.parent_path() / name;
  return !error && fs::exists(beside, error) ? beside.string() : name;
}

tl::expected<std::string, std::string> output_of(const std::vector<std::string>& command) {
  std::array<int, 2> pipe_ends{};
  if (::pipe2(pipe_ends.data(), O_CLOEXEC) != 0) return tl::unexpected("no pipe: " + std::string(std::strerror(errno)));
  const pid_t child = spawn(command, pipe_ends[1], "/dev/null");
  ::close(pipe_ends[1]);
  std::string out;
  std::array<char, 4096> bytes;
  for (ssize_t n = 0; child > 0 && (n = ::read(pipe_ends[0], bytes.data(), bytes.size())) > 0;) {
    out.append(bytes.data(), static_cast<std::size_t>(n));
  }
  ::close(pipe_ends[0]);
  int status = -1;
  if (child > 0) ::waitpid(child, &status, 0);
  if (child > 0 && status == 0) return out;
  return tl::unexpected("'" + command[0] + "' cannot be run or failed; do both programs come from one build?");
}

ChildProcess::ChildProcess(ChildProcess&& other) noexcept
    : pid_(std::exchange(other.pid_, -1)), output_fd_(std::exchange(other.output_fd_, -1)) {}
ChildProcess& ChildProcess::operator=(ChildProcess&& other) noexcept {
  if (this != &other) {
    end();
    pid_ = std::exchange(other.pid_, -1);
    output_fd_ = std::exchange(other.output_fd_, -1);
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
  pid_ = spawn(command, pipe_ends[1], log);
  ::close(pipe_ends[1]);
  std::string line = pid_ > 0 ? read_line(pipe_ends[0], kStartTime_ms) : std::string();
  if (!line.empty()) {
    // Kept open: a later line of the child must not end it by SIGPIPE.
    output_fd_ = pipe_ends[0];
    return line;
  }
  ::close(pipe_ends[0]);
  end();
  return tl::unexpected("'" + command[0] + "' did not start: " + tail_of(log));
}

void ChildProcess::end() noexcept {
  if (output_fd_ >= 0) ::close(std::exchange(output_fd_, -1));
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
  std::vector<std::string> simulator{program_beside("celadon-sim"),
                                     "--scene",
                                     options.scene,
                                     "--seed",
                                     std::to_string(options.seed),
                                     "--lasers",
                                     std::to_string(options.lasers),
                                     "--speed",
                                     "max",
                                     "--modbus-tcp",
                                     "127.0.0.1:0",
                                     "--socket-dir",
                                     scanner.folder_.string()};
  if (options.elevation) simulator.emplace_back("--elevation");
  if (options.lift) simulator.emplace_back("--lift");
  constexpr const char* kGoodLamp = "6";
  if (options.textured)
    simulator.insert(simulator.end(), {"--texture", std::to_string(options.seed), "--ambient", kGoodLamp});
  const auto ready = scanner.simulator_.start(simulator, in_folder("sim.log"));
  if (!ready) return tl::unexpected(ready.error());
  const auto description = nlohmann::json::parse(*ready, nullptr, false);
  if (!description.is_object() || !description.contains("modbus_url")) {
    return tl::unexpected("celadon-sim said '" + *ready +
                          "' instead of where it serves; do both programs come from one build?");
  }

  const auto written = run_to_end({program_beside("celadon-sim"), "truth", "--socket-dir", scanner.folder_.string(),
                                   "--calibration", in_folder("calibration.toml")},
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
