// Standard deviations where a surface is tied: by radii and angles that it holds, and to the piece it was joined to.

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <utility>
#include <vector>

#include "fitting/coefficient_covariance.h"
#include "fitting/constraints.h"
#include "fitting/deviation_map.h"
#include "fitting/knot_selection.h"
#include "tests/fitting/composite_tools.h"

namespace celadon {
namespace {

using namespace test;

// What many draws miss the truth by against what each of them states, over places of one kind.
class Draws {
 public:
  void add(double missed, double stated) {
    missed_ += missed * missed;
    stated_ += stated * stated;
    within_ += std::abs(missed) <= 2 * stated ? 1 : 0;
    ++count_;
  }
  double stated_over_missed() const { return std::sqrt(stated_ / missed_); }
  double missed_mm() const { return std::sqrt(missed_ / count_); }
  double within() const { return within_ / count_; }

 private:
  double missed_ = 0, stated_ = 0, within_ = 0, count_ = 0;
};

// The covariance P S P' of appendix C, P = 1 - M^-1 C' (C M^-1 C')^-1 C, with dense matrices; errors common to profiles
// too.
TEST(CoefficientCovariance, OfHeldConditionsIsThatOfTheMultipliers) {
  const GridSpecification grid{0, 120, 8, 2, 3, 3};
  MemoryStream stream =
      scan([](double, double) { return 30.0; }, {.profiles = 60, .rows = 50, .height = 120, .sigma = 0.02});
  const MomentGrid sums = accumulate(stream, grid);
  const FitLadder ladder(sums, {0, sums.z_cells()}, 3, 3, JointContinuity::curvature);
  for (const double common : {0.0, 30.0}) {
    auto member = solve_member(ladder, {1, 0}, {});
    ASSERT_TRUE(member);
    Variation variation;
    Constraints asked;
    asked.radii = {{47, 30}};
    asked.angle_end_rad = 0;
    const double variance = 4e-4;
    const Inflation inflation{2, common};
    ASSERT_TRUE(hold(asked, ladder, 0, 120, variance, inflation, *member, variation));
    const FitSpace space = member->equations->space();

    std::vector<double> v, z;
    for (const Profile& p : stream.profiles)
      for (std::size_t k = 0; k < p.size(); ++k) {
        v.push_back(grid.arcs.v_of_theta(p.theta_rad[k]));
        z.push_back(p.z_mm[k]);
      }
    const Eigen::MatrixXd b = design(space, v, z);
    Eigen::MatrixXd scatter = inflation.within * variance * b.transpose() * b;
    for (Eigen::Index k = 0; k < b.rows(); k += 50) {
      const Eigen::RowVectorXd of_profile = b.middleRows(k, 50).colwise().sum();
      scatter += common * variance / 50 * of_profile.transpose() * of_profile;
    }
    const Eigen::Index nu = space.u.free_count(), nv = space.v.free_count();
    const auto along = [&](double height) {
      Eigen::RowVectorXd values(nu);
      for (Eigen::Index i = 0; i < nu; ++i) values(i) = bspline(space.u.knots(), static_cast<int>(i), 3, height);
      return values;
    };
    const double step = 1e-3;  // of differences of third order, exact for cubics but for rounding
    Eigen::MatrixXd C = Eigen::MatrixXd::Zero(2 * nv, nu * nv);
    for (Eigen::Index j = 0; j < nv; ++j) {
      C.row(2 * j).segment(j * nu, nu) = along(47);
      C.row(2 * j + 1).segment(j * nu, nu) =
          (11 * along(120) - 18 * along(120 - step) + 9 * along(120 - 2 * step) - 2 * along(120 - 3 * step)) /
          (6 * step);
    }
    const Eigen::MatrixXd inverse = (b.transpose() * b).inverse();
    const Eigen::MatrixXd P = Eigen::MatrixXd::Identity(nu * nv, nu * nv) -
                              inverse * C.transpose() * (C * inverse * C.transpose()).inverse() * C;
    const Eigen::MatrixXd expected = P * inverse * scatter * inverse * P.transpose();
    ErrorSources sources = error_sources({sums, ladder, variance, inflation, 60, true}, std::move(*member));
    sources.knot_bias.setZero();
    const auto found = CoefficientCovariance::of(sources);
    ASSERT_TRUE(found);
    const std::vector<double> at_v{0.1, 1.7, 3.99, 2.5, 2.5}, at_z{0, 40, 110, 77, 51};
    const Eigen::MatrixXd places = design(space, at_v, at_z);
    for (std::size_t k = 0; k < at_v.size(); ++k) {
      const auto row = places.row(static_cast<Eigen::Index>(k));
      EXPECT_NEAR(found->sd_mm(at_v[k], at_z[k]) / std::sqrt(row.dot(row * expected)), 1, 3e-3)
          << "common " << common << ", z = " << at_z[k];
    }
    EXPECT_LT(found->sd_mm(0.7, 47), 1e-2 * found->sd_mm(0.7, 80));
  }
}

// Bodies that are round at one height, another one in each scan, where their radius is known. (One body would not do:
// beside one height what the knots cannot follow is the same in all of its scans.)
TEST(StandardDeviation, NearAHeldRadiusAgreesWithRepeatedScans_held) {
  Draws near, far;
  double held = 0;
  for (unsigned seed = 1; seed <= 30; ++seed) {
    const double height = 29 + 2.0 * seed;
    const Shape shape = [&](double t, double z) {
      const double lobes = 2 * std::cos(2 * t) + std::cos(5 * t);
      return 30 + 4 * (std::sin(2 * kPi * z / 120) - std::sin(2 * kPi * height / 120)) +
             lobes * std::sin(2 * kPi * (z - height) / 120);
    };
    RangeFitOptions options;
    options.constraints.radii = {{height, 30}};
    MemoryStream stream = scan(shape, {.profiles = 150, .rows = 150, .height = 120, .sigma = 0.02, .seed = seed});
    const auto found = test::fit(stream, options);
    ASSERT_TRUE(found) << found.error().message;
    ASSERT_TRUE(found->deviation);
    for (int j = 0; j < 31; ++j) {
      const double theta = 2 * kPi * (j + 0.41) / 31, v = found->function.base().arcs.v_of_theta(theta);
      const auto add = [&](double z, Draws& draws) {
        draws.add(found->function(theta, z) - shape(theta, z), (*found->deviation)(v, z));
      };
      for (const double beside : {-5, -3, -1, 1, 3, 5}) add(height + beside, near);
      for (int i = 0; i < 24; ++i)
        if (const double z = 120 * (i + 0.5) / 24; std::abs(z - height) > 15) add(z, far);
      held = std::max(held, (*found->deviation)(v, height));
    }
  }
  EXPECT_NEAR(near.stated_over_missed(), 1, 0.1);
  EXPECT_NEAR(near.within(), 0.95, 0.02);
  EXPECT_NEAR(far.stated_over_missed(), 1, 0.1);
  EXPECT_NEAR(far.within(), 0.95, 0.02);
  EXPECT_LT(held, 0.01 * far.missed_mm());
}

// The same where the slope at a rim is known.
TEST(StandardDeviation, NearAHeldAngleAgreesWithRepeatedScans_held) {
  Draws near;
  for (unsigned seed = 1; seed <= 24; ++seed) {
    const double phase = 2 * kPi * seed / 24;
    const Shape shape = [&](double t, double z) {
      const double lobes = 2 * std::cos(2 * t) + std::cos(5 * t);
      return 30 + 4 * std::sin(2 * kPi * z / 120 + phase) + lobes * (1 + std::cos(2 * kPi * z / 120)) / 2;
    };
    RangeFitOptions options;
    options.constraints.angle_end_rad = std::atan(4 * 2 * kPi / 120 * std::cos(phase));
    MemoryStream stream = scan(shape, {.profiles = 150, .rows = 150, .height = 120, .sigma = 0.02, .seed = seed});
    const auto found = test::fit(stream, options);
    ASSERT_TRUE(found) << found.error().message;
    ASSERT_TRUE(found->deviation);
    for (int j = 0; j < 31; ++j)
      for (const double z : {111, 113, 115, 117, 119, 120}) {
        const double theta = 2 * kPi * (j + 0.41) / 31, v = found->function.base().arcs.v_of_theta(theta);
        near.add(found->function(theta, z) - shape(theta, z), (*found->deviation)(v, z));
      }
  }
  EXPECT_NEAR(near.stated_over_missed(), 1, 0.1);
  EXPECT_NEAR(near.within(), 0.95, 0.02);
}

// Joined pieces beside their joint: repeated scans of a knob.
TEST(StandardDeviation, NearAJointAgreesWithRepeatedScans) {
  const PieceBody body = Knob{}.body();
  Draws wall_near, wall_far, head_near, head_far;
  for (unsigned seed = 1; seed <= 24; ++seed) {
    MemoryStream samples = scattered_pieces(body, 40000, 0.02, seed);
    const auto fit = fit_composite(samples, {std::nullopt, 60});
    ASSERT_TRUE(fit) << fit.error().message;
    for (const RangeFit& piece : fit->pieces) {
      ASSERT_TRUE(piece.deviation);
      EXPECT_EQ(piece.report.sd_max_mm, piece.deviation->largest());
      const bool head = piece.function.base().spherical();
      for (int i = 0; i < 30; ++i)
        for (int j = 0; j < 31; ++j) {
          const double theta = 2 * kPi * (j + 0.41) / 31, share = (i + 0.5) / 30;
          const double phi = kPi / 2 * (0.1 + 0.9 * share), z = 60 - 40 * share;
          const double along = head ? BaseSurface::meridian().v_of_theta(phi) : z;
          const double truth = head ? body.above(phi, theta) : body.wall(theta, z);
          const double stated = (*piece.deviation)(piece.function.base().arcs.v_of_theta(theta), along);
          const bool near = head ? share > 0.8 : share < 0.2;
          (head ? (near ? head_near : head_far) : (near ? wall_near : wall_far))
              .add(piece.function(theta, along) - truth, stated);
        }
    }
  }
  for (const auto& [name, draws] : {std::pair{"wall, near", &wall_near}, std::pair{"wall", &wall_far},
                                    std::pair{"head, near", &head_near}, std::pair{"head", &head_far}}) {
    EXPECT_NEAR(draws->stated_over_missed(), 1, 0.1) << name;
    EXPECT_NEAR(draws->within(), 0.95, 0.02) << name;
  }
}

// A cylinder and a half ball get one radius, and know it as well as both together.
TEST(StandardDeviation, OfACapsuleIsThatOfItsOneRadius) {
  const PieceBody body = capsule(25, 10, 90, false, true);
  Draws radius;
  for (unsigned seed = 1; seed <= 120; ++seed) {
    MemoryStream samples = scattered_pieces(body, 4000, 0.02, seed);
    const auto fit = fit_composite(samples, {std::nullopt, 90}, {.form_tolerance_mm = 0.002});
    ASSERT_TRUE(fit) << fit.error().message;
    for (const RangeFit& piece : fit->pieces)
      radius.add(piece.function.coefficients()(0, 0) - 25, piece.deviation->largest());
  }
  EXPECT_NEAR(radius.stated_over_missed(), 1, 0.15);
}

}  // namespace
}  // namespace celadon
