#include "daemon/export/cad_client.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "daemon/export/cad_protocol.h"
#include "daemon/files/atomic_file.h"

namespace celadon {
namespace {

namespace fs = std::filesystem;
using SteadyClock = std::chrono::steady_clock;

std::string errno_text(int value) {
  return std::generic_category().message(value);
}

/// Beside the running program, then on the PATH.
std::optional<fs::path> find_celadon_cad() {
  const auto runnable = [](const fs::path& path) {
    std::error_code ignored;
    return fs::is_regular_file(path, ignored) && ::access(path.c_str(), X_OK) == 0;
  };
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  if (!error && runnable(self.parent_path() / "celadon-cad")) {
    return self.parent_path() / "celadon-cad";
  }
  const char* path = std::getenv("PATH");
  std::string_view rest = path == nullptr ? "/usr/local/bin:/usr/bin:/bin" : path;
  while (!rest.empty()) {
    const std::string_view folder = rest.substr(0, rest.find(':'));
    rest.remove_prefix(std::min(rest.size(), folder.size() + 1));
    if (!folder.empty() && runnable(fs::path(folder) / "celadon-cad")) {
      return fs::path(folder) / "celadon-cad";
    }
  }
  return std::nullopt;
}

/// A stream socket with a deadline for everything that passes it.
class Conversation {
 public:
  enum class Outcome { good, closed, late };
  Conversation(int socket, int limit_s)
      : socket_(socket), deadline_(SteadyClock::now() + std::chrono::seconds(limit_s)) {}

  Outcome send(std::string_view bytes) {
    while (!bytes.empty()) {
      if (!wait_for(POLLOUT)) {
        return Outcome::late;
      }
      const ssize_t sent = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
      if (sent < 0 && errno != EINTR && errno != EAGAIN) {
        return Outcome::closed;
      }
      bytes.remove_prefix(static_cast<std::size_t>(std::max<ssize_t>(sent, 0)));
    }
    return Outcome::good;
  }

  Outcome receive(char* bytes, std::size_t count) {
    while (count > 0) {
      if (!wait_for(POLLIN)) {
        return Outcome::late;
      }
      const ssize_t got = ::recv(socket_, bytes, count, MSG_DONTWAIT);
      if (got == 0 || (got < 0 && errno != EINTR && errno != EAGAIN)) {
        return Outcome::closed;
      }
      if (got > 0) {
        bytes += got;
        count -= static_cast<std::size_t>(got);
      }
    }
    return Outcome::good;
  }

 private:
  bool wait_for(short events) const {
    for (;;) {
      const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(deadline_ - SteadyClock::now()).count();
      pollfd poll_fd{socket_, events, 0};
      const int ready = ::poll(&poll_fd, 1, static_cast<int>(std::max<std::int64_t>(left, 0)));
      if (ready > 0) {
        return true;
      }
      if (ready == 0 && left <= 0) {
        return false;
      }
    }
  }

  int socket_;
  SteadyClock::time_point deadline_;
};

/// The helper's answer, as far as it came.
struct Answer {
  Conversation::Outcome outcome = Conversation::Outcome::good;
  CadMessage message;
  std::string problem;  ///< what made no sense in it
};

Answer ask(Conversation& conversation, const std::string& request) {
  Answer answer;
  answer.outcome = conversation.send(request);
  if (answer.outcome != Conversation::Outcome::good) {
    return answer;
  }
  std::string line;
  while (line.size() < cad_first_line_limit) {
    char byte = 0;
    answer.outcome = conversation.receive(&byte, 1);
    if (answer.outcome != Conversation::Outcome::good || byte == '\n') {
      break;
    }
    line += byte;
  }
  if (answer.outcome != Conversation::Outcome::good) {
    return answer;
  }
  const auto sizes = decode_first_line(line);
  if (!sizes) {
    answer.problem = sizes.error();
    return answer;
  }
  std::string head(sizes->head, '\0');
  answer.outcome = conversation.receive(head.data(), head.size());
  if (answer.outcome != Conversation::Outcome::good) {
    return answer;
  }
  answer.message.payload.resize(sizes->payload);
  answer.outcome = conversation.receive(answer.message.payload.data(), answer.message.payload.size());
  if (answer.outcome == Conversation::Outcome::good) {
    answer.message.head = nlohmann::json::parse(head, nullptr, false);
    if (!answer.message.head.is_object()) {
      answer.problem = "its head is not a JSON object";
    }
  }
  return answer;
}

}  // namespace

tl::expected<CadWorker, std::string> CadWorker::start() {
  const auto program = find_celadon_cad();
  if (!program) {
    return tl::make_unexpected(
        std::string("cannot write STEP: celadon-cad is not installed beside this program or on the PATH; build Celadon "
                    "with OpenCASCADE (libocct-data-exchange-dev), or take STL, PLY or surface.json"));
  }
  int sockets[2] = {-1, -1};
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, sockets) != 0) {
    return tl::make_unexpected("cannot start " + program->string() + ": " + errno_text(errno) +
                               "; close other programs or raise the limit of open files (ulimit -n)");
  }
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, sockets[1], STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, sockets[1], STDOUT_FILENO);
  // In a process group of its own: Ctrl-C is for the daemon, which ends the helper by closing the connection.
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  sigset_t none;
  sigset_t all;
  sigemptyset(&none);
  sigfillset(&all);
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setsigdefault(&attributes, &all);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
  std::string name = program->string();
  char* arguments[] = {name.data(), nullptr};
  pid_t pid = -1;
  const int error = ::posix_spawn(&pid, program->c_str(), &actions, &attributes, arguments, environ);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  ::close(sockets[1]);
  if (error != 0) {
    ::close(sockets[0]);
    return tl::make_unexpected("cannot start " + name + ": " + errno_text(error) + "; reinstall it");
  }
  return CadWorker(pid, sockets[0]);
}

