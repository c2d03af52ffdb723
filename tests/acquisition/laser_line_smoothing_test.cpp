// smooth_line against closed forms: quadratics are kept exactly, jumps stay jumps.

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <cmath>
#include <random>
#include <vector>

#include "acquisition/laser_line.h"

namespace celadon {
namespace {

std::vector<LineRow> rows_of(const std::vector<double>& x) {
  std::vector<LineRow> rows(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (x[i] < 0) continue;
    rows[i] = {static_cast<float>(x[i]), 0.2f, 100.f, 3.f, RowStatus::found};
  }
  return rows;
}

std::vector<float> smooth(const std::vector<LineRow>& rows) {
  std::vector<float> smoothed(rows.size());
  smooth_line(rows, smoothed);
  return smoothed;
}

TEST(LineSmoothing, KeepsQuadraticsWhateverTheAmplitudes) {
  rc::check("quadratic", [] {
    const double a = *rc::gen::inRange(-30, 30) / 1000.0, b = *rc::gen::inRange(-10, 10) / 10.0;
    std::mt19937 random(*rc::gen::arbitrary<unsigned>());
    std::vector<double> x;
    for (int y = 0; y < 60; ++y) x.push_back(random() % 9 == 0 ? -1 : 500 + a * (y - 30) * (y - 30) + b * y);
    auto rows = rows_of(x);
    for (LineRow& row : rows) row.amplitude = 20.f + static_cast<float>(random() % 200);
    const auto smoothed = smooth(rows);
    for (std::size_t y = 0; y < x.size(); ++y) {
      if (x[y] >= 0 && smoothed[y] >= 0) RC_ASSERT(std::abs(static_cast<double>(smoothed[y]) - x[y]) < 2e-3);
      if (x[y] < 0) RC_ASSERT(smoothed[y] == -1.f);
    }
    RC_ASSERT(std::count_if(smoothed.begin(), smoothed.end(), [](float v) { return v >= 0; }) >= 40);
  });
}

TEST(LineSmoothing, AJumpStaysAJump) {
  for (const double jump : {4.0, 8.0, 40.0, -6.0}) {
    for (const double slope : {0.0, 1.0, -0.7}) {
      std::vector<double> x;
      for (int y = 0; y < 80; ++y) x.push_back(300 + slope * y + (y < 37 ? 0 : jump));
      const auto smoothed = smooth(rows_of(x));
      for (std::size_t y = 0; y < x.size(); ++y) {
        EXPECT_NEAR(static_cast<double>(smoothed[y]), x[y], 1e-3)
            << "jump " << jump << " slope " << slope << " row " << y;
      }
    }
  }
}

TEST(LineSmoothing, OutliersAndShortRunsAreLeftOut) {
  std::vector<double> x(60, 200.0);
  x[20] = 230;  // a single wrong row
  for (std::size_t y = 40; y < 60; ++y) x[y] = -1;
  for (std::size_t y = 50; y < 53; ++y) x[y] = 90;  // three rows alone
  const auto smoothed = smooth(rows_of(x));
  EXPECT_EQ(smoothed[20], -1.f);
  EXPECT_EQ(smoothed[51], -1.f);
  for (std::size_t y = 0; y < 40; ++y) {
    if (y != 20) {
      EXPECT_NEAR(smoothed[y], 200.f, 1e-3) << y;
    }
  }
}

TEST(LineSmoothing, NoRowsNoLine) {
  EXPECT_EQ(smooth(std::vector<LineRow>(30)), std::vector<float>(30, -1.f));
  EXPECT_TRUE(smooth({}).empty());
  EXPECT_EQ(smooth(rows_of({5})), std::vector<float>(1, -1.f));
  std::vector<float> room(2);
  EXPECT_THROW(smooth_line(std::vector<LineRow>(3), room), std::invalid_argument);
}

// Weights of a local quadratic over +-8 rows (Gaussian, 3.5 rows): the noise left is sqrt(sum of squared weights).
TEST(LineSmoothing, NoiseFallsAsTheWeightsSay) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal(0, 0.25);
  std::vector<double> x;
  for (int y = 0; y < 20000; ++y) x.push_back(400 + normal(random));
  const auto smoothed = smooth(rows_of(x));
  double square = 0;
  for (std::size_t y = 20; y + 20 < x.size(); ++y) square += std::pow(static_cast<double>(smoothed[y]) - 400, 2);
  double m[3] = {}, q = 0;
  for (int k = -8; k <= 8; ++k) {
    const double g = std::exp(-k * k / 24.5);
    m[0] += g;
    m[1] += g * k * k;
    m[2] += g * std::pow(k, 4);
  }
  for (int k = -8; k <= 8; ++k) {
    const double w = std::exp(-k * k / 24.5) * (m[2] - m[1] * k * k) / (m[0] * m[2] - m[1] * m[1]);
    q += w * w;
  }
  EXPECT_NEAR(std::sqrt(square / static_cast<double>(x.size() - 40)), 0.25 * std::sqrt(q), 0.01);
}

}  // namespace
}  // namespace celadon
