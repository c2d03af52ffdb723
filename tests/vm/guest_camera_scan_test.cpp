// One scan whose frames come through the kernel: celadond reads a USB camera that uvcvideo drives, by the ioctls of any
// V4L2 camera, and turns the table over Modbus. What the camera sees is the virtual scanner's scene at that moment.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <memory>
#include <numbers>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

#include "acquisition/frame.h"
#include "tests/integration/process.h"
#include "tests/integration/station.h"
#include "tests/vm/uvc_camera.h"

namespace celadon::testing {
namespace {

using nlohmann::json;

// Small pictures: each is drawn under emulation, and a frame has to take less than the laser's lease of half a second.
constexpr int kWidth = 256, kHeight = 208, kFramesPerSecond = 8;
constexpr int kProfiles = 24;
constexpr double kExposure_ms = 4;
// A body off the axis: a picture of another table angle would be measured as another radius.
constexpr const char* kScene = "cylinder-off";

/// A view of the virtual scanner. Each picture is the first of a stream of its own, so its exposure begins after it was
/// asked for, and no other is drawn.
class View {
 public:
  explicit View(const std::string& folder) : source_(std::move(*open_frame_source("sim:" + folder))) {}

  void expose(const UvcCamera::Exposure& exposure, std::span<std::uint8_t> pixels) {
    constexpr std::int64_t kPatience_ns = 60'000'000'000;
    if (exposure.mode == UvcCamera::kManual) {
      EXPECT_TRUE(source_->set_exposure(std::int64_t{exposure.time_100us} * 100'000));
    }
    EXPECT_TRUE(source_->start());
    if (const auto frame = source_->next(kPatience_ns)) {
      const std::size_t stride = source_->mode().stride_bytes;
      for (std::size_t y = 0; y < kHeight; ++y) {
        std::copy_n(frame->bytes().begin() + static_cast<std::ptrdiff_t>(y * stride), kWidth,
                    pixels.begin() + static_cast<std::ptrdiff_t>(y * kWidth));
      }
    } else {
      ADD_FAILURE() << frame.error().message;
    }
    source_->stop();
  }

 private:
  std::unique_ptr<FrameSource> source_;
};

/// The station's calibration, of the camera behind the kernel.
void rename_camera(const std::string& file, const std::string& identity) {
  const std::string text = read_file(file);
  std::ofstream(file) << std::regex_replace(text, std::regex("(^|\n)camera = [^\n]*"),
                                            "$1camera = \"" + identity + "\"", std::regex_constants::format_first_only);
}

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

TEST(GuestCameraScan, FramesThroughTheKernelsVideoDriverBecomeASolidCloseToTheTruth) {
  Station station(kScene,
                  {"--width", std::to_string(kWidth), "--height", std::to_string(kHeight), "--fps",
                   std::to_string(kFramesPerSecond)},
                  Station::Link::modbus_tcp, Station::Time::real);
  View view(station.folder.path());
  UvcCamera camera(kWidth, kHeight, [&](const UvcCamera::Exposure& exposure, std::span<std::uint8_t> pixels) {
    view.expose(exposure, pixels);
  });
  const UvcCamera::Exposure found = camera.exposure();
  station.camera = "v4l2:" + camera.node();
  rename_camera(station.folder / "calibration.toml", "Test Camera CAM001");
  station.start_daemon();
  const auto scan =
      run({"celadon", "scan", "--server", station.server(), "--json", "--mode", "step", "--profiles",
           std::to_string(kProfiles), "--exposure", std::to_string(kExposure_ms), "-o", station.folder / "out"});
  ASSERT_EQ(scan.exit_code, 0) << scan.err << scan.out;

  const json report = json::parse(read_file(station.folder / "out" / "report.json"));
  EXPECT_GE(report["scan"]["profiles"].get<int>(), kProfiles);
  EXPECT_EQ(report["solid"]["valid"], true);
  const std::string step = read_file(station.folder / "out" / "object.step");
  EXPECT_EQ(step.rfind("ISO-10303-21;", 0), 0u);
  EXPECT_NE(step.find("END-ISO-10303-21;"), std::string::npos);
  const Errors e = errors_of(station.folder / "out" / "surface.json", station);
  std::printf("radius less truth: %.4f mm RMS, %.4f mm at most, at %d points of a %s surface; %s\n", e.rms_mm, e.max_mm,
              e.points, report["model"].get<std::string>().c_str(), report["scan"].dump().c_str());
  EXPECT_GT(e.points, 400);
  EXPECT_LT(e.max_mm, 0.04) << "one picture late: 0.07";
  EXPECT_EQ(camera.exposure().time_100us, static_cast<std::uint32_t>(10 * kExposure_ms)) << "set through the driver";
  station.daemon->signal(SIGTERM);
  station.daemon->wait();
  EXPECT_EQ(camera.exposure(), found) << "put back";
  EXPECT_TRUE(laser_off(station.state()));
}

}  // namespace
}  // namespace celadon::testing
