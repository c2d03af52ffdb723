// Frames of clouds whose true axis and centre are known, in any place, with noise, gaps and strays.
#include "fitting/local_frame.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/fitting/frame_tools.h"

namespace celadon {
namespace {

constexpr double kPi = std::numbers::pi;

LocalFrame frame_of(const Eigen::Matrix3Xd& points) {
  auto frame = local_frame(points);
  if (!frame) throw std::runtime_error(frame.error().message);
  const Eigen::Matrix3d R = frame->X_SL.linear();
  EXPECT_LT((R.transpose() * R - Eigen::Matrix3d::Identity()).norm(), 1e-13);
  EXPECT_GT(R.determinant(), 0);
  EXPECT_GE(R(2, 2), 0);
  return *frame;
}

double vase(double z) {
  return 28 + 6 * std::sin(z / 14) + z * z / 300;
}

struct Case {
  const char* name;
  FrameShape shape;
  Eigen::Matrix3Xd (*points)(test::Random&);
};
const Case kCases[] = {
    {"sphere, 60 degree cap", FrameShape::sphere,
     [](test::Random& r) { return test::sphere_cap(r, 3000, 30, kPi / 3); }},
    {"sphere", FrameShape::sphere, [](test::Random& r) { return test::sphere_cap(r, 3000, 30, kPi); }},
    {"cylinder", FrameShape::cylinder, [](test::Random& r) { return test::cylinder_sector(r, 3000, 30, 30, 2 * kPi); }},
    {"cylinder, 90 degrees", FrameShape::cylinder,
     [](test::Random& r) { return test::cylinder_sector(r, 3000, 30, 30, kPi / 2); }},
    {"cone", FrameShape::cone,
     [](test::Random& r) {
       return test::around_axis(
           r, 3000, [](double z) { return 25 + 0.4 * z; }, -30, 30, 2 * kPi);
     }},
    {"cone, 120 degrees", FrameShape::cone,
     [](test::Random& r) {
       return test::around_axis(
           r, 3000, [](double z) { return 25 + 0.4 * z; }, -30, 30, 2 * kPi / 3);
     }},
    {"vase", FrameShape::revolution,
     [](test::Random& r) { return test::around_axis(r, 3000, vase, -50, 50, 2 * kPi); }},
    {"vase, 120 degrees", FrameShape::revolution,
     [](test::Random& r) { return test::around_axis(r, 3000, vase, -50, 50, 2 * kPi / 3); }},
    {"squeezed barrel", FrameShape::elliptic,
     [](test::Random& r) {
       return test::around_axis(
           r, 4000, [](double z) { return 30 - 8 * z * z / 3600; }, -60, 60, 2 * kPi, 0.75);
     }},
};

// Errors over the trials of a case: axis in degrees, origin across it (from the centre for spheres) in millimetres.
struct Errors {
  std::vector<double> axis_deg, origin_mm;
  int right_shape = 0;
};
Errors run(const Case& c, std::uint64_t seed, int trials, double sigma, double strays) {
  test::Random random(seed);
  Errors errors;
  for (int trial = 0; trial < trials; ++trial) {
    Eigen::Matrix3Xd points = c.points(random);
    test::add_noise(random, points, sigma);
    test::add_strays(random, points, strays);
    const Eigen::Isometry3d X = test::random_motion(random, 200);
    const LocalFrame frame = frame_of(test::moved(X, points));
    const bool ball = c.shape == FrameShape::sphere;
    errors.axis_deg.push_back(ball ? 0 : test::angle_deg(frame.X_SL.linear().col(2), X.linear().col(2)));
    errors.origin_mm.push_back(ball ? (frame.X_SL.translation() - X.translation()).norm()
                                    : test::off_axis(X, frame.X_SL.translation()));
    errors.right_shape += frame.shape == c.shape;
  }
  std::sort(errors.axis_deg.begin(), errors.axis_deg.end());
  std::sort(errors.origin_mm.begin(), errors.origin_mm.end());
  return errors;
}

TEST(LocalFrame, OfCleanShapesIsExact) {
  for (const Case& c : kCases) {
    const bool exact = c.shape != FrameShape::revolution && c.shape != FrameShape::elliptic;
    const Errors errors = run(c, 1, 3, 0, 0);
    if (exact) {
      EXPECT_EQ(errors.right_shape, 3) << c.name;
    }
    // Meridians that no polynomial of degree 8 follows are still round.
    EXPECT_LT(errors.axis_deg.back(), exact ? 1e-6 : 0.02) << c.name;
    EXPECT_LT(errors.origin_mm.back(), exact ? 1e-6 : 0.02) << c.name;
  }
}

TEST(LocalFrame, OfNoisyShapes) {
  for (const Case& c : kCases) {
    const Errors errors = run(c, 2, 6, 0.3, 0);
    EXPECT_EQ(errors.right_shape, 6) << c.name;
    EXPECT_LT(errors.axis_deg.back(), 0.5) << c.name;
    EXPECT_LT(errors.origin_mm.back(), 0.4) << c.name;
  }
}

TEST(LocalFrame, StraysDoNotMoveIt) {
  for (const Case& c : kCases) {
    const Errors errors = run(c, 3, 6, 0.1, 0.1);
    EXPECT_EQ(errors.right_shape, 6) << c.name;
    EXPECT_LT(errors.axis_deg.back(), 0.25) << c.name;
    EXPECT_LT(errors.origin_mm.back(), 0.2) << c.name;
  }
}

// A tenth of the radius is three standard deviations: the end of the thesis's figure 4.3.
TEST(LocalFrame, AtTheStrongestNoiseOfFigure_4_3) {
  for (const Case& c : kCases) {
    const Errors errors = run(c, 4, 6, 1, 0);
    EXPECT_EQ(errors.right_shape, 6) << c.name;
    EXPECT_LT(errors.axis_deg.back(), 1) << c.name;
    EXPECT_LT(errors.origin_mm.back(), 0.6) << c.name;
  }
}

TEST(LocalFrame, MovesAndScalesWithThePoints) {
  test::Random random(5);
  for (const Case& c : kCases) {
    for (int trial = 0; trial < 2; ++trial) {
      Eigen::Matrix3Xd points = c.points(random);
      test::add_noise(random, points, 0.1);
      const Eigen::Isometry3d X = test::random_motion(random, 100);
      const double scale = std::pow(10.0, test::uniform(random, -2, 2));
      const LocalFrame here = frame_of(points), there = frame_of(scale * test::moved(X, points));
      EXPECT_EQ(here.shape, there.shape) << c.name;
      EXPECT_LT((X * here.X_SL.translation() - there.X_SL.translation() / scale).norm(), 1e-4) << c.name;
      if (here.shape != FrameShape::sphere) {
        EXPECT_LT(test::angle_deg(X.linear() * here.X_SL.linear().col(2), there.X_SL.linear().col(2)), 1e-4) << c.name;
      }
      EXPECT_NEAR(there.scale_mm / (scale * here.scale_mm), 1, 1e-3) << c.name;
      EXPECT_NEAR(there.noise_mm / (scale * here.noise_mm), 1, 1e-6) << c.name;
    }
  }
}

// Errors over promised standard deviations: a mean square of 1, of two components each.
TEST(LocalFrame, KnowsHowSureItIs) {
  for (const int n : {0, 2, 3, 5, 6}) {
    const Case& c = kCases[n];
    test::Random random(12);
    double axis = 0, origin = 0;
    const int trials = 40;
    for (int trial = 0; trial < trials; ++trial) {
      Eigen::Matrix3Xd points = c.points(random).leftCols(1000);
      test::add_noise(random, points, 0.2);
      const LocalFrame frame = frame_of(points);
      const Eigen::Vector3d o = frame.X_SL.translation();
      if (c.shape == FrameShape::sphere) {
        EXPECT_EQ(frame.axis_sd_rad, std::numeric_limits<double>::infinity());
        origin += std::pow(o.norm() / frame.origin_sd_mm, 2) / trials;
        continue;
      }
      axis += std::pow(
                  test::angle_deg(frame.X_SL.linear().col(2), Eigen::Vector3d::UnitZ()) * kPi / 180 / frame.axis_sd_rad,
                  2) /
              trials;
      origin += std::pow(o.head<2>().norm() / frame.origin_sd_mm, 2) / trials;
    }
    // One direction at least is as unsure as promised, no more than two (three) are.
    const double most = c.shape == FrameShape::sphere ? 3 : 2;
    if (c.shape != FrameShape::sphere) {
      EXPECT_GT(axis, 0.5) << c.name;
      EXPECT_LT(axis, most * 1.5) << c.name;
    }
    EXPECT_GT(origin, 0.5) << c.name;
    EXPECT_LT(origin, most * 1.5) << c.name;
  }
}

// Thesis 4.3: principal components do for a whole shape, not for a part.
TEST(LocalFrame, IsRightWherePrincipalComponentsFail) {
  test::Random random(13);
  const auto principal = [](const Eigen::Matrix3Xd& points) {
    const Eigen::Vector3d mean = points.rowwise().mean();
    const Eigen::Matrix3Xd y = points.colwise() - mean;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(y * y.transpose());
    double best = 90;
    for (int j = 0; j < 3; ++j)
      best = std::min(best, test::angle_deg(solver.eigenvectors().col(j), Eigen::Vector3d::UnitZ()));
    return std::pair(best, mean.head<2>().norm());
  };
  const auto funnel = [](double z) { return 20 + z * z / 60; };
  Eigen::Matrix3Xd whole = test::around_axis(random, 3000, funnel, 0, 40, 2 * kPi),
                   part = test::around_axis(random, 3000, funnel, 0, 40, kPi / 2);
  test::add_noise(random, whole, 0.1);
  test::add_noise(random, part, 0.1);
  EXPECT_LT(principal(whole).first, 3);
  EXPECT_GT(principal(part).first, 15);
  EXPECT_GT(principal(part).second, 15);
  for (const auto& points : {whole, part}) {
    const LocalFrame frame = frame_of(points);
    EXPECT_LT(test::angle_deg(frame.X_SL.linear().col(2), Eigen::Vector3d::UnitZ()), 0.2);
    EXPECT_LT(frame.X_SL.translation().head<2>().norm(), 0.1);
  }
}

// An ellipsoid's centre is the origin; a cylinder's is beside the points' mean; i is the short axis of the section.
TEST(LocalFrame, OriginAndSectionFollowTheShape) {
  test::Random random(14);
  Eigen::Matrix3Xd egg = Eigen::Vector3d(20, 16, 40).asDiagonal() * test::sphere_cap(random, 3000, 1, 2);
  test::add_noise(random, egg, 0.05);
  const LocalFrame e = frame_of(egg);
  EXPECT_EQ(e.shape, FrameShape::elliptic);
  EXPECT_LT(e.X_SL.translation().norm(), 0.1);
  EXPECT_LT(test::angle_deg(e.X_SL.linear().col(0), Eigen::Vector3d::UnitY()), 1);
  EXPECT_EQ(e.quadric, QuadricType::real_ellipsoid);

  Eigen::Matrix3Xd tube = test::around_axis(
      random, 3000, [](double) { return 15.0; }, 10, 60, 3);
  const double mean = tube.row(2).mean();
  EXPECT_NEAR(frame_of(tube).X_SL.translation().z(), mean, 1e-6);
}

TEST(LocalFrame, TellsWhyThereIsNone) {
  test::Random random(15);
  const Eigen::Matrix3Xd good = test::cylinder_sector(random, 300, 20, 30, 2 * kPi);
  const auto message = [](const Eigen::Matrix3Xd& points) {
    const auto frame = local_frame(points);
    return frame ? "a " + std::string(to_string(frame->shape)) : frame.error().message;
  };
  const auto contains = [](const char* text) { return testing::HasSubstr(text); };
  EXPECT_THAT(message(good), contains("cylinder"));
  EXPECT_THAT(message(good.leftCols(20)), contains("20 points"));
  EXPECT_THAT(message(Eigen::Matrix3Xd(3, 0)), contains("0 points"));
  Eigen::Matrix3Xd points = good;
  points(1, 17) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(message(points), contains("point 17 has NaN"));
  const Eigen::Isometry3d X = test::random_motion(random, 1000);
  points = good;
  points.row(2).setConstant(4);
  EXPECT_THAT(message(test::moved(X, points)), contains("plane"));
  points.row(1) = 2 * points.row(0);
  EXPECT_THAT(message(test::moved(X, points)), contains("line"));
  points.colwise() = Eigen::Vector3d(100, 200, 300);
  EXPECT_THAT(message(points), contains("coincide"));
  for (int k = 0; k < 300; ++k) {  // Viviani's curve: a sphere and a cylinder meet in it
    const double t = 0.02 * k;
    points.col(k) << 20 * (1 + std::cos(t)), 20 * std::sin(t), 40 * std::sin(t / 2);
  }
  EXPECT_THAT(message(test::moved(X, points)), contains("curve"));
  // Too little of a circle: an answer with a warning.
  Eigen::Matrix3Xd strip = test::cylinder_sector(random, 600, 50, 4, 0.12);
  test::add_noise(random, strip, 0.1);
  const auto frame = local_frame(strip);
  EXPECT_TRUE(!frame || !frame->warnings.empty());
}

// No polynomial follows the meridian of a stepped shaft; it is round all the same.
TEST(LocalFrame, SteppedShaftsAreRound) {
  std::mt19937_64 random(4);
  std::uniform_real_distribution<double> share(0, 1);
  std::normal_distribution<double> normal(0, 0.02);
  for (int trial = 0; trial < 4; ++trial) {
    Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
    X.linear() = Eigen::Quaterniond(share(random), share(random), share(random), 0.5).normalized().toRotationMatrix();
    X.translation() << 10, -20, 30;
    Eigen::Matrix3Xd points(3, 20000);
    for (Eigen::Index n = 0; n < points.cols(); ++n) {
      const double t = 2 * kPi * share(random), z = 100 * share(random);
      const double r = (z < 20 ? 15 : z < 50 ? 25 : z < 52 ? 22 : z < 80 ? 25 : 18 - (z - 80) * 0.2) + normal(random);
      points.col(n) = X * Eigen::Vector3d(r * std::cos(t), r * std::sin(t), z);
    }
    const auto frame = local_frame(points);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_GT(frame->inliers, 0.9);
    EXPECT_NEAR(std::abs(frame->X_SL.linear().col(2).dot(X.linear().col(2))), 1, 1e-6);
  }
}

}  // namespace
}  // namespace celadon
