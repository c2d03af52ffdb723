#include "tests/vm/plugged_usb.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/inotify.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <filesystem>
#include <stdexcept>
#include <utility>

#include "sim/usbip_session.h"
#include "sim/vhci_port.h"

namespace celadon {

void wait_for_node(const std::string& node, bool there) {
  const sim::FileDescriptor watch(::inotify_init1(IN_CLOEXEC));
  if (::inotify_add_watch(watch.get(), "/dev", IN_CREATE | IN_DELETE) < 0) throw std::runtime_error("no news of /dev");
  while (std::filesystem::exists(node) != there) {
    std::array<char, 4096> events{};
    if (::read(watch.get(), events.data(), events.size()) < 0 && errno != EINTR)
      throw std::runtime_error("no news of /dev");
  }
}

PluggedUsb::PluggedUsb(sim::UsbDevice& device, std::string node)
    : device_(device), node_(std::move(node)), stop_(::eventfd(0, EFD_CLOEXEC)) {
  auto socket = sim::plug_into_kernel();
  if (!socket) throw std::runtime_error(socket.error());
  socket_ = std::move(*socket);
  server_ = std::thread([this] { serve(); });
  wait_for_node(node_, true);
}

PluggedUsb::~PluggedUsb() {
  unplug();
  wait_for_node(node_, false);
}

void PluggedUsb::unplug() {
  const std::uint64_t one = 1;
  (void)!::write(stop_.get(), &one, sizeof one);
  if (server_.joinable()) server_.join();
  socket_.reset();  // the kernel sees the end
}

void PluggedUsb::serve() {
  sim::UsbipSession session(device_, sim::UsbipSession::Beginning::attached);
  std::array<std::uint8_t, 65536> bytes{};
  while (!session.finished()) {
    const bool more = !session.output().empty();
    std::array<pollfd, 2> polls{pollfd{stop_.get(), POLLIN, 0},
                                pollfd{socket_.get(), static_cast<short>(more ? POLLIN | POLLOUT : POLLIN), 0}};
    constexpr int kLook_ms = 2;  // what the device has of itself
    if (::poll(polls.data(), polls.size(), kLook_ms) < 0) continue;
    if (polls[0].revents != 0) return;
    const std::lock_guard lock(mutex_);
    const ssize_t got = ::recv(socket_.get(), bytes.data(), bytes.size(), MSG_DONTWAIT);
    if (got == 0) return;
    if (got > 0) session.receive(std::span(bytes).first(static_cast<std::size_t>(got)), sim::UsbipSession::Offer::free);
    session.advance();
    sim::Bytes& output = session.output();
    const ssize_t sent = ::send(socket_.get(), output.data(), output.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    if (sent > 0) output.erase(output.begin(), output.begin() + sent);
  }
}

}  // namespace celadon
