#include "sim/modbus_server.h"

#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <termios.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>

#include "sim/random.h"
#include "sim/system_text.h"
#include "sim/tcp_listener.h"

namespace celadon::sim {
namespace {

constexpr std::size_t kMaxMasters = 8;
constexpr std::uint8_t kRtuUnit = 1;
constexpr std::int64_t kTcpTransfer_ns = 250'000;               // one way
constexpr std::int64_t kRtuByte_ns = 11'000'000'000 / 115'200;  // start, 8 bits, parity, stop
constexpr std::int64_t kRtuPause_ns = 4 * kRtuByte_ns;          // before an answer
constexpr std::int64_t kPatience_ns = 500'000'000;              // of a client that waits in vain
constexpr std::uint64_t kNoisePurpose = 14;
constexpr std::int64_t kRtuSilence_ns = 100'000'000;  // real time: what was begun is abandoned

std::int64_t transfer_ns(ModbusFraming framing, std::size_t bytes) {
  return framing == ModbusFraming::tcp ? kTcpTransfer_ns
                                       : kRtuPause_ns + static_cast<std::int64_t>(bytes) * kRtuByte_ns;
}

}  // namespace

ModbusServer::~ModbusServer() {
  if (!link_path_.empty()) {
    std::error_code ignored;
    std::filesystem::remove(link_path_, ignored);
  }
}

tl::expected<std::string, std::string> ModbusServer::listen_tcp(const std::string& host_and_port) {
  auto listener = sim::listen_tcp(host_and_port, "Modbus");
  if (!listener) return tl::unexpected(listener.error());
  listener_ = std::move(listener->fd);
  return "modbus-tcp://" + listener->address;
}

tl::expected<std::string, std::string> ModbusServer::open_rtu(const std::filesystem::path& link) {
  FileDescriptor master(posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  std::array<char, 128> name{};
  if (!master || grantpt(master.get()) != 0 || unlockpt(master.get()) != 0 ||
      ptsname_r(master.get(), name.data(), name.size()) != 0) {
    return tl::unexpected(system_text("opening a pseudo terminal"));
  }
  terminal_.reset(open(name.data(), O_RDWR | O_NOCTTY | O_CLOEXEC));
  termios mode{};
  if (!terminal_ || tcgetattr(terminal_.get(), &mode) != 0)
    return tl::unexpected(system_text(std::string("opening ") + name.data()));
  cfmakeraw(&mode);
  tcsetattr(terminal_.get(), TCSANOW, &mode);
  std::string path = name.data();
  if (!link.empty()) {
    std::error_code error;
    if (std::filesystem::is_symlink(link, error)) std::filesystem::remove(link, error);
    std::filesystem::create_symlink(path, link, error);
    if (error) return tl::unexpected("making the link " + link.string() + " failed: " + error.message());
    link_path_ = link;
    path = std::filesystem::absolute(link).string();
  }
  serves_rtu_ = true;
  links_.push_back(std::make_unique<Link>(
      Link{std::move(master), ModbusFraming::rtu, ModbusReader(ModbusFraming::rtu), {}, 0, false}));
  return "modbus-rtu:" + path;
}

protocol::Exception ModbusServer::read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  return model_.read_input(address, count, words);
}
protocol::Exception ModbusServer::read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  return model_.read_holding(address, count, words);
}
protocol::Exception ModbusServer::write_holding(std::uint16_t address, std::uint16_t count,
                                                const std::uint16_t* words) {
  return model_.write_holding(address, count, words);
}

void ModbusServer::collect(std::vector<pollfd>& polls) {
  if (listener_) polls.push_back({listener_.get(), POLLIN, 0});
  for (const auto& link : links_) polls.push_back({link->fd.get(), POLLIN, 0});
}

void ModbusServer::serve(const pollfd* polls, std::size_t count) {
  if (model_.take_disconnect()) {
    for (const auto& link : links_) link->closed = link->framing == ModbusFraming::tcp;
  }
  follow_plug();
  std::size_t at = listener_ ? 1 : 0;
  const bool arrived = at == 1 && count > 0 && (polls[0].revents & POLLIN) != 0;
  for (std::size_t i = 0; i < links_.size() && at < count; ++i, ++at) {
    if (polls[at].revents != 0 && !links_[i]->closed) receive(*links_[i]);
  }
  for (const auto& link : links_) send_due(*link);
  std::erase_if(links_, [](const auto& link) { return link->closed; });
  if (arrived) accept_client();
}

