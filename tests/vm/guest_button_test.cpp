// Buttons at the computer through the guest's own kernel: a key of an input device (uinput), and a line of a GPIO chip,
// a USB bridge of the kind CP2112 whose reports are answered here (uhid).
#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/input.h>
#include <linux/uhid.h>
#include <linux/uinput.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <atomic>
#include <cstring>
#include <filesystem>
#include <set>
#include <stdexcept>
#include <thread>

#include "firmware_bridge/button_source.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

std::set<std::string> nodes(const std::string& folder, const std::string& beginning) {
  std::set<std::string> found;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (entry.path().filename().string().rfind(beginning, 0) == 0) found.insert(entry.path());
  }
  return found;
}

/// A button with one key, KEY_PROG1, made of the kernel's uinput.
class Key {
 public:
  Key() : fd_(::open("/dev/uinput", O_WRONLY | O_CLOEXEC)) {
    if (fd_ < 0) throw std::runtime_error("no /dev/uinput");
    const std::set<std::string> before = nodes("/dev/input", "event");
    uinput_setup setup{};
    setup.id.bustype = BUS_VIRTUAL;
    std::strcpy(setup.name, "Celadon test button");
    if (::ioctl(fd_, UI_SET_EVBIT, EV_KEY) != 0 || ::ioctl(fd_, UI_SET_KEYBIT, KEY_PROG1) != 0 ||
        ::ioctl(fd_, UI_DEV_SETUP, &setup) != 0 || ::ioctl(fd_, UI_DEV_CREATE) != 0)
      throw std::runtime_error("uinput refuses the button");
    while (node.empty()) {
      for (const std::string& path : nodes("/dev/input", "event")) {
        if (before.count(path) == 0) node = path;
      }
    }
  }
  ~Key() { ::close(fd_); }
  Key(const Key&) = delete;
  Key& operator=(const Key&) = delete;
  std::string node;

  void set(bool down) const {
    put(EV_KEY, KEY_PROG1, down ? 1 : 0);
    put(EV_SYN, SYN_REPORT, 0);
  }

 private:
  void put(unsigned type, unsigned code, int value) const {
    input_event event{};
    event.type = static_cast<__u16>(type);
    event.code = static_cast<__u16>(code);
    event.value = value;
    EXPECT_EQ(::write(fd_, &event, sizeof event), static_cast<ssize_t>(sizeof event));
  }
  const int fd_;
};

json machine_of(const Station& station) {
  const auto status = run({"celadon", "status", "--server", station.server()});
  return json::parse(status.out.substr(0, status.out.find("\n}") + 2));
}

TEST(GuestButton, AKeyStartsStopsTestsAndSurvivesItsDeparture) {
  auto key = std::make_unique<Key>();
  const std::string node = key->node;
  Station station("cylinder", {"--width", "400", "--height", "320", "--fps", "12"});
  // A level counts from its first instant on, so that no test has to hold a key for a time.
  const auto config =
      station.folder.write("celadond.toml", "[scan]\nprofiles = 36\n[button]\ndebounce_ms = 1\nlong_ms = 60000\n");
  station.start_daemon({"--config", config, "--button", "evdev:" + node + ":KEY_PROG1"});
  EXPECT_FALSE(open_button("evdev:" + node)) << "the daemon has taken it for itself";
  const auto click = [&] {
    key->set(true);
    const json before = machine_of(station);  // takes longer than the contact may bounce
    key->set(false);
    return before;
  };
  Program stopped({"celadon", "watch", "--server", station.server(), "--json"});
  click();
  ASSERT_TRUE(stopped.wait_for_output("\"state\":\"scanning\"")) << stopped.wait().err;
  click();
  const auto cut = stopped.wait();
  EXPECT_EQ(cut.exit_code, 1) << cut.err;
  EXPECT_NE((cut.out + cut.err).find("by the button"), std::string::npos) << cut.out << cut.err;
  EXPECT_NE(cut.out.find("\"requested_by\":\"button\""), std::string::npos);
  expect_safe(station);

  key.reset();  // unplugged
  while (machine_of(station)["button"] == "") {
  }
  EXPECT_NE(machine_of(station)["button"].get<std::string>().find("plug it in"), std::string::npos);
  key = std::make_unique<Key>();
  ASSERT_EQ(key->node, node);
  while (machine_of(station)["button"] != "") {
  }
  Program whole({"celadon", "watch", "--server", station.server(), "--json", "-o", station.folder / "out"});
  click();
  const auto outcome = whole.wait();
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err << outcome.out;
  const json report = json::parse(read_file(station.folder / "out" / "report.json"));
  EXPECT_EQ(report["model"], "cylinder") << report["decided_by"];
  EXPECT_LT(report["truth_mm"]["max"], 0.05);
  expect_safe(station);
  const auto scans = run({"celadon", "status", "--server", station.server()});
  EXPECT_EQ(scans.out.find("scan 3"), std::string::npos) << "two presses started, one stopped: " << scans.out;
}

TEST(GuestButton, AKeyHeldForLongTestsTheMachine) {
  const Key key;
  Station station("cylinder", {"--width", "400", "--height", "320", "--fps", "12"});
  const auto config = station.folder.write("celadond.toml", "[button]\nlong_ms = 300\n");
  station.start_daemon({"--config", config, "--button", "evdev:" + key.node});
  key.set(true);
  json machine = machine_of(station);
  while (machine["self_test"].is_null()) machine = machine_of(station);
  key.set(false);
  EXPECT_EQ(machine["self_test"]["passed"], true) << machine;
  std::printf("%s\n", machine["self_test"]["text"].get<std::string>().c_str());
  expect_safe(station);
}

