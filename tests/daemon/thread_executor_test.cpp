#include "daemon/thread_executor.h"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <stdexcept>
#include <vector>

#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

TEST(ThreadExecutor, RunsEveryTaskOnce) {
  for (const int count : {0, 1, 2, 3, 100}) {
    std::vector<std::atomic<int>> runs(static_cast<std::size_t>(count));
    run_on_all_cores(count, [&](int k) { ++runs[static_cast<std::size_t>(k)]; });
    for (const auto& n : runs) EXPECT_EQ(n, 1);
  }
}

TEST(ThreadExecutor, ThrowsWhatATaskThrew) {
  std::atomic<int> others{0};
  EXPECT_THROW(run_on_all_cores(8,
                                [&](int k) {
                                  if (k == 5) throw std::runtime_error("the fifth");
                                  ++others;
                                }),
               std::runtime_error);
  EXPECT_LE(others, 7);
}

// The parts decide, not who works on them: the same bits from one thread, from many and in any order.
TEST(ThreadExecutor, FitsHaveTheSameBitsFromAnyNumberOfThreads) {
  test::ScanSetting setting;
  setting.profiles = 240;
  setting.rows = 200;
  setting.sigma = 0.02;
  test::MemoryStream whole = test::scan(test::freeform, setting);
  const auto grid = choose_grid(whole, {});
  ASSERT_TRUE(grid);
  MomentGrid sums = test::accumulate(whole, *grid);
  FirstLook look(sums);
  std::vector<std::unique_ptr<test::MemoryStream>> streams;
  std::vector<ProfileStream*> parts;
  for (std::size_t k = 0; k < whole.profiles.size(); ++k) {
    Profile& profile = whole.profiles[k];
    profile.covariance.assign(profile.size(), {4e-4f * (1 + static_cast<float>(k % 3)), 0, 0, 1e-8f, 0, 1e-6f});
    look.add(profile);
    if (k % 60 == 0) {
      streams.push_back(std::make_unique<test::MemoryStream>());
      parts.push_back(streams.back().get());
    }
    streams.back()->profiles.push_back(profile);
  }
  const auto fit_with = [&](const Executor& executor) {
    auto surface = fit_surface(sums, look, parts, {}, executor);
    EXPECT_TRUE(surface) << surface.error().message;
    return measure_errors(std::move(*surface), parts, executor);
  };
  const RangeFit alone = fit_with(run_in_turn), together = fit_with(run_on_all_cores),
                 backwards = fit_with([](int count, const std::function<void(int)>&task) {
                   for (int k = count; k-- > 0;) task(k);
                 });
  for (const RangeFit& other : {together, backwards}) {
    EXPECT_EQ(other.function.coefficients(), alone.function.coefficients());
    EXPECT_EQ(other.report.noise_mm, alone.report.noise_mm);
    EXPECT_EQ(other.report.kappa, alone.report.kappa);
    EXPECT_EQ(other.report.residual_mm.rms, alone.report.residual_mm.rms);
    EXPECT_EQ(other.report.geometric_mm.p95, alone.report.geometric_mm.p95);
    EXPECT_EQ(other.report.rejected, alone.report.rejected);
  }
  // Against the samples as one stream only rounding and the seams of the correlation differ.
  ProfileStream* const one[] = {&whole};
  auto surface = fit_surface(sums, look, one, {});
  ASSERT_TRUE(surface);
  const RangeFit of_one = measure_errors(std::move(*surface), one);
  EXPECT_EQ(of_one.report.model, alone.report.model);
  EXPECT_NEAR(of_one.report.noise_mm, alone.report.noise_mm, 1e-9);
  EXPECT_NEAR(of_one.report.kappa, alone.report.kappa, 0.05);
  EXPECT_NEAR(of_one.report.residual_mm.rms, alone.report.residual_mm.rms, 1e-4);
  EXPECT_EQ(of_one.report.points, alone.report.points);
}

}  // namespace
}  // namespace celadon
