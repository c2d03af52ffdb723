// Matching of drawn pictures whose disparity is known in closed form.

#include "acquisition/stereo/window_match.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

namespace celadon {
namespace {

constexpr int kWide = 420, kHigh = 260;
constexpr DisparityRange kRange{-10, 40};
constexpr PictureNoise kQuiet{1. / 12, 0};

/// A band-limited random function of the plane.
class Waves {
 public:
  explicit Waves(unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> angle(0, 2 * std::numbers::pi), length(7, 40);
    for (int i = 0; i < 60; ++i) {
      const double k = 2 * std::numbers::pi / length(random), a = angle(random);
      waves_.push_back({k * std::cos(a), k * std::sin(a), angle(random)});
    }
  }
  double operator()(double x, double y) const {
    double sum = 0;
    for (const Wave& w : waves_) sum += std::cos(w.kx * x + w.ky * y + w.phase);
    return 100 + 5 * sum;
  }

 private:
  struct Wave {
    double kx, ky, phase;
  };
  std::vector<Wave> waves_;
};

using Field = std::function<double(double x, double y)>;

LevelPicture drawn(const Field& level, double noise = 0, unsigned seed = 1) {
  LevelPicture out{kWide, kHigh, {}};
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  for (int y = 0; y < kHigh; ++y) {
    for (int x = 0; x < kWide; ++x) out.level.push_back(static_cast<float>(level(x, y) + noise * normal(random)));
  }
  return out;
}

struct Matched {
  std::vector<WindowMatch> matches;
  MatchCounts counts;
};

Matched match_all(const LevelPicture& first, const LevelPicture& second, const PictureNoise& noise = kQuiet,
                  const DisparityRange& range = kRange) {
  const WindowMatcher matcher(first, second, noise, range);
  Matched out;
  for (int band = 0; band < matcher.bands(); ++band) out.counts += matcher.match(band, out.matches);
  const MatchCounts& c = out.counts;
  EXPECT_EQ(c.windows, c.found + c.unknown + c.plain + c.ambiguous + c.inconsistent + c.misfit);
  EXPECT_EQ(static_cast<std::size_t>(c.found), out.matches.size());
  return out;
}

TEST(WindowMatch, FindsADisparityThatBendsAndSlants) {
  const Waves texture(3);
  // First picture: what the second shows at x - D(x, y).
  const std::vector<Field> fields = {
      [](double, double) { return 7.3; },
      [](double x, double y) { return 5 + 0.05 * (x - 200) + 0.02 * (y - 100); },
      [](double x, double y) { return 12 + 4e-4 * (x - 200) * (x - 200) - 2e-4 * (y - 130) * (y - 130); },
  };
  for (const Field& D : fields) {
    const auto found = match_all(drawn([&](double x, double y) { return texture(x - D(x, y), y); }), drawn(texture));
    EXPECT_GT(found.counts.found, 0.5 * found.counts.windows);
    for (const WindowMatch& m : found.matches) {
      EXPECT_NEAR(m.disparity_px, D(m.x_px, m.y_px), 0.05);  // what smoothing makes of places that slant
      EXPECT_NEAR(m.gain, 1, 0.05);
    }
  }
}

TEST(WindowMatch, GainAndOffsetChangeNothing) {
  const Waves texture(4);
  const auto D = [](double x, double y) { return 8.4 + 0.03 * (x - 200) + 0.01 * y; };
  const LevelPicture second = drawn(texture);
  const auto plain = match_all(drawn([&](double x, double y) { return texture(x - D(x, y), y); }), second);
  for (const auto& [gain, offset] : {std::pair(0.6, 40.), std::pair(1.5, -30.), std::pair(1., 60.)}) {
    const auto changed = match_all(
        drawn([&, g = gain, o = offset](double x, double y) { return o + g * texture(x - D(x, y), y); }), second);
    ASSERT_EQ(changed.matches.size(), plain.matches.size()) << gain << " " << offset;
    for (std::size_t i = 0; i < plain.matches.size(); ++i) {
      EXPECT_NEAR(changed.matches[i].disparity_px, plain.matches[i].disparity_px, 1e-3);
      EXPECT_NEAR(changed.matches[i].gain, gain * plain.matches[i].gain, 0.01 * gain);
      EXPECT_NEAR(changed.matches[i].offset, offset + gain * plain.matches[i].offset, 1);
    }
  }
}

TEST(WindowMatch, StatedUncertaintyIsTheScatter) {
  const double noise = 3;
  double squares = 0, sum = 0;
  int count = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const Waves texture(seed);
    const auto D = [](double x, double) { return 9.37 + 0.04 * (x - 200); };
    const auto found =
        match_all(drawn([&](double x, double y) { return 8 + 0.8 * texture(x - D(x, y), y); }, noise, seed),
                  drawn(texture, noise, 100 + seed), {noise * noise, 0});
    for (const WindowMatch& m : found.matches) {
      const double off = (m.disparity_px - D(m.x_px, m.y_px)) / m.sigma_px;
      squares += off * off;
      sum += off;
      ++count;
    }
  }
  ASSERT_GT(count, 3000);
  // Windows overlap by less than a third; so many count as a half of them.
  EXPECT_NEAR(squares / count, 1, 0.15);
  EXPECT_LT(std::abs(sum / count), 0.1);
}

TEST(WindowMatch, PlainSurfacesGiveNothing) {
  const double noise = 2;
  const auto flat = [](double x, double y) { return 100 + 0.05 * x + 0.02 * y; };
  const auto found = match_all(drawn(flat, noise, 1), drawn(flat, noise, 2), {noise * noise, 0});
  EXPECT_EQ(found.counts.found, 0);
  EXPECT_EQ(found.counts.plain + found.counts.unknown, found.counts.windows);  // unknown: at the border
}

TEST(WindowMatch, TextureAlongTheRowsOnlyIsPlain) {
  const auto stripes = [](double, double y) { return 100 + 40 * std::cos(y / 3); };
  const auto found = match_all(drawn(stripes, 1, 1), drawn(stripes, 1, 2), {1, 0});
  EXPECT_EQ(found.counts.plain + found.counts.unknown, found.counts.windows);  // unknown: at the border
}

TEST(WindowMatch, RepeatingTextureIsAmbiguous) {
  const auto stripes = [](double x, double y) { return 100 + 40 * std::cos(x * 2 * std::numbers::pi / 17 + y / 50); };
  const auto found =
      match_all(drawn([&](double x, double y) { return stripes(x - 6, y); }, 1, 1), drawn(stripes, 1, 2), {1, 0});
  // Near the border there is no room for the next stripe.
  EXPECT_LT(found.counts.found, 0.05 * found.counts.windows);
  EXPECT_GT(found.counts.ambiguous, 0.6 * found.counts.windows);
}

TEST(WindowMatch, NothingIsMatchedAcrossAnEdge) {
  const Waves near(5), far(6);
  // Something at disparity 25 left of the middle before a background at 5.
  const auto first = [&](double x, double y) { return x < 210 ? near(x - 25, y) : far(x - 5, y); };
  const auto second = [&](double x, double y) { return x < 210 - 25 ? near(x, y) : far(x, y); };
  const auto found = match_all(drawn(first, 1, 1), drawn(second, 1, 2), {1, 0});
  int left = 0, right = 0;
  for (const WindowMatch& m : found.matches) {
    const double truth = m.x_px < 210 ? 25 : 5;
    EXPECT_NEAR(m.disparity_px, truth, 0.2) << m.x_px;
    (m.x_px < 210 ? left : right) += 1;
  }
  EXPECT_GT(left, 50);
  EXPECT_GT(right, 50);
  EXPECT_GT(found.counts.misfit + found.counts.inconsistent + found.counts.ambiguous, 10);
}

// A strip of the first picture that the second shows as well, but only as something else's: what that place itself
// looks like decides.
TEST(WindowMatch, APlaceIsOfOneWindowAlone) {
  const Waves texture(12);
  constexpr int kFrom = 200, kStrip = 30;
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  const auto first = [&](double x, double y) {
    return x < kFrom || x >= kFrom + kStrip ? texture(x, y) : texture(x - kStrip, y) + 6 * normal(random);
  };
  const auto found = match_all(drawn(first), drawn(texture), {20, 0});
  EXPECT_GT(found.counts.inconsistent, 10);
  EXPECT_GT(found.counts.found, 0.5 * found.counts.windows);
  for (const WindowMatch& m : found.matches) EXPECT_NEAR(m.disparity_px, 0, 0.5) << m.x_px << " " << m.y_px;
}

TEST(WindowMatch, DifferentPicturesGiveNothing) {
  const auto found = match_all(drawn(Waves(7), 1, 1), drawn(Waves(8), 1, 2), {1, 0});
  EXPECT_LE(found.counts.found, 1);
}

TEST(WindowMatch, UnknownLevelsAreNotUsed) {
  const Waves texture(9);
  LevelPicture first = drawn([&](double x, double y) { return texture(x - 7.5, y); }), second = drawn(texture);
  constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();
  for (int y = 100; y < 120; ++y) {
    for (int x = 100; x < 120; ++x) first.level[static_cast<std::size_t>(y * kWide + x)] = kUnknown;
    for (int x = 300; x < 320; ++x) second.level[static_cast<std::size_t>(y * kWide + x)] = kUnknown;
  }
  const auto found = match_all(first, second);
  EXPECT_GE(found.counts.unknown, 4);
  constexpr int kHalf = WindowMatcher::kHalf;
  for (const WindowMatch& m : found.matches) {
    EXPECT_NEAR(m.disparity_px, 7.5, 0.02);
    if (m.y_px + kHalf < 100 || m.y_px - kHalf >= 120) continue;
    EXPECT_FALSE(m.x_px + kHalf >= 100 && m.x_px - kHalf < 120) << m.x_px << " " << m.y_px;
    EXPECT_FALSE(m.x_px - 7.5 + kHalf >= 300 && m.x_px - 7.5 - kHalf < 320) << m.x_px << " " << m.y_px;
  }
  LevelPicture blind = drawn(texture);
  for (float& level : blind.level) level = kUnknown;
  EXPECT_EQ(match_all(blind, second).counts.found, 0);
  EXPECT_EQ(match_all(second, blind).counts.found, 0);
}

}  // namespace
}  // namespace celadon
