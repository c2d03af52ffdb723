// The virtual scanner as a USB/IP device over its real socket: one host, controller and camera, unplugged and back.
#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <nlohmann/json.hpp>
#include <thread>

#include "firmware_bridge/usb_protocol.h"
#include "sim/server.h"
#include "sim/usb_bytes.h"
#include "tests/temporary_folder.h"

namespace celadon::sim {
namespace {

using nlohmann::json;
namespace usb = protocol::usb;

struct Served {
  Served() {
    ServerOptions o;
    CameraConfig camera;
    camera.width_px = 160;
    camera.height_px = 128;
    o.device = default_device(camera);
    o.modbus_tcp = "";
    o.usbip = "127.0.0.1:0";
    o.socket_dir = folder.path();
    auto opened = Server::open(o);
    if (!opened) throw std::runtime_error(opened.error());
    server = *std::move(opened);
    const std::string address = json::parse(server->ready_line())["usbip"];
    port = static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1)));
    thread = std::thread([this] { server->run(); });
  }
  ~Served() {
    server->stop();
    thread.join();
  }
  /// One line to the control socket.
  void order(const std::string& line) const {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::snprintf(address.sun_path, sizeof address.sun_path, "%s/control.sock", folder.path().c_str());
    const FileDescriptor fd(socket(AF_UNIX, SOCK_STREAM, 0));
    ASSERT_EQ(connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    ASSERT_EQ(send(fd.get(), line.data(), line.size(), 0), static_cast<ssize_t>(line.size()));
    char answer = 0;
    ASSERT_EQ(recv(fd.get(), &answer, 1, 0), 1);
  }

  celadon::testing::TemporaryFolder folder;
  std::unique_ptr<Server> server;
  std::uint16_t port = 0;
  std::thread thread;
};

void put_big(Bytes& out, std::uint32_t value) {
  for (int shift = 24; shift >= 0; shift -= 8) out.push_back(static_cast<std::uint8_t>(value >> shift));
}

/// A host that asks for one thing after the other.
struct Host {
  explicit Host(std::uint16_t port) : fd(socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(connect(fd.get(), reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    const timeval limit{60, 0};
    setsockopt(fd.get(), SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
  }
  void say(const Bytes& bytes) const {
    EXPECT_EQ(send(fd.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL), static_cast<ssize_t>(bytes.size()));
  }
  /// Fewer bytes than asked for: the connection ended.
  Bytes hear(std::size_t count) const {
    Bytes out(count);
    const ssize_t n = recv(fd.get(), out.data(), count, MSG_WAITALL);
    out.resize(n > 0 ? static_cast<std::size_t>(n) : 0);
    return out;
  }
  /// @returns status of the reply
  std::uint32_t import() const {
    Bytes request{0x01, 0x11, 0x80, 0x03, 0, 0, 0, 0, '1', '-', '1'};
    request.resize(40);
    say(request);
    const Bytes reply = hear(8);
    if (reply.size() < 8) return 99;
    if (reply[7] == 0) (void)hear(312);
    return reply[7];
  }
  /// One transfer to its end. @returns the data of an IN transfer; nothing when the connection ended
  std::optional<Bytes> transfer(bool in, std::uint32_t endpoint, std::uint32_t length, Bytes setup = Bytes(8),
                                const Bytes& data = {}) {
    Bytes request;
    for (const std::uint32_t word : {1U, ++number, 0x10002U, in ? 1U : 0U, endpoint, 0U, length, 0U, 0U, 0U})
      put_big(request, word);
    put(request, setup);
    put(request, data);
    say(request);
    const Bytes head = hear(48);
    if (head.size() < 48) return std::nullopt;
    EXPECT_EQ(head[7], number & 0xff);
    const std::uint32_t moved =
        (std::uint32_t{head[24]} << 24) | (std::uint32_t{head[25]} << 16) | (std::uint32_t{head[26]} << 8) | head[27];
    return in ? std::optional(hear(moved)) : std::optional(Bytes());
  }
  FileDescriptor fd;
  std::uint32_t number = 0;
};

TEST(UsbipServer, OneHostHasControllerAndCameraUntilTheyAreUnplugged) {
  const Served served;
  Host host(served.port);
  ASSERT_EQ(host.import(), 0u);
  EXPECT_EQ(Host(served.port).import(), 2u) << "busy";
  const auto identity = host.transfer(true, 0, 4, {usb::kTypeIn, 1, 0x00, 0x01, 0, 0, 4, 0});
  ASSERT_TRUE(identity);
  EXPECT_EQ(*identity, (Bytes{'C', 'E', 'L', 'A'}));
  // The camera: probe, commit, then pictures until the plug is pulled.
  Bytes probe(26);
  probe[2] = 1;
  ASSERT_TRUE(host.transfer(false, 0, 26, {0x21, 1, 0, 1, 2, 0, 26, 0}, probe));
  ASSERT_TRUE(host.transfer(false, 0, 26, {0x21, 1, 0, 2, 2, 0, 26, 0}, probe));
  std::size_t bytes = 0;
  while (bytes < 2 * (160 * 128 + 4)) {
    const auto some = host.transfer(true, 3, 16384);
    ASSERT_TRUE(some);
    bytes += some->size();
  }
  served.order("fault usb-unplug\n");
  while (host.transfer(true, 3, 16384)) {
  }
  EXPECT_EQ(Host(served.port).import(), 4u) << "no such device";
  served.order("clear usb-unplug\n");
  EXPECT_EQ(Host(served.port).import(), 0u);
}

}  // namespace
}  // namespace celadon::sim