// Unplugged, connections are closed and new ones are at once; the pseudo terminal is gone and comes back under its
// link.
void ModbusServer::follow_plug() {
  const bool unplugged = model_.faults().armed("controller-unplug");
  if (unplugged) {
    for (const auto& link : links_) link->closed = true;
    terminal_.reset();
  } else if (unplugged_ && serves_rtu_) {
    (void)open_rtu(link_path_);
  }
  unplugged_ = unplugged;
}

void ModbusServer::accept_client() {
  FileDescriptor fd(accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
  if (!fd || links_.size() >= kMaxMasters || unplugged_) return;  // closed at once: the client sees it
  const int on = 1;
  setsockopt(fd.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  links_.push_back(
      std::make_unique<Link>(Link{std::move(fd), ModbusFraming::tcp, ModbusReader(ModbusFraming::tcp), {}, 0, false}));
}

void ModbusServer::receive(Link& link) {
  std::array<std::uint8_t, 1024> bytes{};
  const ssize_t n = read(link.fd.get(), bytes.data(), bytes.size());
  if (n <= 0) {
    const bool later =
        n < 0 && (errno == EAGAIN || errno == EINTR || (errno == EIO && link.framing == ModbusFraming::rtu));
    link.closed = !later;
    return;
  }
  const std::int64_t now = monotonic_ns();
  if (link.framing == ModbusFraming::rtu && now - link.last_byte_ns > kRtuSilence_ns) link.reader.pause();
  link.last_byte_ns = now;
  link.reader.append({bytes.data(), static_cast<std::size_t>(n)});
  while (const auto request = link.reader.next()) answer(link, *request);
  if (link.reader.broken()) link.closed = true;
}

bool ModbusServer::noise_hits() {
  const auto key = make_key(model_.config().seed, kNoisePurpose, 0);
  return random_uniform(key, noisy_bytes_++) < model_.faults().value("serial-noise");
}

// In lock-step the client's wait costs device time too.
void ModbusServer::give_no_answer() {
  if (pacer_.holds()) pacer_.spend(kPatience_ns);
}

void ModbusServer::answer(Link& link, const ModbusRequest& request) {
  const bool broadcast = link.framing == ModbusFraming::rtu && request.unit == 0;
  if (link.framing == ModbusFraming::rtu && request.unit != kRtuUnit && !broadcast) return;
  pacer_.spend(transfer_ns(link.framing, request.pdu.size() + 3));
  FaultPlan& faults = model_.faults();
  const bool noisy = link.framing == ModbusFraming::rtu && faults.armed("serial-noise");
  bool arrives = !faults.strikes("heartbeat-lost");
  for (std::size_t i = 0; noisy && i < request.pdu.size() + 3; ++i) arrives = !noise_hits() && arrives;
  if (!arrives) return give_no_answer();
  const std::vector<std::uint8_t> pdu =
      faults.armed("modbus-exception")
          ? modbus_exception(request.pdu, static_cast<std::uint8_t>(faults.value("modbus-exception")))
          : answer_modbus(request.pdu, *this);
  std::vector<std::uint8_t> bytes = frame_modbus(link.framing, request, pdu);
  pacer_.spend(transfer_ns(link.framing, bytes.size()));
  if (broadcast) return;
  if (faults.strikes("modbus-silent")) return give_no_answer();
  for (std::size_t i = 0; noisy && i < bytes.size(); ++i) {
    if (noise_hits()) bytes[i] ^= static_cast<std::uint8_t>(1 << (noisy_bytes_ % 8));
  }
  if (faults.strikes("modbus-corrupt")) (link.framing == ModbusFraming::rtu ? bytes.back() : bytes[1]) ^= 0x55;
  std::int64_t due = model_.now_ns();
  if (faults.armed("modbus-late")) {
    const auto late = static_cast<std::int64_t>(faults.value("modbus-late") * 1e6);
    if (pacer_.holds()) {
      if (late >= kPatience_ns) return give_no_answer();  // the client has given up by then
      pacer_.spend(late);
    } else {
      due += late;
    }
  }
  link.answers.push_back({due, std::move(bytes)});
}

void ModbusServer::send_due(Link& link) {
  while (!link.closed && !link.answers.empty() && (pacer_.holds() || link.answers.front().due_ns <= model_.now_ns())) {
    const std::vector<std::uint8_t>& bytes = link.answers.front().bytes;
    const ssize_t n = link.framing == ModbusFraming::tcp
                          ? send(link.fd.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT)
                          : write(link.fd.get(), bytes.data(), bytes.size());
    // A client that does not read its answers loses its connection; a terminal loses the answer.
    if (n != static_cast<ssize_t>(bytes.size()) && link.framing == ModbusFraming::tcp) link.closed = true;
    link.answers.erase(link.answers.begin());
  }
}

}  // namespace celadon::sim
