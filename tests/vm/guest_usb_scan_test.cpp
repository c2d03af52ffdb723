// Scans whose controller and camera are a USB device of the guest's kernel: usbfs and libusb, uvcvideo and V4L2,
// nothing of ours between them. The device is celadon-sim, plugged into vhci-hcd.
#include <fcntl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <filesystem>
#include <sstream>
#include <string>
#include <vector>

#include "acquisition/file_descriptor.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"
#include "tests/vm/plugged_usb.h"
#include "tests/vm/profiles_kept.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

// Small pictures: each is drawn under emulation, and a frame has to take less than the laser's lease of half a second.
const std::vector<std::string> kSmallMachine = {"--width", "256", "--height", "208", "--fps", "8"};
constexpr int kProfiles = 24;
// A body off the axis: a picture of another table angle would be measured as another radius.
constexpr const char* kScene = "cylinder-off";
constexpr const char* kVideo = "/dev/video0";
/// Of the camera's metadata; of its pictures, when it comes back while the number of the first is taken.
constexpr const char* kNextVideo = "/dev/video1";

struct Plugged : Station {
  explicit Plugged(const std::string& address) : Station(kScene, kSmallMachine, Link::usb, Time::real) {
    camera = "v4l2:" + address;
    wait_for_node(kVideo, true);
    const auto config = folder.write(
        "celadond.toml", "[scan]\nmode = \"step\"\nprofiles = " + std::to_string(kProfiles) + "\nexposure_ms = 4\n");
    start_daemon({"--config", config, "--log-level", "debug"});
  }
  ~Plugged() {
    daemon.reset();
    simulator->signal(SIGTERM);
    simulator->wait();
    wait_for_node(kVideo, false);
    wait_for_node(kNextVideo, false);
  }
  Outcome simulate(std::vector<std::string> words) const {
    words.insert(words.begin(), "celadon-sim");
    words.insert(words.end(), {"--socket-dir", folder.path()});
    return run(words);
  }
};

struct Errors {
  double rms_mm = 0, max_mm = 0;
  int points = 0;
};

/// Distance from the axis of the scanned surface's points less that of the scene's, over the surface's whole band.
Errors errors_of(const std::string& surface, const Station& station) {
  const auto csv = run({"celadon", "evaluate", surface, "--angles", "0:15:345"});
  EXPECT_EQ(csv.exit_code, 0) << csv.err;
  std::istringstream lines(csv.out);
  std::string line, name;
  std::getline(lines, line);
  int x_column = 0;
  for (std::istringstream names(line); std::getline(names, name, ',') && name != "x_mm";) ++x_column;
  Errors e;
  while (std::getline(lines, line)) {
    std::vector<double> values;
    for (std::istringstream fields(line); std::getline(fields, name, ',');) values.push_back(std::stod(name));
    const double* const p = values.data() + x_column;
    char request[96];
    std::snprintf(request, sizeof request, "truth %.17g %.17g", std::atan2(p[1], p[0]), p[2]);
    const double error = std::hypot(p[0], p[1]) - ask_simulator(station.folder.path(), request)["r_mm"].get<double>();
    e.rms_mm += error * error;
    e.max_mm = std::max(e.max_mm, std::abs(error));
    ++e.points;
  }
  e.rms_mm = std::sqrt(e.rms_mm / std::max(e.points, 1));
  return e;
}

TEST(GuestUsbScan, APressToldByUsbBecomesASolidCloseToTheTruth) {
  const double begun = seconds_now();
  const Plugged station(kVideo);
  Program watch({"celadon", "watch", "--server", station.server(), "--json", "-o", station.folder / "out"});
  ASSERT_EQ(station.simulate({"press"}).exit_code, 0);
  const auto outcome = watch.wait();
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err << outcome.out;
  EXPECT_NE(outcome.out.find("\"requested_by\":\"button\""), std::string::npos);
  const json report = json::parse(read_file(station.folder / "out" / "report.json"));
  EXPECT_GE(report["scan"]["profiles"].get<int>(), kProfiles);
  EXPECT_EQ(report["solid"]["valid"], true);
  EXPECT_EQ(report["simulated"], true);
  const Errors e = errors_of(station.folder / "out" / "surface.json", station);
  std::printf("%.1f s; radius less truth: %.4f mm RMS, %.4f mm at most, at %d points of a %s surface; %s\n",
              seconds_now() - begun, e.rms_mm, e.max_mm, e.points, report["model"].get<std::string>().c_str(),
              report["scan"].dump().c_str());
  EXPECT_GT(e.points, 400);
  EXPECT_LT(e.max_mm, 0.04) << "one picture late: 0.07";
  EXPECT_TRUE(laser_off(station.state()));
}

TEST(GuestUsbScan, PulledOutInTheMiddleItSaysSoKeepsItsProfilesAndScansAgainWhenPluggedIn) {
  const double begun = seconds_now();
  const Plugged station("serial=SIM-0001");
  // The number of a node stays taken while a program holds it: the camera comes back under the next.
  const FileDescriptor held(::open(kVideo, O_RDWR | O_CLOEXEC));
  ASSERT_TRUE(held);
  const std::vector<std::string> words = {
      "celadon",    "scan", "--server", station.server(),      "--json", "--mode", "step", "--profiles", "16",
      "--exposure", "4",    "-o",       station.folder / "out"};
  Program scan(words);
  ASSERT_TRUE(scan.wait_for_output("\"state\":\"scanning\"")) << scan.wait().err;
  while (profiles_kept(station.folder / "store") < 3 && scan.wait_for_output("\n")) {
  }
  ASSERT_EQ(station.simulate({"fault", "usb-unplug"}).exit_code, 0);
  const auto cut = scan.wait();
  EXPECT_NE(cut.exit_code, 0);
  // Controller and camera went together; the scan ended with the one that was asked first.
  EXPECT_TRUE(cut.err.find("unplugged from USB") != std::string::npos ||
              cut.err.find("No such device") != std::string::npos)
      << cut.err << cut.out;
  const int kept = profiles_kept(station.folder / "store");
  EXPECT_GE(kept, 3);
  wait_for_node(kVideo, false);
  wait_for_node(kNextVideo, false);
  const json pulled = station.state();
  EXPECT_TRUE(laser_off(pulled) || pulled["lease_left_ms"].get<int>() <= 500) << pulled;
  const auto refused = run(words);
  EXPECT_NE(refused.err.find("No machine is connected"), std::string::npos) << refused.err;

  ASSERT_EQ(station.simulate({"clear", "usb-unplug"}).exit_code, 0);
  wait_for_node(kNextVideo, true);
  auto again = run(words);
  while (again.err.find("No machine is connected") != std::string::npos) again = run(words);
  ASSERT_EQ(again.exit_code, 0) << again.err << again.out;
  const json report = json::parse(read_file(station.folder / "out" / "report.json"));
  EXPECT_EQ(report["solid"]["valid"], true);
  EXPECT_TRUE(laser_off(station.state()));
  EXPECT_FALSE(std::filesystem::exists(kVideo));
  station.daemon->signal(SIGTERM);
  const std::string log = station.daemon->wait().err;
  EXPECT_NE(log.find("told by the kernel"), std::string::npos) << log;
  EXPECT_NE(log.find("the device video1 came"), std::string::npos) << log;
  std::printf("%.1f s; %d profiles kept of the interrupted scan, told: %s", seconds_now() - begun, kept,
              cut.err.c_str());
}

}  // namespace
}  // namespace celadon::testing