/// A CP2112 whose eight lines are levels here. Its reports: Silicon Labs AN495, "CP2112 interface specification".
class GpioBridge {
 public:
  GpioBridge() : fd_(::open("/dev/uhid", O_RDWR | O_CLOEXEC)) {
    if (fd_ < 0) throw std::runtime_error("no /dev/uhid");
    uhid_event create{};
    create.type = UHID_CREATE2;
    std::strcpy(reinterpret_cast<char*>(create.u.create2.name), "CP2112");
    // One vendor report of a byte: the driver asks by number.
    constexpr std::uint8_t kDescriptor[] = {0x06, 0x00, 0xFF, 0x09, 0x01, 0xA1, 0x01, 0x15, 0x00, 0x26, 0xFF,
                                            0x00, 0x75, 0x08, 0x95, 0x01, 0x09, 0x01, 0x81, 0x02, 0xC0};
    std::memcpy(create.u.create2.rd_data, kDescriptor, sizeof kDescriptor);
    create.u.create2.rd_size = sizeof kDescriptor;
    create.u.create2.bus = BUS_USB;
    create.u.create2.vendor = 0x10C4;
    create.u.create2.product = 0xEA90;
    server_ = std::thread([this] { serve(); });
    put(create);
  }
  ~GpioBridge() { unplug(); }
  GpioBridge(const GpioBridge&) = delete;
  GpioBridge& operator=(const GpioBridge&) = delete;

  void set(int line, bool high) {
    const auto bit = static_cast<std::uint8_t>(1 << line);
    levels_ = static_cast<std::uint8_t>(high ? levels_ | bit : levels_ & ~bit);
  }
  void unplug() {
    if (!server_.joinable()) return;
    uhid_event destroy{};
    destroy.type = UHID_DESTROY;
    put(destroy);
    ended_ = true;
    server_.join();
    ::close(fd_);
  }

 private:
  void put(const uhid_event& event) const {
    EXPECT_EQ(::write(fd_, &event, sizeof event), static_cast<ssize_t>(sizeof event));
  }
  void serve() {
    while (!ended_) {
      pollfd ready{fd_, POLLIN, 0};
      uhid_event event{};
      if (::poll(&ready, 1, 20) <= 0 || ::read(fd_, &event, sizeof event) <= 0) continue;
      uhid_event answer{};
      if (event.type == UHID_SET_REPORT) {
        answer.type = UHID_SET_REPORT_REPLY;
        answer.u.set_report_reply.id = event.u.set_report.id;
        put(answer);
      } else if (event.type == UHID_GET_REPORT) {
        constexpr std::uint8_t kDirection = 2, kLatch = 3, kVersion = 5, kSmbus = 6;
        answer.type = UHID_GET_REPORT_REPLY;
        answer.u.get_report_reply.id = event.u.get_report.id;
        const std::uint8_t report = event.u.get_report.rnum;
        answer.u.get_report_reply.size = report == kDirection ? 5
                                         : report == kLatch   ? 2
                                         : report == kVersion ? 3
                                         : report == kSmbus   ? 14
                                                              : 0;
        answer.u.get_report_reply.data[0] = report;
        if (report == kLatch) answer.u.get_report_reply.data[1] = levels_;
        put(answer);
      }
    }
  }
  const int fd_;
  std::atomic<std::uint8_t> levels_ = 0xFF;
  std::atomic<bool> ended_ = false;
  std::thread server_;
};

TEST(GuestButton, AGpioLineTellsPressesUntilItsChipIsUnplugged) {
  const std::set<std::string> before = nodes("/dev", "gpiochip");
  GpioBridge bridge;
  std::string chip;
  while (chip.empty()) {
    for (const std::string& path : nodes("/dev", "gpiochip")) {
      if (before.count(path) == 0) chip = path;
    }
  }
  const std::string url = "gpio:" + chip + ":3";
  auto button = open_button(url);
  ASSERT_TRUE(button) << button.error().message;
  EXPECT_FALSE((*button)->down_at_open()) << "the line is high, and active low";
  const auto again = open_button(url);
  ASSERT_FALSE(again);
  EXPECT_NE(again.error().message.find("is used by celadon button"), std::string::npos) << again.error().message;

  // The driver polls the chip, and begins with lines that it takes for low: an edge to the level that is known already.
  std::vector<ButtonEdge> edges;
  const auto wait_for_edge = [&](bool down) {
    edges.clear();
    while (edges.empty() || edges.back().down != down) ASSERT_TRUE((*button)->read(edges));
  };
  bridge.set(3, false);
  wait_for_edge(true);
  const std::int64_t down_ns = edges.back().time_ns;
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  EXPECT_LE(down_ns, std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec);
  EXPECT_GT(down_ns, 0);
  bridge.set(3, true);
  wait_for_edge(false);
  EXPECT_GT(edges.back().time_ns, down_ns);

  bridge.unplug();
  edges.clear();
  auto read = (*button)->read(edges);
  while (read) read = (*button)->read(edges);
  EXPECT_NE(read.error().message.find("its chip is gone"), std::string::npos) << read.error().message;
  button->reset();
  const auto gone = open_button(url);
  ASSERT_FALSE(gone);
  EXPECT_NE(gone.error().message.find("there is no GPIO chip"), std::string::npos) << gone.error().message;
}

}  // namespace
}  // namespace celadon::testing
