// Handles are no part of a single-valued surface; lobes, steps and edges are.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "tests/fitting/fit_tools.h"

namespace celadon {
namespace {

using test::fit;
using test::kPi;
using test::MemoryStream;
using test::miss;
using test::scan;
using testing::HasSubstr;

// A ring of round section in the plane theta = 2 about a point of the wall: half of it stands out as a handle.
struct Handle {
  double wall_mm, height_mm;   // of its middle
  double ring_mm, section_mm;  // radii
  static constexpr double theta_rad = 2;
  double depth(double r, double theta, double z) const {
    const double x = r * std::cos(theta - theta_rad), y = r * std::sin(theta - theta_rad);
    return section_mm - std::hypot(std::hypot(x - wall_mm, z - height_mm) - ring_mm, y);
  }
  // The outermost point of the ring on a ray from the axis, beyond the body at r; else r.
  double outermost(double r, double theta, double z) const {
    const double far = wall_mm + ring_mm + section_mm + 1;
    if (std::cos(theta - theta_rad) < 0 || r * std::abs(std::sin(theta - theta_rad)) > section_mm) return r;
    for (double out = far; out > r; out -= section_mm / 20) {
      if (depth(out, theta, z) <= 0) continue;
      double in = out, beyond = out + section_mm / 20;
      for (int k = 0; k < 40; ++k) (depth((in + beyond) / 2, theta, z) > 0 ? in : beyond) = (in + beyond) / 2;
      return in;
    }
    return r;
  }
  bool near(double theta, double z) const {
    const double across = wall_mm * std::abs(std::remainder(theta - theta_rad, 2 * kPi));
    return across < 2 * section_mm + 8 && std::abs(z - height_mm) < ring_mm + 2 * section_mm + 8;
  }
};

double cup(double t, double z) {
  return 26 + 10 * std::sqrt(z / 120 + 0.02) + 0.8 * std::cos(2 * t) + 0.3 * std::sin(3 * t + z / 25);
}

struct CupScan {
  double ring_mm, section_mm;
  int profiles, rows;
  double sigma_mm;
  bool shadow;  // samples beside the handle are missing on one side, as where a camera looks from
};

class Cups : public testing::TestWithParam<CupScan> {};

// Rays from outside stop at the handle; the body behind it is never seen. The surface goes through under it.
TEST_P(Cups, HandlesThatHideTheBodyAreLeftOut) {
  const CupScan& c = GetParam();
  const Handle handle{cup(2, 60), 60, c.ring_mm, c.section_mm};
  MemoryStream stream = scan(cup, {.profiles = c.profiles, .rows = c.rows, .sigma = c.sigma_mm, .seed = 11});
  std::size_t on_handle = 0;
  for (Profile& p : stream.profiles) {
    Profile seen;
    for (std::size_t k = 0; k < p.size(); ++k) {
      const double body = p.r_mm[k], t = p.theta_rad[k], z = p.z_mm[k];
      const double r = handle.outermost(body, t, z);
      const bool hidden =
          c.shadow && r == body && t < 2 && handle.outermost(body, t + 0.25 * (c.ring_mm / body), z) > body + 2;
      if (hidden) continue;
      on_handle += r > body + 1;
      test::push(seen, r, t, z);
      seen.row.push_back(p.row[k]);
    }
    p = seen;
  }
  const auto f = fit(stream);
  ASSERT_TRUE(f) << f.error().message;
  EXPECT_THAT(f->report.warnings, testing::Contains(HasSubstr("handles or undercuts")));
  EXPECT_GE(static_cast<double>(f->report.unfollowable + f->report.rejected), 0.9 * static_cast<double>(on_handle));
  EXPECT_LE(static_cast<double>(f->report.unfollowable + f->report.rejected),
            2.5 * static_cast<double>(on_handle) + 20);
  // Where it was seen the body is where it is; under the handle it is bridged.
  EXPECT_LT(miss(f->function, cup, [&](double t, double z) { return !handle.near(t, z); }).rms,
            0.01 + 0.3 * c.sigma_mm);
  EXPECT_LT(miss(f->function, cup).max, 1.5) << "of " << c.ring_mm + c.section_mm << " mm";
}

INSTANTIATE_TEST_SUITE_P(Sizes, Cups,
                         testing::Values(CupScan{20, 5, 400, 300, 0.05, false}, CupScan{20, 5, 200, 150, 0.1, true},
                                         CupScan{12, 3, 400, 300, 0.02, false}, CupScan{25, 6, 120, 100, 0.2, true},
                                         CupScan{30, 4, 300, 200, 0.05, true}, CupScan{15, 6, 300, 300, 0.3, false},
                                         CupScan{20, 5, 400, 300, 0, false}));

// Smooth lobes, however deep, lose no sample.
RC_GTEST_PROP(Handles, SmoothLobesAreOfTheBody, ()) {
  const int lobes = *rc::gen::inRange(1, 9), waves = *rc::gen::inRange(0, 4);
  const int profiles = *rc::gen::elementOf(std::vector<int>{90, 150, 240});
  const int rows = *rc::gen::elementOf(std::vector<int>{60, 120});
  const double share = 0.01 * *rc::gen::inRange(10, 100);
  // r' = dr/(r dtheta) up to 2.8: eight lobes of +-10 mm on 30 mm.
  const double depth = share * std::min(14.0, 80.0 / lobes), slant = 0.01 * *rc::gen::inRange(-3, 4);
  const auto shape = [=](double t, double z) {
    return 30 + depth * std::cos(lobes * t + slant * z) * (waves > 0 ? std::sin(waves * kPi * z / 120) : 1.0);
  };
  MemoryStream stream = scan(shape, {.profiles = profiles, .rows = rows, .sigma = 0.03});
  const auto f = fit(stream);
  RC_ASSERT(f.has_value());
  RC_LOG() << lobes << " lobes of " << depth << " mm, waves " << waves << ", slant " << slant << ", " << profiles
           << " x " << rows << ": unfollowable " << f->report.unfollowable << ", rejected " << f->report.rejected;
  RC_ASSERT(f->report.unfollowable == 0u);
  RC_ASSERT(f->report.rejected <= f->report.points / 500);
}

// Edges and steps lose none worth mentioning.
TEST(Handles, BoxesAndStepsAreOfTheBody) {
  const auto box = [](double t, double) {
    return 25 / std::max(std::abs(std::cos(t - 0.3)), std::abs(std::sin(t - 0.3)));
  };
  const auto blade = [](double t, double) {  // 60 x 15 mm
    return 1 / std::max(std::abs(std::cos(t - 0.3)) / 30, std::abs(std::sin(t - 0.3)) / 7.5);
  };
  const auto shaft = [](double, double z) { return z < 30 ? 20.0 : (z < 60 ? 35.0 : (z < 90 ? 25.0 : 40.0)); };
  const auto pads = [](double t, double z) {
    return 30 + (std::cos(3 * t) > 0.4 && std::abs(z - 60) < 30 ? 3.0 : 0.0);
  };
  for (const int n : {100, 200, 400}) {
    int which = 0;
    for (const test::Shape& shape : {test::Shape(box), test::Shape(blade), test::Shape(shaft), test::Shape(pads)}) {
      MemoryStream stream = scan(shape, {.profiles = n, .rows = n, .sigma = 0.03});
      const auto f = fit(stream);
      ASSERT_TRUE(f) << f.error().message;
      EXPECT_LE(static_cast<double>(f->report.unfollowable + f->report.rejected),
                0.01 * static_cast<double>(f->report.points))
          << which << " with " << n;
      ++which;
    }
  }
}

}  // namespace
}  // namespace celadon
