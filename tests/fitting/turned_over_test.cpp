// An object scanned twice, the second time upside down.

#include "fitting/turned_over.h"

#include <gtest/gtest.h>

#include "fitting/composite_fit.h"
#include "fitting/moved_stream.h"
#include "fitting/shape_choice.h"
#include "tests/fitting/composite_tools.h"

namespace celadon {
namespace {

using namespace test;

// Egg-like: a bellied wall between domes, with lobes of that size.
PieceBody egg(double lobes_mm) {
  const double R = 25, low = 0, high = 60;
  const auto round = [=](double theta) { return R + lobes_mm * std::cos(3 * theta); };
  // r = round(theta) + belly; belly and its slope are zero at both rims.
  return {.wall =
              [=](double theta, double z) {
                const double s = (z - low) / (high - low);
                return round(theta) + 40 * s * s * (1 - s) * (1 - s) * (1.4 - s);
              },
          .low = low,
          .high = high,
          .below = [=](double phi,
                       double theta) { return R + lobes_mm * std::cos(3 * theta) * std::pow(std::sin(phi), 4); },
          .above = [=](double phi,
                       double theta) { return R + lobes_mm * std::cos(3 * theta) * std::pow(std::sin(phi), 4); }};
}

// What a scan from the side and above sees of points: those over a height.
MemoryStream over(MemoryStream& all, const Eigen::Isometry3d& X, double lowest) {
  MovedStream moved(all, X);
  MemoryStream seen;
  moved.rewind();
  while (const Profile* p = moved.next()) {
    seen.profiles.emplace_back();
    seen.profiles.back().order = ProfileOrder::scattered;
    for (std::size_t k = 0; k < p->size(); ++k)
      if (p->z_mm[k] > lowest) push(seen.profiles.back(), p->r_mm[k], p->theta_rad[k], p->z_mm[k]);
  }
  return seen;
}

Eigen::Isometry3d turned(double x, double y, double z, double turn_rad, double tilt_rad) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.translate(Eigen::Vector3d(x, y, z));
  X.rotate(Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitZ()));
  X.rotate(Eigen::AngleAxisd(tilt_rad, Eigen::Vector3d::UnitY()));
  X.rotate(Eigen::AngleAxisd(kPi, Eigen::Vector3d::UnitX()));
  return X;
}

TEST(TurnedOver, FindsHowTheObjectLies) {
  for (const double lobes : {0.0, 1.5}) {
    const PieceBody body = egg(lobes);
    MemoryStream all = scattered_pieces(body, 120000, 0.02, 1), again = scattered_pieces(body, 120000, 0.02, 2);
    MemoryStream first = over(all, Eigen::Isometry3d::Identity(), 2);
    const Eigen::Isometry3d X_21 = turned(0.7, -0.4, 83, 2.1, 0.01);
    MemoryStream second = over(again, X_21, 23);
    const auto wall = fit_composite(first, {std::nullopt, 60});
    ASSERT_TRUE(wall) << wall.error().message;
    const auto pose = align_turned_over(wall->pieces.front().function, second);
    ASSERT_TRUE(pose) << pose.error().message;
    const Eigen::Isometry3d miss = pose->X_12 * X_21;
    // Where the wall is round, the turn about the axis does not show.
    EXPECT_LT(miss.translation().norm(), 0.01) << lobes;
    EXPECT_LT(std::acos(std::min(1.0, miss.linear()(2, 2))), 3e-4) << lobes;
    EXPECT_LT(lobes > 0 ? Eigen::AngleAxisd(miss.linear()).angle() : 0, 1e-3);
    EXPECT_LT(std::abs(miss.translation().z()), 5 * pose->shift_sd_mm + 1e-3);
    EXPECT_GT(pose->overlap, 0.3);
    EXPECT_NEAR(pose->scale_mm, 0.02, 0.004);
    EXPECT_EQ(pose->turn_sd_rad > 0, lobes > 0);
  }
}

// Neither scan sees all of it: together they are a closed body.
TEST(TurnedOver, BothPosesMakeOneClosedBody) {
  const PieceBody body = egg(1.5);
  MemoryStream all = scattered_pieces(body, 150000, 0.02, 3), again = scattered_pieces(body, 150000, 0.02, 4);
  MemoryStream first = over(all, Eigen::Isometry3d::Identity(), 2);
  MemoryStream second = over(again, turned(0.7, -0.4, 83, 2.1, 0.01), 23);
  const auto alone = fit_composite(first, {std::nullopt, 60});
  ASSERT_TRUE(alone) << alone.error().message;
  const auto pose = align_turned_over(alone->pieces.front().function, second);
  ASSERT_TRUE(pose) << pose.error().message;
  MovedStream moved(second, pose->X_12);
  ProfileStream* const parts[] = {&first, &moved};
  JoinedStream both(parts);
  const auto shape = choose_shape(both);
  ASSERT_TRUE(shape) << shape.error().message;
  EXPECT_EQ(shape->shape, BodyShape::composite) << shape->reason;
  const auto fit = fit_composite(both, {0, 60});
  ASSERT_TRUE(fit) << fit.error().message;
  ASSERT_EQ(fit->pieces.size(), 3u);
  EXPECT_EQ(fit->pieces.front().function.base().band_end, BaseSurface::kMeridianEnd);
  EXPECT_EQ(fit->pieces.back().function.base().band_start, 0);
  for (const RangeFit& piece : fit->pieces) EXPECT_LT(miss_piece(piece.function, body).rms, 0.01);
  EXPECT_NEAR(fit->report.geometric_mm.rms, 0.02, 0.001);
}

TEST(TurnedOver, RefusesWhatDoesNotShow) {
  const PieceBody rod = capsule(25, 0, 60, false, false);
  MemoryStream all = scattered_pieces(rod, 30000, 0.02, 5);
  const auto wall = fit_samples(all, {.form_tolerance_mm = 0.002});
  ASSERT_TRUE(wall);
  MemoryStream second = over(all, turned(0, 0, 70, 0, 0), 0);
  const auto slides = align_turned_over(wall->function, second);
  ASSERT_FALSE(slides);
  EXPECT_NE(slides.error().message.find("the same at every height"), std::string::npos) << slides.error().message;
  MemoryStream other = scattered_pieces(capsule(11, 0, 60, false, false), 30000, 0.02, 6);
  EXPECT_FALSE(align_turned_over(wall->function, other));
  MemoryStream nothing;
  EXPECT_FALSE(align_turned_over(wall->function, nothing));
}

}  // namespace
}  // namespace celadon
