// Modbus RTU through a real serial driver: cdc-acm on the host's side, the kernel's own serial gadget on the other
// (dummy_hcd, usb_f_acm), whose terminal is the virtual scanner's line. Pulled out in the middle and plugged in again.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/mount.h>
#include <termios.h>

#include <array>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <thread>

#include "sim/file_descriptor.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"
#include "tests/vm/plugged_usb.h"
#include "tests/vm/profiles_kept.h"

namespace celadon::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kHost = "/dev/ttyACM0";   // where the daemon opens the line
constexpr const char* kGadget = "/dev/ttyGS0";  // the adapter's other end
const std::vector<std::string> kSmallMachine = {"--width", "256", "--height", "208", "--fps", "12"};

/// A serial adapter in this machine's kernel; as root, with the modules.
class SerialAdapter {
 public:
  SerialAdapter() {
    ::mount("none", "/sys/kernel/config", "configfs", 0, nullptr);
    fs::create_directory(kRoot);
    write("idVendor", "0x1209");
    write("idProduct", "0x0001");
    fs::create_directory(kRoot + "configs/c.1");
    fs::create_directory(kRoot + "functions/acm.0");
    fs::create_symlink(kRoot + "functions/acm.0", kRoot + "configs/c.1/acm.0");
  }
  void plug() const {
    write("UDC", "dummy_udc.0");
    wait_for_node(kHost, true);
  }
  void unplug() const {
    write("UDC", "\n");
    wait_for_node(kHost, false);
  }

 private:
  static void write(const std::string& name, const std::string& value) {
    std::ofstream file(kRoot + name);
    file << value << std::flush;
    if (!file) throw std::runtime_error("writing " + name + " failed");
  }
  inline static const std::string kRoot = "/sys/kernel/config/usb_gadget/celadon/";
};

sim::FileDescriptor open_raw(const std::string& terminal) {
  sim::FileDescriptor fd(::open(terminal.c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC));
  termios mode{};
  if (!fd || ::tcgetattr(fd.get(), &mode) != 0) throw std::runtime_error("opening " + terminal + " failed");
  ::cfmakeraw(&mode);
  ::tcsetattr(fd.get(), TCSANOW, &mode);
  return fd;
}

/// A wire between two terminals, until one of them is gone.
class Wire {
 public:
  Wire(const std::string& a, const std::string& b)
      : a_(open_raw(a)), b_(open_raw(b)), stop_(::eventfd(0, EFD_CLOEXEC)), thread_([this] { carry(); }) {}
  ~Wire() {
    const std::uint64_t one = 1;
    (void)!::write(stop_.get(), &one, sizeof one);
    thread_.join();
  }

 private:
  void carry() {
    while (true) {
      std::array<pollfd, 3> polls{pollfd{stop_.get(), POLLIN, 0}, pollfd{a_.get(), POLLIN, 0},
                                  pollfd{b_.get(), POLLIN, 0}};
      if (::poll(polls.data(), polls.size(), -1) < 0) continue;
      if (polls[0].revents != 0) return;
      for (const auto& [from, to, ready] :
           {std::tuple{a_.get(), b_.get(), polls[1].revents}, std::tuple{b_.get(), a_.get(), polls[2].revents}}) {
        if (ready == 0) continue;
        std::array<char, 512> bytes{};
        const ssize_t n = ::read(from, bytes.data(), bytes.size());
        if (n <= 0) return;
        (void)!::write(to, bytes.data(), static_cast<std::size_t>(n));
      }
    }
  }

  sim::FileDescriptor a_, b_, stop_;
  std::thread thread_;
};

TEST(GuestTtyScan, PulledOutInTheMiddleItSaysSoAndScansAgainWhenPluggedIn) {
  const double begun = seconds_now();
  Station station("cylinder", kSmallMachine, Station::Link::modbus_rtu);
  const std::string line = station.folder / "tty";
  const SerialAdapter adapter;
  adapter.plug();
  auto wire = std::make_unique<Wire>(line, kGadget);
  station.url = std::string("modbus-rtu:") + kHost;
  const auto config = station.folder.write("celadond.toml", "[scan]\nprofiles = 16\n");
  station.start_daemon({"--config", config});

  Program scan({"celadon", "scan", "--server", station.server(), "--json", "--profiles", "400"});
  ASSERT_TRUE(scan.wait_for_output("\"state\":\"scanning\"")) << scan.wait().err;
  while (profiles_kept(station.folder / "store") < 3 && scan.wait_for_output("\n")) {
  }
  wire.reset();
  adapter.unplug();
  const auto cut = scan.wait();
  EXPECT_NE(cut.exit_code, 0);
  EXPECT_NE(cut.err.find(kHost), std::string::npos) << cut.err << cut.out;
  const int kept = profiles_kept(station.folder / "store");
  EXPECT_GE(kept, 3);

  adapter.plug();
  wire = std::make_unique<Wire>(line, kGadget);
  const std::vector<std::string> words = {
      "celadon", "scan", "--server", station.server(), "--json", "-o", station.folder / "out"};
  auto again = run(words);
  while (again.err.find("No machine is connected") != std::string::npos) again = run(words);
  ASSERT_EQ(again.exit_code, 0) << again.err << again.out;
  const json report = json::parse(read_file(station.folder / "out" / "report.json"));
  EXPECT_EQ(report["model"], "cylinder") << report["decided_by"];
  EXPECT_LT(report["truth_mm"]["max"], 0.05);
  EXPECT_EQ(report["solid"]["valid"], true);
  expect_safe(station);
  std::printf("%.1f s; %d profiles kept of the interrupted scan, told: %s", seconds_now() - begun, kept,
              cut.err.c_str());
}

}  // namespace
}  // namespace celadon::testing
