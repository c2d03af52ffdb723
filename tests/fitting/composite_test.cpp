// Bodies with heads: exactness, accuracy, how pieces meet, refusals.

#include <gtest/gtest.h>

#include <random>

#include "tests/fitting/composite_tools.h"

namespace celadon {
namespace {

using namespace test;

constexpr double kDegree = kPi / 180;

// Largest distance of points and angle of normals on the rim, from evaluated points of the exact surfaces alone.
Meeting rim_of_surfaces(const CompositeFit& fit, std::size_t body, std::size_t head, bool top) {
  const NurbsSurface &b = fit.pieces[body].surface, &h = fit.pieces[head].surface;
  Meeting largest;
  for (int k = 0; k < 1000; ++k) {
    const double v = 4 * (k + 0.5) / 1000;
    const auto on_body = b.derivatives(top ? 1 : 0, v), on_head = h.derivatives(1, v);
    const Eigen::Vector3d n = on_body.S_v.cross(on_body.S_u).normalized(),
                          m = on_head.S_u.cross(on_head.S_v).normalized();
    largest.gap_mm = std::max(largest.gap_mm, (on_body.S - on_head.S).norm());
    largest.angle_rad = std::max(largest.angle_rad, std::atan2(n.cross(m).norm(), n.dot(m)));
  }
  return largest;
}

TEST(CompositeFit, ACapsuleComesBackExact) {
  const PieceBody body = capsule(25, 10, 90, true, true);
  MemoryStream samples = scattered_pieces(body, 30000, 0, 1);
  const auto fit = fit_composite(samples, {10, 90});
  ASSERT_TRUE(fit) << fit.error().message;
  ASSERT_EQ(fit->pieces.size(), 3u);
  for (const RangeFit& piece : fit->pieces) {
    EXPECT_EQ(piece.report.model, SurfaceModel::cylinder);
    EXPECT_LT(miss_piece(piece.function, body).max, 1e-9);
    EXPECT_EQ(piece.surface.degree_v, 2);
    EXPECT_EQ(piece.surface.degree_u, piece.function.base().spherical() ? 2 : 1);
  }
  for (const CompositeJoint& joint : fit->joints) {
    EXPECT_LT(joint.after.gap_mm, 1e-12);
    EXPECT_LT(joint.after.angle_rad, 1e-12);
  }
  EXPECT_EQ(fit->report.points, 30000u);
  EXPECT_EQ(fit->report.rejected, 0u);
}

TEST(CompositeFit, UnderNoiseACapsuleKeepsOneRadius) {
  const PieceBody body = capsule(25, 10, 90, false, true);
  MemoryStream samples = scattered_pieces(body, 60000, 0.02, 2);
  const auto fit = fit_composite(samples, {std::nullopt, 90}, {.form_tolerance_mm = 0.002});
  ASSERT_TRUE(fit) << fit.error().message;
  ASSERT_EQ(fit->pieces.size(), 2u);
  EXPECT_EQ(fit->pieces[0].report.model, SurfaceModel::cylinder);
  EXPECT_EQ(fit->pieces[1].report.model, SurfaceModel::cylinder);
  EXPECT_EQ(fit->pieces[0].function.coefficients()(0, 0), fit->pieces[1].function.coefficients()(0, 0));
  EXPECT_NEAR(fit->pieces[0].function.coefficients()(0, 0), 25, 5e-4);
  EXPECT_NEAR(fit->report.geometric_mm.rms, 0.02, 5e-4);
  EXPECT_NEAR(fit->report.noise_mm, 0.02, 5e-4);
}

TEST(CompositeFit, PiecesOfAKnobMeetInOneRimAndOneTangentPlane) {
  const PieceBody body = Knob{}.body();
  MemoryStream samples = scattered_pieces(body, 200000, 0.02, 3);
  const auto fit = fit_composite(samples, {std::nullopt, 60});
  ASSERT_TRUE(fit) << fit.error().message;
  ASSERT_EQ(fit->joints.size(), 1u);
  const Meeting rim = rim_of_surfaces(*fit, 0, 1, true);
  EXPECT_LT(rim.gap_mm, 1e-10);
  EXPECT_LT(rim.angle_rad, 0.05 * kDegree);
  EXPECT_NEAR(rim.angle_rad, fit->joints[0].after.angle_rad, 1e-5);
  // Each piece alone met the other within the noise already, and stays as near to the truth.
  EXPECT_LT(fit->joints[0].before.gap_mm, 0.02);
  EXPECT_GT(fit->joints[0].before.gap_mm, 1e-6);
  for (const RangeFit& piece : fit->pieces) {
    const Miss miss = miss_piece(piece.function, body);
    EXPECT_LT(miss.rms, 0.004) << piece.function.base().spherical();
    EXPECT_LT(miss.max, 0.03) << piece.function.base().spherical();
  }
  EXPECT_TRUE(fit->report.warnings.empty()) << fit->report.warnings.front();
}

TEST(CompositeFit, WithoutNoiseErrorsAreThoseOfTheSpaces) {
  const PieceBody body = Knob{}.body();
  MemoryStream samples = scattered_pieces(body, 200000, 0, 4);
  const auto fit = fit_composite(samples, {std::nullopt, 60});
  ASSERT_TRUE(fit) << fit.error().message;
  for (const RangeFit& piece : fit->pieces) EXPECT_LT(miss_piece(piece.function, body).max, 2e-4);
  EXPECT_LT(rim_of_surfaces(*fit, 0, 1, true).angle_rad, 0.05 * kDegree);
}

TEST(CompositeFit, RandomKnobsMeet) {
  std::mt19937_64 random(11);
  const auto within = [&](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  for (unsigned k = 0; k < 15; ++k) {
    Knob knob;
    knob.R0 = within(10, 40);
    knob.a = within(0, 0.12) * knob.R0;
    knob.slope = within(-0.35, 0.35);
    knob.bend = within(-0.1, 0.05) / knob.R0;
    knob.flat = within(-0.1, 0.3);
    knob.low = -1.5 * knob.R0, knob.high = 0;
    SCOPED_TRACE(::testing::Message() << "R0 " << knob.R0 << ", a " << knob.a << ", slope " << knob.slope << ", bend "
                                      << knob.bend << ", flat " << knob.flat);
    const PieceBody body = knob.body();
    MemoryStream samples = scattered_pieces(body, 12000, 0.01, k);
    const auto fit = fit_composite(samples, {std::nullopt, 0});
    ASSERT_TRUE(fit) << fit.error().message;
    const Meeting rim = rim_of_surfaces(*fit, 0, 1, true);
    EXPECT_LT(rim.gap_mm, 1e-9);
    EXPECT_LT(rim.angle_rad, 0.05 * kDegree);
    for (const RangeFit& piece : fit->pieces) EXPECT_LT(miss_piece(piece.function, body).rms, 0.01);
  }
}

TEST(CompositeFit, TheSimplerPieceStaysWhatItIs) {
  // An exact cylinder under a dome with lobes: the dome gives way.
  PieceBody body = capsule(25, 0, 60, false, true);
  body.above = [](double phi, double theta) {
    const double s = std::sin(phi), c = std::cos(phi);
    return 25 - 4 * c * c + 3 * s * s * c * c * std::cos(2 * theta);
  };
  MemoryStream samples = scattered_pieces(body, 60000, 0.01, 5);
  const auto fit = fit_composite(samples, {std::nullopt, 60}, {.form_tolerance_mm = 0.001});
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_EQ(fit->pieces[0].report.model, SurfaceModel::cylinder);
  EXPECT_EQ(fit->pieces[1].report.model, SurfaceModel::general);
  const Meeting rim = rim_of_surfaces(*fit, 0, 1, true);
  EXPECT_LT(rim.gap_mm, 1e-10);
  EXPECT_LT(rim.angle_rad, 1e-9);
  EXPECT_LT(miss_piece(fit->pieces[1].function, body).rms, 0.003);
}

TEST(CompositeFit, AnEdgeAtTheSplitIsTold) {
  PieceBody body = capsule(25, 0, 60, false, true);
  body.above = [](double phi, double) { return 25 / (std::sin(phi) + std::cos(phi)); };  // a cone of 45 degrees
  MemoryStream samples = scattered_pieces(body, 40000, 0.01, 6);
  const auto fit = fit_composite(samples, {std::nullopt, 60});
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_NEAR(fit->joints[0].before.angle_rad, 45 * kDegree, 5 * kDegree);
  ASSERT_FALSE(fit->report.warnings.empty());
  EXPECT_NE(fit->report.warnings.back().find("rounded off"), std::string::npos);
}

TEST(CompositeFit, RefusesWithTheRemedy) {
  MemoryStream samples = scattered_pieces(capsule(25, 10, 90, false, true), 20000, 0.01, 7);
  const auto refused = [&](const CompositeSplit& split, const RangeFitOptions& options, const char* words) {
    const auto fit = fit_composite(samples, split, options);
    ASSERT_FALSE(fit);
    EXPECT_NE(fit.error().message.find(words), std::string::npos) << fit.error().message;
  };
  refused({}, {}, "needs a height");
  refused({90, 10}, {}, "not below");
  refused({std::nullopt, 90}, {.degree_u = 1}, "degree 1");
  refused({std::nullopt, 90}, {.arcs = BaseArcs::open(0, 2)}, "closed around");
  refused({std::nullopt, 200}, {}, "short of the split at 200 mm");
  refused({std::nullopt, -5}, {}, "body");
}

TEST(PieceJoin, RefusesPiecesThatDoNotBelongTogether) {
  const PieceBody body = capsule(25, 10, 90, false, true);
  MemoryStream samples = scattered_pieces(body, 20000, 0, 8);
  auto fit = fit_composite(samples, {std::nullopt, 90});
  ASSERT_TRUE(fit);
  const RangeFunction &wall = fit->pieces[0].function, &head = fit->pieces[1].function;
  EXPECT_NO_THROW(join(wall, head, JointContinuity::curvature));
  EXPECT_THROW(join(head, wall, JointContinuity::curvature), std::invalid_argument);
  EXPECT_THROW(join(wall.clipped(10, 80), head, JointContinuity::curvature), std::invalid_argument);
  EXPECT_THROW(join(wall, head.clipped(0, 0.9), JointContinuity::curvature), std::invalid_argument);
}

}  // namespace
}  // namespace celadon
