// A camera mounted on its side: its picture shows the laser's line lying.

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <variant>

#include "daemon/profile_log.h"
#include "daemon/scan_job.h"
#include "tests/daemon/fake_machine.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::FakeMachine;
using testing::TemporaryFolder;

class Silent final : public ScanObserver {
 public:
  void on_state(ScanState) override {}
  void on_progress(const ScanProgress&) override {}
  void on_status(const DeviceStatus&) override {}
  std::optional<std::string> cancelled() override { return std::nullopt; }
};

/// Samples of a scan, and the RMS of their radius less the vase's.
struct Seen {
  std::size_t samples = 0, profiles = 0;
  double rms_mm = 0;
};

Seen scanned(bool on_side) {
  const TemporaryFolder folder;
  FakeMachine machine;
  machine.camera_on_side = on_side;
  const Calibration calibration = machine.calibration();
  auto connection = machine.connect(calibration);
  EXPECT_TRUE(connection) << connection.error().message;
  ScanTask task;
  task.request.profiles = 48;
  task.request.mode = ScanMode::step;
  task.request.formats = {"surface.json"};
  task.date = "2026-01-02T03:04:05Z";
  task.log_file = folder / "profiles.log";
  task.results_folder = folder / "results";
  Silent observer;
  const auto outcome = run_scan(
      {connection->device.get(), *connection->camera, *connection->clock, calibration, nullptr, {}}, task, observer);
  EXPECT_TRUE(outcome) << (outcome ? "" : outcome.error().reason);
  Seen seen;
  auto log = ProfileLogReader::open(task.log_file);
  EXPECT_TRUE(log);
  while (const auto entry = (*log)->next_entry()) {
    const auto* const logged = std::get_if<LoggedProfile>(&*entry);
    if (logged == nullptr) continue;
    const Profile& profile = *logged->profile;
    ++seen.profiles;
    for (std::size_t i = 0; i < profile.size(); ++i) {
      const double truth = FakeMachine::vase(profile.theta_rad[i], profile.z_mm[i]);
      if (truth == 0) continue;
      seen.rms_mm += std::pow(profile.r_mm[i] - truth, 2);
      ++seen.samples;
    }
  }
  seen.rms_mm = std::sqrt(seen.rms_mm / static_cast<double>(seen.samples));
  return seen;
}

TEST(SideCamera, SeesWhatAnUprightOneSees) {
  const Seen upright = scanned(false), lying = scanned(true);
  EXPECT_GT(upright.samples, 3000u);
  EXPECT_EQ(lying.profiles, upright.profiles);
  EXPECT_NEAR(static_cast<double>(lying.samples), static_cast<double>(upright.samples),
              0.02 * static_cast<double>(upright.samples));
  EXPECT_LT(upright.rms_mm, 0.1);
  EXPECT_NEAR(lying.rms_mm, upright.rms_mm, 0.2 * upright.rms_mm);
}

}  // namespace
}  // namespace celadon
