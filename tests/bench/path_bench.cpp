// The whole path as fast as it will go: run_scan over 3600 frames of 1024 rows that the virtual scanner drew
// beforehand, on a machine whose clock costs nothing. Prints frames per second on one core, peak memory beyond the
// frames, and the time from the last frame to the STEP file. path_bench [PROFILES]

#include <sched.h>
#include <sys/resource.h>

#include <cstdio>
#include <cstdlib>
#include <numbers>
#include <vector>

#include "daemon/scan_job.h"
#include "sim/device_model.h"
#include "sim/renderer.h"
#include "tests/daemon/fake_machine.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

constexpr int kDrawn = 32;  // distinct frames; together larger than any cache

double peak_MB() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

/// Frames of the virtual scanner's vase, one without laser light before them.
struct DrawnFrames {
  DrawnFrames() : device(sim::default_device({})) {
    sim::OpticsConfig optics = device.optics;
    const sim::CameraConfig& camera = device.camera;
    optics.camera.width_px = camera.width_px;
    optics.camera.height_px = camera.height_px;
    sim::Renderer renderer(*sim::Scene::make(device.scene), optics);
    bytes.assign((kDrawn + 1) * camera.frame_bytes(), 0);
    for (int k = 0; k <= kDrawn; ++k) {
      sim::Exposure exposure;
      exposure.seed = 1;
      exposure.frame = static_cast<std::uint64_t>(k);
      exposure.exposure_ns = camera.exposure_ns;
      exposure.first_row_end_ns = camera.exposure_ns;
      exposure.motion.samples.assign(
          2, {2 * std::numbers::pi * k / kDrawn, 0, k == 0 ? 0. : 1.});  // standing; dark before the first
      renderer.render(exposure, frame(k), camera.stride_bytes());
    }
  }
  std::span<std::uint8_t> frame(int k) {
    return std::span(bytes).subspan(static_cast<std::size_t>(k) * device.camera.frame_bytes(),
                                    device.camera.frame_bytes());
  }
  sim::DeviceConfig device;
  std::vector<std::uint8_t> bytes;
};

/// The machine's camera with drawn frames for pictures: nothing is copied.
class DrawnCamera final : public FrameSource, public FrameReturn {
 public:
  DrawnCamera(testing::FakeMachine& machine, DrawnFrames& frames, std::string identity)
      : machine_(machine), frames_(frames) {
    const sim::CameraConfig& camera = frames.device.camera;
    mode_.width_px = camera.width_px;
    mode_.height_px = camera.height_px;
    mode_.stride_bytes = camera.stride_bytes();
    mode_.frame_period_ns = testing::FakeMachine::kPeriod_us * 1000;
    mode_.exposure_ns = testing::FakeMachine::kExposure_us * 1000;
    mode_.identity = std::move(identity);
    mode_.simulated = true;
  }
  const CameraMode& mode() const override { return mode_; }
  tl::expected<void, CameraError> start() override {
    machine_.stream(true);
    return {};
  }
  void stop() noexcept override { machine_.stream(false); }
  tl::expected<Frame, CameraError> next(std::int64_t timeout_ns) override {
    const auto shot = machine_.take_shot(timeout_ns / 1000);
    if (!shot) return tl::make_unexpected(CameraError{CameraError::Kind::timed_out, 0, "no frame in time"});
    FrameInfo info;
    info.sequence = shot->sequence;
    info.stamp_ns = shot->stamp_us * 1000 + testing::FakeMachine::kHostOffset_ns;
    info.exposure_ns = mode_.exposure_ns;
    info.lost_before = shot->lost_before;
    return Frame(this, 0, frames_.frame(shot->lasers != 0 ? 1 + static_cast<int>(shot->sequence % kDrawn) : 0), info);
  }
  tl::expected<std::int64_t, CameraError> set_exposure(std::int64_t) override { return mode_.exposure_ns; }
  void give_back(std::uint32_t) noexcept override {}

 private:
  testing::FakeMachine& machine_;
  DrawnFrames& frames_;
  CameraMode mode_;
};

class Watcher final : public ScanObserver {
 public:
  void on_state(ScanState) override {}
  void on_progress(const ScanProgress& progress) override { last = progress; }
  void on_status(const DeviceStatus&) override {}
  std::optional<std::string> cancelled() override { return std::nullopt; }
  ScanProgress last;
};

void scan(DrawnFrames& frames, int profiles, const char* label) {
  testing::FakeMachine machine;
  const Calibration of_machine = machine.calibration();
  auto connection = machine.connect(of_machine);
  Calibration calibration = sim::DeviceModel(frames.device).calibration();
  calibration.time = of_machine.time;
  DrawnCamera camera(machine, frames, of_machine.camera);
  const testing::TemporaryFolder folder;
  ScanTask task;
  task.request.profiles = profiles;
  task.request.formats = {"step"};
  task.date = "2026-01-02T03:04:05Z";
  task.log_file = folder / "profiles.log";
  task.results_folder = folder / "results";
  Watcher watcher;
  const auto outcome =
      run_scan({connection->device.get(), camera, *connection->clock, calibration, nullptr, {}}, task, watcher);
  if (!outcome) {
    std::fprintf(stderr, "path_bench: the scan failed: %s\n", outcome.error().reason.c_str());
    std::exit(1);
  }
  std::printf("%-9s  %7.0f frames/s  %9llu samples  %6.0f ms from the last frame to the STEP file  %4.0f MB\n", label,
              watcher.last.frames_per_second, static_cast<unsigned long long>(watcher.last.samples),
              1e3 * outcome->last_frame_to_step_s, peak_MB() - static_cast<double>(frames.bytes.size()) / (1 << 20));
  std::fputs(testing::read_file(task.results_folder / "report.json").c_str(), stderr);
}

void run_on_one_core() {
  cpu_set_t one;
  CPU_ZERO(&one);
  CPU_SET(static_cast<unsigned>(sched_getcpu()), &one);
  sched_setaffinity(0, sizeof one, &one);
}

int run(int profiles) {
  DrawnFrames frames;
  std::printf("%d profiles of %d rows (%d x %d frames, %d distinct)\n", profiles, frames.device.camera.height_px,
              frames.device.camera.width_px, frames.device.camera.height_px, kDrawn);
  scan(frames, profiles, "all cores");
  run_on_one_core();
  scan(frames, profiles, "one core");
  return 0;
}

}  // namespace
}  // namespace celadon

int main(int argc, char** argv) {
  const int profiles = argc > 1 ? std::atoi(argv[1]) : 3600;
  if (profiles < 16) {
    std::fprintf(stderr, "path_bench: '%s' is no number of profiles; give 16 or more.\n", argv[1]);
    return 2;
  }
  return celadon::run(profiles);
}
