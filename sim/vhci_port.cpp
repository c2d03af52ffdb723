#include "sim/vhci_port.h"

#include <fcntl.h>
#include <sys/socket.h>

#include <array>
#include <fstream>
#include <optional>
#include <sstream>
#include <utility>

#include "sim/system_text.h"
#include "sim/usbip_session.h"

namespace celadon::sim {
namespace {

const std::string kHub = "/sys/devices/platform/vhci_hcd.0/";

/// The number of a free high-speed port: rows are "hs  0000 004 ...", 004 being free.
std::optional<int> free_port() {
  std::ifstream status(kHub + "status");
  for (std::string line; std::getline(status, line);) {
    std::istringstream words(line);
    std::string hub;
    int port = 0, state = 0;
    if (words >> hub >> port >> state && hub == "hs" && state == 4) return port;
  }
  return std::nullopt;
}

}  // namespace

tl::expected<FileDescriptor, std::string> plug_into_kernel() {
  const std::string hint = "; load the module (modprobe vhci-hcd) and run this as root";
  std::array<int, 2> ends{};
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0)
    return tl::unexpected(system_text("making a socket pair"));
  FileDescriptor ours(ends[0]);
  const FileDescriptor kernels(ends[1]);
  fcntl(ours.get(), F_SETFL, fcntl(ours.get(), F_GETFL) | O_NONBLOCK);
  const FileDescriptor attach(::open((kHub + "attach").c_str(), O_WRONLY | O_CLOEXEC));
  if (!attach) return tl::unexpected(system_text("opening " + kHub + "attach") + hint);
  const auto port = free_port();
  if (!port) return tl::unexpected("no port of " + kHub + "status is free; detach a device (usbip detach)");
  const std::string order = std::to_string(*port) + " " + std::to_string(kernels.get()) + " " +
                            std::to_string(UsbipSession::kDeviceId) + " " + std::to_string(UsbipSession::kHighSpeed);
  if (::write(attach.get(), order.data(), order.size()) != static_cast<ssize_t>(order.size()))
    return tl::unexpected(system_text("plugging the device into " + kHub) + hint);
  return ours;
}

}  // namespace celadon::sim
