#include "acquisition/table_encoder.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <numbers>

namespace celadon {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;

/// Off centre by up to what a file may hold.
TableEncoder any_encoder() {
  const auto number = [](int low, int high) { return *rc::gen::inRange(low, high) * 1e-4; };
  TableEncoder out;
  out.scale.value = number(9000, 11000);
  out.cos_rad.value = number(-3000, 3000);
  out.sin_rad.value = number(-3000, 3000);
  out.direction = *rc::gen::element(-1., 1.);
  return out;
}

RC_GTEST_PROP(TableEncoder, IsNoughtAtTheIndexAndTheSameInEveryTurnButForTheScale, ()) {
  const TableEncoder encoder = any_encoder();
  RC_ASSERT(encoder.table_rad(0) == 0);
  const double b = *rc::gen::inRange(-100000, 100000) * 1e-3;
  const double turned = encoder.table_rad(b + kTurn_rad) - encoder.table_rad(b);
  RC_ASSERT(std::abs(turned - encoder.direction * encoder.scale.value * kTurn_rad) < 1e-10);
}

RC_GTEST_PROP(TableEncoder, InverseAndRateAreThoseOfTheAngle, ()) {
  const TableEncoder encoder = any_encoder();
  const double b = *rc::gen::inRange(-100000, 100000) * 1e-3;
  RC_ASSERT(std::abs(encoder.encoder_rad(encoder.table_rad(b)) - b) < 1e-11);
  const double slope = (encoder.table_rad(b + 1e-4) - encoder.table_rad(b - 1e-4)) / 2e-4;
  RC_ASSERT(std::abs(encoder.rate(b) - slope) < 1e-7);
}

// A disc of radius R whose middle lies d beside the axis, towards an angle a of the table: what stands before the
// reader, fixed at distance R, has turned about the disc's middle by atan2(R sin b + d sin a, R cos b + d cos a).
TEST(TableEncoder, FollowsADiscThatIsOffCentre) {
  constexpr double kRadius_mm = 30, kBeside_mm = 0.05, kTowards_rad = 1.1;
  const auto disc = [&](double table) {
    return std::atan2(kRadius_mm * std::sin(table) + kBeside_mm * std::sin(kTowards_rad),
                      kRadius_mm * std::cos(table) + kBeside_mm * std::cos(kTowards_rad));
  };
  const double e = kBeside_mm / kRadius_mm;
  TableEncoder encoder;
  encoder.cos_rad.value = -e * std::sin(kTowards_rad);
  encoder.sin_rad.value = e * std::cos(kTowards_rad);
  for (int k = -30; k <= 30; ++k) {
    const double table = k * 0.1, counted = disc(table) - disc(0);
    // The second order of e, counted from the index.
    EXPECT_NEAR(encoder.table_rad(counted), table, 3 * e * e) << table;
  }
}

}  // namespace
}  // namespace celadon
