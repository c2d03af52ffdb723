#include "sim/tcp_listener.h"

#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <charconv>
#include <memory>
#include <utility>

#include "sim/system_text.h"

namespace celadon::sim {

tl::expected<TcpListener, std::string> listen_tcp(const std::string& host_and_port, const std::string& what) {
  const auto colon = host_and_port.rfind(':');
  int port = -1;
  if (colon != std::string::npos) {
    const char *first = host_and_port.data() + colon + 1, *last = host_and_port.data() + host_and_port.size();
    const auto [end, error] = std::from_chars(first, last, port);
    if (error != std::errc() || end != last) port = -1;
  }
  std::string host = colon == std::string::npos ? "" : host_and_port.substr(0, colon);
  if (host.size() >= 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  if (host.empty() || port < 0 || port > 65535) {
    return tl::unexpected(what + " address \"" + host_and_port +
                          "\" is not HOST:PORT with a port from 0 to 65535, e.g. 127.0.0.1:0");
  }
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  if (const int e = getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found); e != 0) {
    return tl::unexpected(what + " host \"" + host + "\" is unknown: " + gai_strerror(e));
  }
  const std::unique_ptr<addrinfo, void (*)(addrinfo*)> addresses(found, freeaddrinfo);
  FileDescriptor fd(socket(found->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  const int on = 1;
  if (fd) setsockopt(fd.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (!fd || bind(fd.get(), found->ai_addr, found->ai_addrlen) != 0 || listen(fd.get(), 16) != 0) {
    return tl::unexpected(system_text("listening for " + what + " on " + host_and_port));
  }
  sockaddr_storage bound{};
  socklen_t size = sizeof bound;
  getsockname(fd.get(), reinterpret_cast<sockaddr*>(&bound), &size);
  const std::uint16_t bound_port =
      ntohs(bound.ss_family == AF_INET6 ? reinterpret_cast<sockaddr_in6*>(&bound)->sin6_port
                                        : reinterpret_cast<sockaddr_in*>(&bound)->sin_port);
  const bool v6 = host.find(':') != std::string::npos;
  return TcpListener{std::move(fd), (v6 ? "[" + host + "]" : host) + ":" + std::to_string(bound_port)};
}

}  // namespace celadon::sim
