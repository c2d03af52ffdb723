// The virtual scanner through its real sockets, with the scanner's own drivers and with libmodbus.
#include "sim/server.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <modbus.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <thread>

#include "firmware_bridge/protocol.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon::sim {
namespace {

using nlohmann::json;

/// A served virtual scanner; lock-step unless said otherwise.
struct Served {
  explicit Served(bool lock_step = true, const std::string& scene = "cylinder") {
    folder = std::filesystem::temp_directory_path() / ("celadon-server-test-" + std::to_string(getpid()));
    ServerOptions o;
    CameraConfig camera;
    camera.width_px = 160;
    camera.height_px = 128;
    o.device = default_device(camera);
    o.device.scene = scene;
    o.lock_step = lock_step;
    o.modbus_rtu = true;
    o.socket_dir = folder;
    auto opened = Server::open(o);
    if (!opened) throw std::runtime_error(opened.error());
    server = *std::move(opened);
    thread = std::thread([this] { server->run(); });
  }
  ~Served() {
    server->stop();
    thread.join();
    server.reset();
    std::error_code ignored;
    std::filesystem::remove_all(folder, ignored);
  }
  std::uint16_t port() const {
    const std::string& url = server->modbus_url();
    return static_cast<std::uint16_t>(std::stoi(url.substr(url.rfind(':') + 1)));
  }
  std::string rtu_path() const { return server->modbus_rtu_url().substr(std::strlen("modbus-rtu:")); }

