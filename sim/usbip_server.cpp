#include "sim/usbip_server.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>

#include "sim/tcp_listener.h"
#include "sim/vhci_port.h"

namespace celadon::sim {
namespace {

constexpr std::size_t kMostClients = 4;

// V4L2 knows a camera by its product string and serial number, and a calibration names it so.
UsbDevice::Identity identity_of(const DeviceModel& model) {
  std::string name = model.camera_identity();
  const std::string& serial = model.config().serial;
  if (name.size() > serial.size() + 1) name.resize(name.size() - serial.size() - 1);
  return {protocol::usb::kVendorId, protocol::usb::kProductId, "Celadon", name, serial};
}

}  // namespace

UsbipServer::UsbipServer(DeviceModel& model, Pacer& pacer, FrameStore& store)
    : model_(model),
      pacer_(pacer),
      sensor_(model, store, pacer.new_client()),
      controller_(model),
      camera_(sensor_, model.config().camera.exposure_ns),
      device_(identity_of(model), {&controller_, &camera_}) {}

tl::expected<std::string, std::string> UsbipServer::listen(const std::string& host_and_port) {
  auto listener = listen_tcp(host_and_port, "USB/IP");
  if (!listener) return tl::unexpected(listener.error());
  listener_ = std::move(listener->fd);
  return listener->address;
}

tl::expected<void, std::string> UsbipServer::attach() {
  auto socket = plug_into_kernel();
  if (!socket) return tl::unexpected(socket.error());
  attaches_ = true;
  clients_.push_back(std::make_unique<Client>(
      Client{*std::move(socket), UsbipSession(device_, UsbipSession::Beginning::attached), false}));
  return {};
}

UsbipSession::Offer UsbipServer::offer() const {
  if (!plugged_) return UsbipSession::Offer::absent;
  const bool taken =
      std::any_of(clients_.begin(), clients_.end(), [](const auto& c) { return c->session.imported() && !c->closed; });
  return taken ? UsbipSession::Offer::taken : UsbipSession::Offer::free;
}

void UsbipServer::collect(std::vector<pollfd>& polls) {
  polls.push_back({listener_.get(), POLLIN, 0});
  for (const auto& client : clients_) {
    const bool more = !client->session.output().empty();
    polls.push_back({client->fd.get(), static_cast<short>(more ? POLLIN | POLLOUT : POLLIN), 0});
  }
}

void UsbipServer::serve(const pollfd* polls, std::size_t count) {
  follow_the_plug();
  for (std::size_t i = 0; i < clients_.size() && i + 1 < count; ++i) {
    if ((polls[i + 1].revents & ~POLLOUT) != 0) receive(*clients_[i]);
  }
  for (const auto& client : clients_) {
    if (client->session.imported()) client->session.advance();
    send(*client);
    if (client->closed && client->session.imported()) device_.reset();
  }
  std::erase_if(clients_, [](const auto& client) { return client->closed; });
  if (count > 0 && (polls[0].revents & POLLIN) != 0) accept_client();
}

void UsbipServer::follow_the_plug() {
  const bool plugged = !model_.faults().armed("usb-unplug");
  if (plugged == plugged_) return;
  plugged_ = plugged;
  if (!plugged) {
    for (const auto& client : clients_) client->closed = true;
  } else if (attaches_) {
    (void)attach();  // what can be done about a kernel that refuses is done by whoever plugs it in again
  }
}

void UsbipServer::accept_client() {
  FileDescriptor fd(accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
  if (!fd || clients_.size() >= kMostClients) return;  // closed at once: the client sees it
  const int on = 1;
  setsockopt(fd.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  clients_.push_back(
      std::make_unique<Client>(Client{std::move(fd), UsbipSession(device_, UsbipSession::Beginning::request), false}));
}

void UsbipServer::receive(Client& client) {
  std::array<std::uint8_t, 65536> bytes;
  const ssize_t n = ::recv(client.fd.get(), bytes.data(), bytes.size(), MSG_DONTWAIT);
  if (n < 0 && (errno == EAGAIN || errno == EINTR)) return;
  if (n <= 0) {
    client.closed = true;
    return;
  }
  pacer_.catch_up();
  client.session.receive({bytes.data(), static_cast<std::size_t>(n)}, offer());
}

void UsbipServer::send(Client& client) {
  Bytes& output = client.session.output();
  while (!client.closed && !output.empty()) {
    const ssize_t n = ::send(client.fd.get(), output.data(), output.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (n <= 0) {
      client.closed = n == 0 || (errno != EAGAIN && errno != EINTR);
      return;
    }
    output.erase(output.begin(), output.begin() + n);
  }
  if (client.session.finished()) client.closed = true;
}

}  // namespace celadon::sim
