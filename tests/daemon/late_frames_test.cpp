// Frames that a driver stamps late, because the computer was busy when they came.

#include <gtest/gtest.h>

#include <rapidcheck/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "daemon/arrival_watch.h"
#include "daemon/profile_log.h"
#include "daemon/scan_job.h"
#include "tests/daemon/fake_machine.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::FakeMachine;
using testing::TemporaryFolder;

struct Arrival {
  ArrivalWatch::Exposure seen;
  std::int64_t exposed_ns;
  std::int64_t late_ns() const { return seen.began_ns - exposed_ns; }
};

/// Frames of a camera that runs freely, some of them lost; a share arrives late, and those after them not before them.
std::vector<Arrival> arrivals(std::int64_t period_ns, double share_late, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<Arrival> frames;
  std::int64_t newest_ns = 0;
  for (std::uint64_t k = 0; k < 200; ++k) {
    if (k > 0 && uniform(random) < 0.1) continue;
    const std::int64_t exposed_ns = static_cast<std::int64_t>(k) * period_ns;
    const double late = k > 0 && uniform(random) < share_late ? 5 * uniform(random) : 0;
    newest_ns = std::max(newest_ns + 1, exposed_ns + static_cast<std::int64_t>(late * static_cast<double>(period_ns)));
    frames.push_back({{k, newest_ns}, exposed_ns});
  }
  return frames;
}

RC_GTEST_PROP(ArrivalWatch, LateFramesAreAskedAboutAndTheNextOneTells, (std::uint32_t seed)) {
  const auto period_ns = static_cast<std::int64_t>(1e6) * *rc::gen::inRange(2, 200);
  const auto period = static_cast<double>(period_ns);
  const auto frames = arrivals(period_ns, 0.1, seed);
  ArrivalWatch watch(period_ns);
  std::uint64_t punctual = 0;  // number of the newest that was on time
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const Arrival& frame = frames[i];
    watch.see(frame.seen);
    const auto since = static_cast<double>(frame.seen.sequence - punctual);
    if (!watch.may_be_late()) RC_ASSERT(static_cast<double>(frame.late_ns()) <= (0.1 + 0.03 * since) * period);
    if (frame.late_ns() <= 1000) punctual = frame.seen.sequence;
    if (frame.late_ns() <= 1000) RC_ASSERT(!watch.may_be_late());
    if (i + 1 == frames.size() || frames[i + 1].late_ns() > frame.late_ns()) continue;
    const auto sooner = static_cast<double>(frame.late_ns() - frames[i + 1].late_ns());
    const auto periods = static_cast<double>(frames[i + 1].seen.sequence - frame.seen.sequence);
    const bool late = watch.is_late(frame.seen, frames[i + 1].seen);
    if (sooner > (0.01 + 0.05 * periods) * period) RC_ASSERT(late);
    if (frame.late_ns() <= 1000) RC_ASSERT(!late);
  }
}

TEST(ArrivalWatch, ACameraThatMadeAPauseIsNotLateOnceTheNextFrameCame) {
  constexpr std::int64_t kPeriod_ns = 40'000'000;
  ArrivalWatch watch(kPeriod_ns);
  watch.see({0, 0});
  watch.see({1, 90'000'000});
  EXPECT_TRUE(watch.may_be_late());
  EXPECT_FALSE(watch.is_late({1, 90'000'000}, {2, 130'000'000}));
  watch.trust({1, 90'000'000}, {2, 130'000'000});
  EXPECT_FALSE(watch.may_be_late());
  watch.see({3, 170'000'000});
  EXPECT_FALSE(watch.may_be_late());
}

/// A body off the axis: a picture of another table angle is measured as another radius.
double body(double theta_rad, double /*z_mm*/) {
  return 30 + 5 * std::cos(theta_rad);
}

struct Errors {
  double max_mm = 0;
  std::size_t profiles = 0, smallest_profile = 1000;
};

/// What samples of a scan miss the body by when the computer stands still for up to 0.3 s every 0.7 s.
Errors errors_of(ScanMode mode, int profiles, std::uint32_t seed) {
  FakeMachine machine;
  machine.shape = body;
  machine.buffers = 64;  // none is full of frames from before the move
  machine.stamped_us = [seed](std::int64_t read_out_us) {
    constexpr std::int64_t kEvery_us = 700'000;
    const std::int64_t number = read_out_us / kEvery_us, within_us = read_out_us % kEvery_us;
    std::mt19937 random(seed + static_cast<std::uint32_t>(number) * 7919);
    const std::int64_t begin_us = std::uniform_int_distribution<int>(0, 300'000)(random);
    const std::int64_t end_us = begin_us + std::uniform_int_distribution<int>(5'000, 300'000)(random);
    return within_us >= begin_us && within_us < end_us ? number * kEvery_us + end_us : read_out_us;
  };
  const TemporaryFolder folder;
  const Calibration calibration = machine.calibration();
  auto connection = machine.connect(calibration);
  ScanTask task;
  task.request.profiles = profiles;
  task.request.mode = mode;
  task.request.formats = {"surface.json"};
  task.date = "2026-01-02T03:04:05Z";
  task.log_file = folder / "profiles.log";
  task.results_folder = folder / "results";
  struct Silent final : ScanObserver {
    void on_state(ScanState) override {}
    void on_progress(const ScanProgress&) override {}
    void on_status(const DeviceStatus&) override {}
    std::optional<std::string> cancelled() override { return std::nullopt; }
  } observer;
  auto outcome = run_scan({connection->device.get(), *connection->camera, *connection->clock, calibration, nullptr, {}},
                          task, observer);
  EXPECT_TRUE(outcome) << outcome.error().reason;
  Errors errors;
  auto log = ProfileLogReader::open(task.log_file);
  for (const Profile* profile = nullptr; log && (profile = (*log)->next()) != nullptr;) {
    ++errors.profiles;
    errors.smallest_profile = std::min(errors.smallest_profile, profile->size());
    for (std::size_t i = 0; i < profile->size(); ++i) {
      const double error = profile->r_mm[i] - body(profile->theta_rad[i], profile->z_mm[i]);
      errors.max_mm = std::max(errors.max_mm, std::abs(error));
    }
  }
  std::printf("%zu profiles, %zu samples at least, off by %.4f mm at most\n", errors.profiles, errors.smallest_profile,
              errors.max_mm);
  return errors;
}

TEST(LateFrames, OfATableThatMovedYetAreNoneOfItAtRest) {
  for (const std::uint32_t seed : {1U, 2U}) {
    const Errors errors = errors_of(ScanMode::step, 60, seed);
    EXPECT_EQ(errors.profiles, 60) << seed;
    EXPECT_GT(errors.smallest_profile, 200) << seed;
    EXPECT_LT(errors.max_mm, 0.2) << seed;
  }
}

TEST(LateFrames, OfASweepAreLeftOut) {
  for (const std::uint32_t seed : {1U, 2U}) {
    const Errors errors = errors_of(ScanMode::sweep, 180, seed);
    EXPECT_GE(errors.profiles, 90) << seed;  // of the others most do not find a buffer
    EXPECT_LT(errors.max_mm, 0.2) << seed;
  }
}

}  // namespace
}  // namespace celadon
