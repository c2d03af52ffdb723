#include "acquisition/angle_timeline.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <random>
#include <string>
#include <vector>

namespace celadon {
namespace {

constexpr double kQuantum = 1.7e-5;  // 0.001 degrees

/// From rest to a speed at constant acceleration, steady, and to rest again.
struct Trapezoid {
  double acceleration = 0.8, speed = 0.2, steady_s = 20;
  double ramp_s() const { return speed / acceleration; }
  double angle(double t_s) const {
    const double ramp = ramp_s();
    t_s = std::clamp(t_s, 0.0, 2 * ramp + steady_s);
    if (t_s < ramp) return 0.5 * acceleration * t_s * t_s;
    if (t_s < ramp + steady_s) return speed * (t_s - 0.5 * ramp);
    const double left = 2 * ramp + steady_s - t_s;
    return speed * (ramp + steady_s) - 0.5 * acceleration * left * left;
  }
};

/// A controller with its own clock behind a link with random, unequal latencies.
struct Controller {
  double offset_ns = 4.7e15, drift = 60e-6, sampling_ns = 0;
  double least_latency_ns = 400e3, mean_extra_ns = 300e3;
  std::function<double(double)> angle;
  std::mt19937_64 random{11};
  std::uint32_t counter = 0;

  double host_ns(double device_s) const { return offset_ns + device_s * 1e9 * (1 + drift); }
  PositionSample poll(double device_s) {
    std::exponential_distribution<double> extra(1 / mean_extra_ns);
    const double there = least_latency_ns + extra(random), back = least_latency_ns + extra(random);
    // The sample is the last one taken, on the controller's own beat.
    const double taken_s = sampling_ns > 0 ? std::floor(device_s * 1e9 / sampling_ns) * sampling_ns * 1e-9 : device_s;
    PositionSample out;
    out.counter = ++counter;
    out.device_time_us = static_cast<std::uint64_t>(std::floor(taken_s * 1e6));
    out.angle_rad = std::round(angle(static_cast<double>(out.device_time_us) * 1e-6) / kQuantum) * kQuantum;
    out.host_before_ns = static_cast<std::int64_t>(host_ns(device_s) - there);
    out.host_after_ns = static_cast<std::int64_t>(host_ns(device_s) + back);
    return out;
  }
};

TEST(AngleTimeline, follows_a_closed_form_motion_within_its_uncertainty) {
  const Trapezoid motion;
  Controller controller;
  controller.angle = [&](double t_s) { return motion.angle(t_s - 3); };
  AngleTimeline timeline(kQuantum);
  double sum = 0, worst = 0;
  int count = 0;
  double asked_s = 0.5;
  for (double t_s = 0.01; t_s < 30; t_s += 0.02) {
    timeline.add(controller.poll(t_s));
    for (; asked_s < t_s - 0.05; asked_s += 0.0037) {
      const auto at = timeline.at(static_cast<std::int64_t>(controller.host_ns(asked_s)));
      ASSERT_TRUE(at) << at.error();
      const double error = at->angle_rad - controller.angle(asked_s);
      ASSERT_GT(at->sigma_rad, 0);
      const double ratio = std::abs(error) / at->sigma_rad;
      worst = std::max(worst, ratio);
      sum += ratio * ratio;
      ++count;
      // A jump of the acceleration in the 20 ms between two samples moves the table by at most a dt^2 / 8.
      EXPECT_LT(std::abs(error), 3 * kQuantum + 0.2e-3 * motion.speed + 0.8 * 0.02 * 0.02 / 8) << asked_s;
    }
  }
  ASSERT_GT(count, 7000);
  // The clocks' error is common to all: the ratio may be anything below about two, but not far above.
  EXPECT_LT(std::sqrt(sum / count), 1.3);
  EXPECT_LT(worst, 4.5);
}

TEST(AngleTimeline, is_exact_at_constant_acceleration_between_samples) {
  AngleTimeline timeline(0);
  const auto angle = [](double t_s) { return 0.3 + 0.2 * t_s - 0.7 * t_s * t_s; };
  for (int i = 0; i < 8; ++i) {
    // Uneven times; no latency, so the clocks agree exactly.
    const std::int64_t us = 20'000 * i + 3'000 * (i % 3);
    timeline.add({.counter = static_cast<std::uint32_t>(i),
                  .device_time_us = static_cast<std::uint64_t>(us),
                  .angle_rad = angle(static_cast<double>(us) * 1e-6),
                  .host_before_ns = us * 1000,
                  .host_after_ns = us * 1000});
  }
  for (std::int64_t us = 0; us <= timeline.newest_ns() / 1000; us += 1300) {
    const double t_s = static_cast<double>(us) * 1e-6;
    const auto at = timeline.at(us * 1000);
    ASSERT_TRUE(at);
    EXPECT_NEAR(at->angle_rad, angle(t_s), 1e-12);
    EXPECT_NEAR(at->speed_rad_per_s, 0.2 - 1.4 * t_s, 1e-9);
  }
}

TEST(AngleTimeline, quantisation_alone_gives_the_spread_it_states) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> start(0, 1);
  double variance = 0, stated = 0;
  int count = 0;
  for (int trial = 0; trial < 4000; ++trial) {
    const double begin = start(random), speed = 0.2 + 0.1 * start(random);
    AngleTimeline timeline(kQuantum);
    for (int i = 0; i < 6; ++i) {
      const double angle = std::round((begin + speed * 0.02 * i) / kQuantum) * kQuantum;
      timeline.add({.counter = static_cast<std::uint32_t>(i),
                    .device_time_us = static_cast<std::uint64_t>(20'000 * i),
                    .angle_rad = angle,
                    .host_before_ns = 20'000'000L * i,
                    .host_after_ns = 20'000'000L * i});
    }
    for (std::int64_t ns : {47'000'000L, 50'000'000L, 40'000'000L}) {
      const auto at = timeline.at(ns);
      ASSERT_TRUE(at);
      const double error = at->angle_rad - (begin + speed * static_cast<double>(ns) * 1e-9);
      variance += error * error;
      stated += at->sigma_rad * at->sigma_rad;
      ++count;
    }
  }
  EXPECT_NEAR(std::sqrt(variance / count), kQuantum / std::sqrt(12.0), 0.2 * kQuantum / std::sqrt(12.0));
  // It states no less than there is, and little more: half the blended parabolas' disagreement is in it.
  EXPECT_GT(stated, 0.95 * variance);
  EXPECT_LT(stated, 2 * variance);
}

TEST(AngleTimeline, finds_offset_and_drift_of_the_clocks_within_the_stated_limit) {
  for (const double sampling_ns : {0.0, 1e6}) {
    for (const double drift : {-80e-6, 0.0, 60e-6}) {
      Controller controller;
      controller.drift = drift;
      controller.sampling_ns = sampling_ns;
      controller.angle = [](double) { return 0.0; };
      AngleTimeline timeline(kQuantum);
      for (double t_s = 0.01; t_s < 120; t_s += 0.0213) timeline.add(controller.poll(t_s));
      for (const double t_s : {0.0, 40.0, 119.0, 121.0}) {
        const double truth = controller.host_ns(t_s);
        const auto found = static_cast<double>(timeline.host_time_ns(static_cast<std::uint64_t>(t_s * 1e6)));
        // Equal least latencies on both ways: half a round trip of 0.8 ms is right but for the scatter of the quickest
        // answers, and for samples up to one beat old.
        EXPECT_NEAR(found, truth, sampling_ns > 0 ? 250e3 : 100e3)
            << "drift " << drift << " at " << t_s << " beat " << sampling_ns;
      }
    }
  }
}

TEST(AngleTimeline, slow_answers_do_not_pull_the_clock) {
  Controller controller;
  controller.angle = [](double) { return 0.0; };
  AngleTimeline timeline(kQuantum);
  for (double t_s = 0.01; t_s < 60; t_s += 0.02) {
    PositionSample sample = controller.poll(t_s);
    // For whole seconds the link is busy: every answer is 30 ms late.
    if (std::fmod(t_s, 10) > 7) sample.host_after_ns += 30'000'000;
    timeline.add(sample);
  }
  for (const double t_s : {5.0, 28.0, 59.0}) {
    EXPECT_NEAR(static_cast<double>(timeline.host_time_ns(static_cast<std::uint64_t>(t_s * 1e6))),
                controller.host_ns(t_s), 300e3);
  }
}

// The figure: 36 degrees/s, answers late by up to 1 ms, the virtual scanner's encoder.
TEST(AngleTimeline, knows_the_angle_at_an_instant_in_spite_of_jitter_in_the_answers) {
  constexpr double kDegree = std::numbers::pi / 180, kSpeed = 36 * kDegree, kCount = 0.0025 * kDegree;
  for (const StampedBy stamped_by : {StampedBy::controller, StampedBy::host}) {
    std::mt19937 random(17);
    std::uniform_real_distribution<double> late_ms(0, 1);
    AngleTimeline timeline(kCount, stamped_by);
    double worst = 0, worst_ratio = 0, sum = 0;
    int count = 0;
    for (int k = 0; k < 1500; ++k) {
      const std::int64_t before_ns = 5'000'000'000 + k * 20'000'000LL;
      const std::int64_t taken_us = (before_ns / 1000 + 250) / 1000 * 1000;  // sampled once a millisecond
      const double angle = kSpeed * static_cast<double>(taken_us) * 1e-6;
      PositionSample sample;
      sample.counter = static_cast<std::uint32_t>(k);
      sample.device_time_us = static_cast<std::uint64_t>(taken_us - 4'000'000);
      sample.device_reply_us = static_cast<std::uint64_t>(before_ns / 1000 + 250 - 4'000'000);
      sample.angle_rad = std::round(angle / kCount) * kCount;
      sample.host_before_ns = before_ns;
      sample.host_after_ns = before_ns + 500'000 + std::llround(late_ms(random) * 1e6);
      timeline.add(sample);
      if (k < 100) continue;  // two seconds, before the table turns
      for (const std::int64_t ago_ns : {21'000'000LL, 27'300'000LL, 33'100'000LL}) {
        const auto at = timeline.at(before_ns - ago_ns);
        ASSERT_TRUE(at);
        const double error = std::abs(at->angle_rad - kSpeed * static_cast<double>(before_ns - ago_ns) * 1e-9);
        worst = std::max(worst, error);
        worst_ratio = std::max(worst_ratio, error / at->sigma_rad);
        sum += error * error;
        ++count;
      }
    }
    std::printf("%s: %.4f deg rms, %.4f deg at most, at most %.1f times what is stated\n",
                stamped_by == StampedBy::controller ? "controller's stamps" : "host's stamps",
                std::sqrt(sum / count) / kDegree, worst / kDegree, worst_ratio);
    EXPECT_LT(worst, (stamped_by == StampedBy::controller ? 0.005 : 0.05) * kDegree);
    EXPECT_LT(worst_ratio, 3);
  }
}

TEST(AngleTimeline, refuses_to_extrapolate_beyond_the_limit_and_says_so) {
  AngleTimeline timeline(kQuantum);
  EXPECT_EQ(timeline.newest_ns(), INT64_MIN);
  EXPECT_NE(std::string(timeline.at(0).error()).find("poll the controller"), std::string::npos);
  for (int i = 0; i < 5; ++i) {
    timeline.add({.counter = static_cast<std::uint32_t>(i),
                  .device_time_us = static_cast<std::uint64_t>(20'000 * i),
                  .angle_rad = 0.01 * i,
                  .host_before_ns = 20'000'000L * i,
                  .host_after_ns = 20'000'000L * i});
  }
  EXPECT_EQ(timeline.newest_ns(), 80'000'000);
  const auto inside = timeline.at(70'000'000), edge = timeline.at(130'000'000), before = timeline.at(-50'000'000);
  ASSERT_TRUE(inside && edge && before);
  EXPECT_NEAR(edge->angle_rad, 0.065, 1e-12);
  EXPECT_NEAR(before->angle_rad, -0.025, 1e-12);
  EXPECT_GT(edge->sigma_rad, 2 * inside->sigma_rad);
  EXPECT_FALSE(timeline.at(130'000'001));
  EXPECT_FALSE(timeline.at(-50'000'001));
  EXPECT_TRUE(timeline.at(200'000'000, 120'000'000));
}

TEST(AngleTimeline, repeated_counters_add_no_position_and_a_restart_forgets_everything) {
  AngleTimeline timeline(kQuantum);
  timeline.add(
      {.counter = 7, .device_time_us = 1'000'000, .angle_rad = 1, .host_before_ns = 1000, .host_after_ns = 2000});
  timeline.add({.counter = 7,
                .device_time_us = 1'000'000,
                .angle_rad = 1,
                .host_before_ns = 9'000'000,
                .host_after_ns = 9'000'100});
  // The short round trip of the second reading says nothing of the stamp of the first.
  EXPECT_NEAR(static_cast<double>(timeline.newest_ns()), 1500, 501);
  timeline.add(
      {.counter = 1, .device_time_us = 50, .angle_rad = 5, .host_before_ns = 50'000'000, .host_after_ns = 50'000'000});
  EXPECT_EQ(timeline.newest_ns(), 50'000'000);
  EXPECT_NEAR(timeline.at(50'000'000)->angle_rad, 5, 0);
}

TEST(AngleTimeline, forgetting_positions_keeps_the_clock) {
  AngleTimeline timeline(kQuantum);
  timeline.add({.counter = 1, .device_time_us = 10, .angle_rad = 1, .host_before_ns = 5'000, .host_after_ns = 5'000});
  timeline.clear_positions();
  EXPECT_EQ(timeline.newest_ns(), INT64_MIN);
  EXPECT_FALSE(timeline.at(5'000));
  EXPECT_EQ(timeline.host_time_ns(11), 6'000);
}

TEST(AngleTimeline, impossible_samples_are_programmer_errors) {
  EXPECT_THROW(AngleTimeline(-1), std::invalid_argument);
  AngleTimeline timeline(kQuantum);
  EXPECT_THROW(timeline.add({.angle_rad = NAN}), std::invalid_argument);
  EXPECT_THROW(timeline.add({.host_before_ns = 2, .host_after_ns = 1}), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