CadWorker::CadWorker(CadWorker&& other) noexcept
    : pid_(std::exchange(other.pid_, -1)), socket_(std::exchange(other.socket_, -1)) {}

CadWorker& CadWorker::operator=(CadWorker&& other) noexcept {
  if (this != &other) {
    stop();
    pid_ = std::exchange(other.pid_, -1);
    socket_ = std::exchange(other.socket_, -1);
  }
  return *this;
}

CadWorker::~CadWorker() {
  stop();
}

void CadWorker::stop() {
  if (socket_ >= 0) {
    ::close(std::exchange(socket_, -1));
  }
  if (pid_ > 0) {
    ::kill(pid_, SIGKILL);
    while (::waitpid(pid_, nullptr, 0) < 0 && errno == EINTR) {
    }
    pid_ = -1;
  }
}

bool CadWorker::alive() {
  if (pid_ <= 0) {
    return false;
  }
  const pid_t ended = ::waitpid(pid_, nullptr, WNOHANG);
  if (ended == 0) {
    return true;
  }
  pid_ = -1;
  stop();
  return false;
}

std::string CadWorker::cause_of_end() {
  // A process that is on its way out keeps its own cause; one that only closed its connection must not be waited for.
  ::kill(pid_, SIGKILL);
  int status = 0;
  pid_t ended = 0;
  do {
    ended = ::waitpid(pid_, &status, 0);
  } while (ended < 0 && errno == EINTR);
  pid_ = -1;
  if (ended > 0 && WIFSIGNALED(status)) {
    return "was ended by signal " + std::to_string(WTERMSIG(status)) + " (" + ::strsignal(WTERMSIG(status)) + ")";
  }
  return "ended with exit code " + std::to_string(WEXITSTATUS(status)) + " without an answer";
}

tl::expected<CadResult, std::string> CadWorker::write_step(std::span<const NurbsSurface> walls, const fs::path& file,
                                                           const CadOptions& options) {
  if (options.time_limit_s <= 0) {
    throw std::invalid_argument("CadWorker::write_step: time_limit_s is " + std::to_string(options.time_limit_s));
  }
  const std::string request = encode(step_request(walls, options));
  if (!alive()) {
    auto fresh = start();
    if (!fresh) {
      return tl::make_unexpected(fresh.error());
    }
    *this = std::move(*fresh);
  }
  const auto fail = [&](const std::string& why) {
    stop();
    return tl::make_unexpected("cannot write " + file.string() + ": " + why +
                               "; nothing was written; STL, PLY and surface.json hold the same surface");
  };
  Conversation conversation(socket_, options.time_limit_s);
  Answer answer = ask(conversation, request);
  if (answer.outcome == Conversation::Outcome::late) {
    return fail("celadon-cad did not answer within " + std::to_string(options.time_limit_s) + " s and was ended");
  }
  if (answer.outcome == Conversation::Outcome::closed) {
    return fail("celadon-cad " + cause_of_end());
  }
  if (!answer.problem.empty()) {
    return fail("celadon-cad gave an answer of another kind (" + answer.problem +
                "); install celadon-cad and this program from one build");
  }
  const nlohmann::json& head = answer.message.head;
  if (head.contains("error")) {
    return fail(head.value("error", ""));
  }
  stop();
  if (const auto written = write_file_atomically(file, answer.message.payload); !written) {
    return tl::make_unexpected(written.error().message);
  }
  return CadResult{head.value("volume_mm3", 0.0), head.value("valid", false), head.value("faces", 0),
                   head.value("closed", true)};
}

tl::expected<CadResult, std::string> write_step(std::span<const NurbsSurface> walls, const fs::path& file,
                                                const CadOptions& options) {
  auto worker = CadWorker::start();
  if (!worker) {
    return tl::make_unexpected(worker.error());
  }
  return worker->write_step(walls, file, options);
}

}  // namespace celadon