  std::filesystem::path folder;
  std::unique_ptr<Server> server;
  std::thread thread;
};

FileDescriptor connect_unix(const std::filesystem::path& path, int type) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
  FileDescriptor fd(socket(AF_UNIX, type, 0));
  EXPECT_EQ(connect(fd.get(), reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  const timeval limit{20, 0};
  setsockopt(fd.get(), SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
  return fd;
}

FileDescriptor connect_tcp(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  FileDescriptor fd(socket(AF_INET, SOCK_STREAM, 0));
  EXPECT_EQ(connect(fd.get(), reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  const timeval limit{20, 0};
  setsockopt(fd.get(), SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
  return fd;
}

struct Control {
  explicit Control(const Served& s) : fd(connect_unix(s.folder / "control.sock", SOCK_STREAM)) {}
  std::string raw(const std::string& bytes) {
    EXPECT_EQ(send(fd.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL), static_cast<ssize_t>(bytes.size()));
    std::string out;
    char c = 0;
    while (recv(fd.get(), &c, 1, 0) == 1 && c != '\n') out += c;
    return out;
  }
  json ask(const std::string& line) {
    json answer = json::parse(raw(line + "\n"), nullptr, false);
    EXPECT_TRUE(answer.is_object()) << line;
    return answer;
  }
  FileDescriptor fd;
};

struct Frames {
  explicit Frames(const Served& s) : fd(connect_unix(s.folder / "frames.sock", SOCK_SEQPACKET)) {
    iovec data{&hello, sizeof hello};
    alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))] = {};
    msghdr message{};
    message.msg_iov = &data;
    message.msg_iovlen = 1;
    message.msg_control = control;
    message.msg_controllen = sizeof control;
    EXPECT_EQ(recvmsg(fd.get(), &message, 0), static_cast<ssize_t>(sizeof hello));
    if (CMSG_FIRSTHDR(&message) != nullptr) {
      int memory_fd = -1;
      std::memcpy(&memory_fd, CMSG_DATA(CMSG_FIRSTHDR(&message)), sizeof memory_fd);
      memory.reset(memory_fd);
    }
  }
  void tell(frame_ring::RequestKind kind, std::int64_t value = 0) {
    const frame_ring::Request r{kind, 0, value};
    EXPECT_EQ(send(fd.get(), &r, sizeof r, MSG_NOSIGNAL), static_cast<ssize_t>(sizeof r));
  }
  frame_ring::Reply ask(frame_ring::RequestKind kind, std::int64_t value = 0) {
    tell(kind, value);
    frame_ring::Reply reply;
    EXPECT_EQ(recv(fd.get(), &reply, sizeof reply, 0), static_cast<ssize_t>(sizeof reply));
    return reply;
  }
  FileDescriptor fd, memory;
  frame_ring::Hello hello;
};

using frame_ring::ReplyKind;
using frame_ring::RequestKind;

TEST(Server, LibmodbusReadsTheIdentityOverTcpAndRtu) {
  const Served s;
  for (const bool rtu : {false, true}) {
    modbus_t* m = rtu ? modbus_new_rtu(s.rtu_path().c_str(), 115200, 'E', 8, 1) : modbus_new_tcp("127.0.0.1", s.port());
    ASSERT_NE(m, nullptr);
    modbus_set_slave(m, 1);
    modbus_set_response_timeout(m, 10, 0);
    ASSERT_EQ(modbus_connect(m), 0) << modbus_strerror(errno);
    const auto& id = protocol::groups::identity;
    std::uint16_t words[64] = {};
    ASSERT_EQ(modbus_read_input_registers(m, id.address(), 56, words), 56) << modbus_strerror(errno);
    EXPECT_EQ(protocol::get_u32(words), protocol::kMagic);
    EXPECT_EQ(words[protocol::reg::identity::machine_kind.offset] & protocol::kSimulated, protocol::kSimulated);
    EXPECT_EQ(words[protocol::reg::identity::vendor.offset], ('C' << 8) + 'e');
    EXPECT_EQ(modbus_read_input_registers(m, 0x7000, 2, words), -1);
    EXPECT_EQ(errno, EMBXILADD);
    modbus_close(m);
    modbus_free(m);
  }
}

// Half a request, a silent client and one that floods: none holds up another.
TEST(Server, ClientsDoNotHoldUpEachOther) {
  const Served s;
  const FileDescriptor half = connect_tcp(s.port()), silent = connect_tcp(s.port()), wrong = connect_tcp(s.port());
  const std::uint8_t begun[] = {0, 1, 0, 0, 0, 6, 1, 4};
  EXPECT_EQ(send(half.get(), begun, sizeof begun, MSG_NOSIGNAL), 8);
  EXPECT_EQ(send(wrong.get(), "GET / HTTP/1.1\r\n\r\n", 18, MSG_NOSIGNAL), 18);
  std::uint8_t byte = 0;
  EXPECT_LE(recv(wrong.get(), &byte, 1, 0), 0);  // closed

  modbus_t* m = modbus_new_tcp("127.0.0.1", s.port());
  modbus_set_response_timeout(m, 10, 0);
  ASSERT_EQ(modbus_connect(m), 0);
  std::uint16_t words[48] = {};
  for (int i = 0; i < 50; ++i) ASSERT_EQ(modbus_read_input_registers(m, 0, 48, words), 48);
  const std::uint8_t rest[] = {0, 0, 0, 2};
  EXPECT_EQ(send(half.get(), rest, sizeof rest, MSG_NOSIGNAL), 4);
  std::uint8_t answer[13] = {};
  EXPECT_EQ(recv(half.get(), answer, sizeof answer, MSG_WAITALL), 13);
  EXPECT_EQ(answer[7], 4);
  modbus_close(m);
  modbus_free(m);
}

TEST(Server, ModbusFaultsDoWhatTheySay) {
  const Served s;
  Control control(s);
  modbus_t* m = modbus_new_tcp("127.0.0.1", s.port());
  ASSERT_EQ(modbus_connect(m), 0);
  modbus_set_response_timeout(m, 10, 0);
  std::uint16_t words[4] = {};
  ASSERT_EQ(modbus_read_input_registers(m, 0, 4, words), 4);

  control.ask("fault modbus-exception 4");
  EXPECT_EQ(modbus_read_input_registers(m, 0, 4, words), -1);
  EXPECT_EQ(errno, EMBXSFAIL);
  control.ask("clear modbus-exception");
  EXPECT_EQ(modbus_read_input_registers(m, 0, 4, words), 4);

  modbus_set_response_timeout(m, 0, 50'000);
  control.ask("fault modbus-silent 1");
  EXPECT_EQ(modbus_read_input_registers(m, 0, 4, words), -1);
  EXPECT_EQ(errno, ETIMEDOUT);
  modbus_set_response_timeout(m, 10, 0);
  EXPECT_EQ(modbus_read_input_registers(m, 0, 4, words), 4);

  const std::int64_t before = control.ask("time")["time_ns"];
  control.ask("fault modbus-late 200");
  EXPECT_EQ(modbus_read_input_registers(m, 0, 4, words), 4);
  EXPECT_GE(control.ask("time")["time_ns"].get<std::int64_t>() - before, 200'000'000);
  control.ask("clear modbus-late");

  control.ask("fault modbus-disconnect");
  EXPECT_EQ(modbus_read_input_registers(m, 0, 4, words), -1);
  modbus_close(m);
  modbus_free(m);

  modbus_t* rtu = modbus_new_rtu(s.rtu_path().c_str(), 115200, 'E', 8, 1);
  modbus_set_slave(rtu, 1);
  modbus_set_response_timeout(rtu, 10, 0);
  ASSERT_EQ(modbus_connect(rtu), 0);
  control.ask("fault modbus-corrupt 1");
  EXPECT_EQ(modbus_read_input_registers(rtu, 0, 4, words), -1);
  EXPECT_EQ(errno, EMBBADCRC);
  EXPECT_EQ(modbus_read_input_registers(rtu, 0, 4, words), 4);
  modbus_close(rtu);
  modbus_free(rtu);
}

TEST(Server, FramesComeThroughTheRing) {
  const Served s;
  Frames f(s);
  EXPECT_EQ(f.hello.magic, frame_ring::kMagic);
  EXPECT_EQ(f.hello.lock_step, 1U);
  EXPECT_EQ(f.hello.width_px, 160U);
  EXPECT_STREQ(f.hello.identity, "Celadon Virtual Camera SIM-0001");
  EXPECT_EQ(f.ask(RequestKind::next, 0).kind, ReplyKind::fault);  // not started
  EXPECT_EQ(f.ask(RequestKind::start).kind, ReplyKind::started);
  EXPECT_EQ(f.ask(RequestKind::next, 1000).kind, ReplyKind::timed_out);
  std::int64_t last_stamp = 0;
  std::vector<std::uint8_t> picture(f.hello.slot_bytes);
  for (std::uint64_t i = 0; i < 20; ++i) {
    const frame_ring::Reply r = f.ask(RequestKind::next, 1'000'000'000);
    ASSERT_EQ(r.kind, ReplyKind::frame);
    EXPECT_EQ(r.sequence, i);
    EXPECT_GT(r.stamp_ns, last_stamp);
    last_stamp = r.stamp_ns;
    EXPECT_EQ(r.bytes_used, 160U * 128U);
    ASSERT_EQ(pread(f.memory.get(), picture.data(), picture.size(), static_cast<off_t>(r.slot) * f.hello.slot_bytes),
              static_cast<ssize_t>(picture.size()));
    EXPECT_GT(*std::max_element(picture.begin(), picture.end()), 10);
    f.tell(RequestKind::give_back, r.slot);
  }
  EXPECT_EQ(f.ask(RequestKind::set_exposure, 2'000'000).value, 2'000'000);
  Frames second(s);
  const frame_ring::Reply busy = second.ask(RequestKind::start);
  EXPECT_EQ(busy.kind, ReplyKind::fault);
  EXPECT_EQ(busy.value, EBUSY);
  Control(s).ask("fault camera-unplug");
  const frame_ring::Reply gone = f.ask(RequestKind::next, 1'000'000'000);
  EXPECT_EQ(gone.kind, ReplyKind::fault);
  EXPECT_EQ(gone.value, ENODEV);
  Control(s).ask("clear camera-unplug");
  EXPECT_EQ(f.ask(RequestKind::start).value, ENODEV);  // dead until opened anew
  Frames again(s);
  EXPECT_EQ(again.ask(RequestKind::start).kind, ReplyKind::started);
}

TEST(Server, RubbishOnTheFrameSocketEndsThatConnectionOnly) {
  const Served s;
  Frames good(s), bad(s), worse(s);
  EXPECT_EQ(send(bad.fd.get(), "x", 1, MSG_NOSIGNAL), 1);
  char byte = 0;
  EXPECT_EQ(recv(bad.fd.get(), &byte, 1, 0), 0);
  worse.tell(static_cast<RequestKind>(99));
  EXPECT_EQ(recv(worse.fd.get(), &byte, 1, 0), 0);
  good.tell(RequestKind::give_back, -5);
  good.tell(RequestKind::give_back, 1'000'000);
  EXPECT_EQ(good.ask(RequestKind::start).kind, ReplyKind::started);
}

TEST(Server, ControlLinesTooLongOrBinaryAreRefused) {
  const Served s;
  Control good(s), large(s), binary(s);
  EXPECT_FALSE(json::parse(large.raw(std::string(9000, 'a')))["ok"].get<bool>());
  char byte = 0;
  EXPECT_LE(recv(large.fd.get(), &byte, 1, 0), 0);
  EXPECT_FALSE(json::parse(binary.raw(std::string("\x00\xff\xfe\x80\n", 5)))["ok"].get<bool>());
  EXPECT_TRUE(binary.ask("hello")["ok"].get<bool>());
  EXPECT_TRUE(good.ask("time")["ok"].get<bool>());
}

// The host dies with the laser on: the device runs on in real time and the lease ends.
TEST(Server, LaserGoesOutAfterTheHostDied) {
  const Served s;
  modbus_t* m = modbus_new_tcp("127.0.0.1", s.port());
  modbus_set_response_timeout(m, 10, 0);
  ASSERT_EQ(modbus_connect(m), 0);
  std::int64_t granted = 0;
  Control watcher(s);
  {
    Control host(s);
    host.ask("wait-until 1100000000");
    const std::uint16_t lease = 500;
    ASSERT_EQ(modbus_write_registers(m, protocol::reg::control::laser_lease.address(), 1, &lease), 1)
        << modbus_strerror(errno);
    granted = host.ask("time")["time_ns"];
    EXPECT_EQ(watcher.ask("state")["lasers_on"], 1);
  }
  json state = watcher.ask("state");
  while (state["time_ns"].get<std::int64_t>() < granted + 502'000'000) state = watcher.ask("state");
  EXPECT_EQ(state["lasers_on"], 0);
  modbus_close(m);
  modbus_free(m);
}

// The scanner's own device driver and a declared clock: open, home, turn.
class LockStepClock final : public Clock {
 public:
  explicit LockStepClock(Control& control) : control_(control) {}
  std::int64_t now_ns() override { return control_.ask("time")["time_ns"]; }
  void sleep_until(std::int64_t time_ns) override { control_.ask("wait-until " + std::to_string(time_ns)); }

 private:
  Control& control_;
};

TEST(Server, ScannerDeviceDrivesIt) {
  const Served s;
  Control control(s);
  LockStepClock clock(control);
  for (const std::string& url : {s.server->modbus_url(), s.server->modbus_rtu_url()}) {
    auto transport = open_transport(url);
    ASSERT_TRUE(transport) << transport.error().message();
    auto device = ScannerDevice::open(*std::move(transport), clock);
    ASSERT_TRUE(device) << device.error().message();
    EXPECT_EQ((*device)->identity().machine, "Celadon Virtual Scanner SIM-0001");
    EXPECT_TRUE((*device)->identity().simulated);
    const auto homed = (*device)->home();
    ASSERT_TRUE(homed) << homed.error().message();
    const auto turned = (*device)->rotate_to(1.5, 1.0);
    ASSERT_TRUE(turned) << turned.error().message();
    EXPECT_NEAR(turned->angle_rad, 1.5, 1e-4);
    EXPECT_NEAR(std::remainder(control.ask("state")["angle_rad"].get<double>() - 1.5, 6.283185307179586), 0, 1e-4);
    ASSERT_TRUE((*device)->renew_laser(0, 500));
    EXPECT_EQ(control.ask("state")["lasers_on"], 1);
    EXPECT_TRUE((*device)->make_safe().lasers_off);
    EXPECT_EQ(control.ask("state")["lasers_on"], 0);
  }
}

// In real time frames are rendered beside the poll loop and arrive by themselves.
TEST(Server, RealTimeStreams) {
  const Served s(false);
  Frames f(s);
  EXPECT_EQ(f.hello.lock_step, 0U);
  ASSERT_EQ(f.ask(RequestKind::start).kind, ReplyKind::started);
  Control control(s);
  for (int i = 0; i < 12; ++i) {
    const frame_ring::Reply r = f.ask(RequestKind::next, 20'000'000'000);
    ASSERT_EQ(r.kind, ReplyKind::frame);
    EXPECT_LT(r.stamp_ns, monotonic_ns());
    f.tell(RequestKind::give_back, r.slot);
    EXPECT_TRUE(control.ask("state")["ok"].get<bool>());
  }
  EXPECT_EQ(f.ask(RequestKind::stop).kind, ReplyKind::stopped);
}

TEST(Server, TwoServersInOneFolderAreRefused) {
  const Served s;
  ServerOptions o;
  CameraConfig camera;
  camera.width_px = camera.height_px = 64;
  o.device = default_device(camera);
  o.socket_dir = s.folder;
  const auto second = Server::open(o);
  ASSERT_FALSE(second);
  EXPECT_NE(second.error().find("another virtual scanner"), std::string::npos);
  o.socket_dir = std::filesystem::temp_directory_path() / std::string(150, 'x');
  EXPECT_FALSE(Server::open(o));
  o.socket_dir.clear();
  for (const char* bad : {"nonsense", "127.0.0.1:99999", ":0", "127.0.0.1:", "127.0.0.1:-1"}) {
    o.modbus_tcp = bad;
    EXPECT_FALSE(Server::open(o)) << bad;
  }
}

}  // namespace
}  // namespace celadon::sim
