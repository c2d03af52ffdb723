// What goes wrong with samples, in any combination: the surface is the body's all the same, or a sentence says why
// there is none. Never a crash, never a surface that is silently another one.

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <string>

#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::kPi;
constexpr double kSigma = 0.03;

double body(double t, double z) {
  return 30 + 6 * std::sin(2 * kPi * z / 120) + 2 * std::cos(3 * t) * std::sin(kPi * z / 120);
}

RC_GTEST_PROP(BadData, SpoilsNothing, (std::uint64_t seed)) {
  std::mt19937_64 random(seed);
  const auto chance = [&](double share) { return std::uniform_real_distribution<double>(0, 1)(random) < share; };
  test::MemoryStream stream = test::scan(body, {.profiles = 90, .rows = 70, .sigma = kSigma});
  const bool turns = chance(0.5), twice = chance(0.5), numbers = chance(0.5), axis = chance(0.5), empty = chance(0.5),
             far = chance(0.5);
  const double bad[] = {
      std::nan(""), std::numeric_limits<double>::infinity(), -5, 0, -std::numeric_limits<double>::infinity(), 1e30,
      1e300};
  test::MemoryStream spoiled;
  for (Profile p : stream.profiles) {
    const std::size_t n = p.size();
    for (std::size_t k = 0; k < n; ++k) {
      if (turns) p.theta_rad[k] += 2 * kPi * static_cast<double>(static_cast<int>(random() % 7) - 3);
      if (twice && chance(0.2)) test::push(p, p.r_mm[k], p.theta_rad[k], p.z_mm[k]);
      if (numbers && chance(0.03)) p.r_mm[k] = bad[random() % 7];
      if (numbers && chance(0.01)) p.theta_rad[k] = bad[random() % 2];
      if (numbers && chance(0.01)) p.z_mm[k] = bad[random() % 2];
      if (axis && chance(0.03)) p.r_mm[k] = 0;
      if (far && chance(0.02)) p.r_mm[k] += 40;
    }
    p.row.clear();
    p.order = ProfileOrder::scattered;
    if (empty && chance(0.2)) spoiled.profiles.emplace_back();
    spoiled.profiles.push_back(std::move(p));
  }
  const auto fit = test::fit(spoiled);
  if (!fit) RC_FAIL(fit.error().message);
  RC_ASSERT(test::miss(fit->function, body).rms < 0.4 * kSigma);
  RC_ASSERT(fit->report.points == spoiled.points());
  RC_ASSERT(std::abs(fit->report.noise_mm - kSigma) < 0.15 * kSigma);
}

// A tolerance that nothing can hold is told, and changes no more than the knots.
TEST(BadData, AToleranceBelowRoundingIsTold) {
  test::MemoryStream stream = test::scan(body, {.sigma = kSigma});
  RangeFitOptions options;
  options.tolerance_mm = 1e-15;
  const auto fit = test::fit(stream, options);
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_NE(fit->report.stopped_by.find("was not reached"), std::string::npos) << fit->report.stopped_by;
  EXPECT_LT(test::miss(fit->function, body).rms, kSigma);
}

TEST(BadData, WhatShowsNoSurfaceIsRefusedInWords) {
  const auto message = [](test::MemoryStream stream) {
    const auto fit = fit_samples(stream);
    return fit ? std::string("fitted") : fit.error().message;
  };
  test::MemoryStream one = test::scan(body, {.profiles = 1});
  EXPECT_NE(message(one).find("sectors around the axis have samples"), std::string::npos) << message(one);
  test::MemoryStream level = test::scan(body, {.height = 0});
  EXPECT_NE(message(level).find("same height"), std::string::npos) << message(level);
  test::MemoryStream on_axis = test::scan([](double, double) { return 0.0; }, {});
  EXPECT_NE(message(on_axis).find("on the axis"), std::string::npos) << message(on_axis);
  test::MemoryStream few = test::scan(body, {.profiles = 3, .rows = 2});
  EXPECT_NE(message(few), "fitted");
  EXPECT_NE(message({}), "fitted");
  test::MemoryStream nothing = test::scan([](double, double) { return std::nan(""); }, {});
  EXPECT_NE(message(nothing).find("number"), std::string::npos) << message(nothing);
}

}  // namespace
}  // namespace celadon
