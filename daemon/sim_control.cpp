#include "daemon/sim_control.h"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace celadon {
namespace {

constexpr int kVersion = 1;
constexpr std::size_t kLongestAnswer = 1 << 20;
constexpr timeval kAnswerLimit{20, 0};
// Requests sent ahead of their answers: together they fit into a socket buffer, so that neither side blocks the other.
constexpr std::size_t kAhead = 64;

}  // namespace

std::string SimControl::lost(const char* operation, const char* cause) const {
  return std::string(operation) + " the virtual scanner's control socket " + path_ + " failed: " + cause +
         "; start celadon-sim again.";
}

tl::expected<std::unique_ptr<SimControl>, std::string> SimControl::open(const std::string& folder) {
  const std::string path = folder + "/control.sock";
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const int fd = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  std::unique_ptr<SimControl> control(new SimControl(path, fd));
  if (fd < 0) return tl::make_unexpected(control->lost("Opening", std::strerror(errno)));
  if (path.size() >= sizeof address.sun_path) {
    return tl::make_unexpected("The path " + path + " is longer than a Unix socket's may be (" +
                               std::to_string(sizeof address.sun_path - 1) + " bytes); use a shorter --socket-dir.");
  }
  std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
  ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &kAnswerLimit, sizeof kAnswerLimit);
  if (::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    return tl::make_unexpected(control->lost("Connecting to", std::strerror(errno)));
  }
  auto hello = control->ask("hello");
  if (!hello) return tl::make_unexpected(hello.error());
  control->hello_ = std::move(*hello);
  const auto version = control->hello_.value("version", 0);
  if (version != kVersion) {
    return tl::make_unexpected("The virtual scanner at " + path + " speaks version " + std::to_string(version) +
                               " of its control protocol, this program version " + std::to_string(kVersion) +
                               "; use programs of one build.");
  }
  return control;
}

SimControl::~SimControl() {
  if (fd_ >= 0) ::close(fd_);
}

tl::expected<void, std::string> SimControl::send(const std::string& text) {
  for (std::size_t done = 0; done < text.size();) {
    const ssize_t n = ::send(fd_, text.data() + done, text.size() - done, MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return tl::make_unexpected(lost("Writing to", std::strerror(errno)));
    done += static_cast<std::size_t>(n);
  }
  return {};
}

tl::expected<nlohmann::json, std::string> SimControl::receive() {
  std::size_t end = received_.find('\n');
  while (end == std::string::npos) {
    if (received_.size() > kLongestAnswer) return tl::make_unexpected(lost("Reading from", "an answer has no end"));
    char bytes[8192];
    const ssize_t n = ::recv(fd_, bytes, sizeof bytes, 0);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return tl::make_unexpected(lost("Reading from", n == 0 ? "it was closed" : std::strerror(errno)));
    const std::size_t searched = received_.size();
    received_.append(bytes, static_cast<std::size_t>(n));
    end = received_.find('\n', searched);
  }
  auto answer =
      nlohmann::json::parse(received_.begin(), received_.begin() + static_cast<std::ptrdiff_t>(end), nullptr, false);
  received_.erase(0, end + 1);
  if (!answer.is_object() || !answer.contains("ok")) {
    return tl::make_unexpected(lost("Reading from", "an answer is no JSON object"));
  }
  return answer;
}

tl::expected<nlohmann::json, std::string> SimControl::ask(const std::string& request) {
  if (auto sent = send(request + "\n"); !sent) return tl::make_unexpected(sent.error());
  auto answer = receive();
  if (answer && (*answer)["ok"] != true) {
    return tl::make_unexpected("The virtual scanner refused '" + request + "': " + answer->value("error", "no reason"));
  }
  return answer;
}

tl::expected<std::vector<nlohmann::json>, std::string> SimControl::ask_all(const std::vector<std::string>& requests) {
  std::vector<nlohmann::json> answers;
  answers.reserve(requests.size());
  for (std::size_t first = 0; first < requests.size(); first += kAhead) {
    const std::size_t last = std::min(first + kAhead, requests.size());
    std::string text;
    for (std::size_t i = first; i < last; ++i) text += requests[i] + "\n";
    if (auto sent = send(text); !sent) return tl::make_unexpected(sent.error());
    for (std::size_t i = first; i < last; ++i) {
      auto answer = receive();
      if (!answer) return tl::make_unexpected(answer.error());
      answers.push_back((*answer)["ok"] == true ? std::move(*answer) : nlohmann::json());
    }
  }
  return answers;
}

std::int64_t SimClock::ask(const std::string& request) {
  if (!lost_) {
    const auto answer = control_->ask(request);
    const auto time = answer ? answer->find("time_ns") : nlohmann::json::const_iterator{};
    if (answer && time != answer->end() && time->is_number_integer()) {
      newest_ns_ = std::max(newest_ns_, time->get<std::int64_t>());
      real_at_newest_ns_ = real_.now_ns();
      return newest_ns_;
    }
    lost_ = true;
  }
  return newest_ns_ + real_.now_ns() - real_at_newest_ns_;
}

std::int64_t SimClock::now_ns() {
  return ask("time");
}

void SimClock::sleep_until(std::int64_t time_ns) {
  const std::int64_t now_ns = ask("wait-until " + std::to_string(time_ns));
  if (now_ns < time_ns) real_.sleep_until(real_.now_ns() + time_ns - now_ns);
}

}  // namespace celadon
