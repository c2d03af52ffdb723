#include "acquisition/stereo/window_match.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

namespace celadon {
namespace {

constexpr int kHalf = WindowMatcher::kHalf, kWidth = 2 * kHalf + 1, kPixels = kWidth * kWidth;
constexpr int kSearchHalf = 7, kSearchWidth = 2 * kSearchHalf + 1;  // smaller windows bend less
constexpr int kBeside = 4;           // px: further from the best correlation another place begins
constexpr float kLeastScore = 0.6F;  // a slanted window correlates less
constexpr float kRivalShare = 0.5F;  // of what is unexplained at the rival, the best may leave
constexpr int kMostInconsistent_px = 1;
constexpr int kPasses = 8;
constexpr double kConverged_px = 0.002, kFurthest_px = 2.5;
constexpr double kLeastGain = 0.3, kMostGain = 3;
constexpr double kSteepest = 0.45;  // disparity per px
constexpr double kMostMisfit = 4;

// Offset, gain, and gain times the change of the disparity: 1, x, y, x^2, y^2, with x and y from -1 to 1.
constexpr int kShape = 5, kUnknowns = 2 + kShape;
using Unknowns = Eigen::Matrix<double, kUnknowns, 1>;
using Shape = Eigen::Matrix<double, kShape, 1>;

// Both pictures are smoothed by a Gaussian of 1 px: noise between pixels then varies as little as noise on them. Else
// it would draw matches to places half way between pixels, where interpolation averages it.
constexpr int kReach = 3;
constexpr std::array<float, 2 * kReach + 1> kTaps = {0.00443F, 0.05400F, 0.24204F, 0.39906F,
                                                     0.24204F, 0.05400F, 0.00443F};

/// Sums of squares: of the smoothing along one direction, and of half the difference of its two neighbours.
constexpr float power_of_smoothing() {
  float sum = 0;
  for (const float tap : kTaps) sum += tap * tap;
  return sum;
}
constexpr float power_of_slope() {
  constexpr int kCount = static_cast<int>(kTaps.size());
  const auto tap = [](int k) { return k < 0 || k >= kCount ? 0 : kTaps[static_cast<std::size_t>(k)]; };
  float sum = 0;
  for (int k = -1; k <= kCount; ++k) sum += 0.25F * (tap(k + 1) - tap(k - 1)) * (tap(k + 1) - tap(k - 1));
  return sum;
}

/// Levels that are unknown, and the border, make those within their reach unknown.
LevelPicture smoothed(const LevelPicture& in) {
  constexpr float kNoLevel = std::numeric_limits<float>::quiet_NaN();
  const int wide = in.width_px, high = in.height_px;
  LevelPicture lines{wide, high, std::vector<float>(in.level.size(), kNoLevel)}, out = lines;
  const auto at = [wide](int x, int y) {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(wide) + static_cast<std::size_t>(x);
  };
  for (int y = 0; y < high; ++y) {
    for (int x = kReach; x < wide - kReach; ++x) {
      float sum = 0;
      for (int k = -kReach; k <= kReach; ++k)
        sum += kTaps[static_cast<std::size_t>(k + kReach)] * in.level[at(x + k, y)];
      lines.level[at(x, y)] = sum;
    }
  }
  for (int y = kReach; y < high - kReach; ++y) {
    for (int x = 0; x < wide; ++x) {
      float sum = 0;
      for (int k = -kReach; k <= kReach; ++k)
        sum += kTaps[static_cast<std::size_t>(k + kReach)] * lines.level[at(x, y + k)];
      out.level[at(x, y)] = sum;
    }
  }
  return out;
}

constexpr int kSpread = kWidth + 2 * kReach;
using Columns = Eigen::Matrix<double, kPixels, kUnknowns>;
/// What each pixel before the smoothing does to the columns' sums: the smoothing's transpose, row by row, wider by its
/// reach on all sides.
Eigen::Matrix<double, kSpread * kSpread, kUnknowns> spread(const Columns& A) {
  Eigen::Matrix<double, kWidth * kSpread, kUnknowns> lines = Eigen::Matrix<double, kWidth * kSpread, kUnknowns>::Zero();
  Eigen::Matrix<double, kSpread * kSpread, kUnknowns> out = Eigen::Matrix<double, kSpread * kSpread, kUnknowns>::Zero();
  for (int k = 0; k < static_cast<int>(kTaps.size()); ++k) {
    const double tap = kTaps[static_cast<std::size_t>(k)];
    for (int j = 0; j < kWidth; ++j)
      lines.middleRows<kWidth>(j * kSpread + k) += tap * A.middleRows<kWidth>(j * kWidth);
  }
  for (int k = 0; k < static_cast<int>(kTaps.size()); ++k) {
    out.middleRows<kWidth * kSpread>(k * kSpread) += static_cast<double>(kTaps[static_cast<std::size_t>(k)]) * lines;
  }
  return out;
}

Shape shape_at(int i, int j) {
  const double x = static_cast<double>(i) / kHalf, y = static_cast<double>(j) / kHalf;
  return (Shape() << 1, x, y, x * x, y * y).finished();
}

}  // namespace

WindowMatcher::WindowMatcher(const LevelPicture& first, const LevelPicture& second, const PictureNoise& noise,
                             const DisparityRange& range)
    : first_(smoothed(first)), second_(smoothed(second)), noise_(noise), range_(range) {}

int WindowMatcher::bands() const {
  return std::max(0, (first_.height_px - kWidth) / kPitch + 1);
}

MatchCounts WindowMatcher::match(int band, std::vector<WindowMatch>& matches) const {
  MatchCounts counts;
  const int y = kHalf + band * kPitch;
  for (int x = kHalf; x + kHalf < first_.width_px; x += kPitch) {
    ++counts.windows;
    WindowMatch match;
    switch (match_window(x, y, match)) {
      case Fate::found:
        ++counts.found;
        matches.push_back(match);
        break;
      case Fate::unknown:
        ++counts.unknown;
        break;
      case Fate::plain:
        ++counts.plain;
        break;
      case Fate::ambiguous:
        ++counts.ambiguous;
        break;
      case Fate::inconsistent:
        ++counts.inconsistent;
        break;
      case Fate::misfit:
        ++counts.misfit;
        break;
    }
  }
  return counts;
}

WindowMatcher::Fate WindowMatcher::match_window(int x, int y, WindowMatch& match) const {
  if (const auto fate = unfit(x, y)) return *fate;
  const Best there = search(first_, second_, 1, x, y);
  if (!(there.score >= kLeastScore)) return Fate::misfit;
  if (1 - there.score > kRivalShare * (1 - there.rival)) return Fate::ambiguous;
  const Best back = search(second_, first_, -1, x - there.disparity, y);
  if (std::abs(back.disparity - there.disparity) > kMostInconsistent_px) return Fate::inconsistent;
  return refine(x, y, there.disparity, match);
}

// Before the search: the gradient along the rows tells what a match there could be worth at best.
std::optional<WindowMatcher::Fate> WindowMatcher::unfit(int x, int y) const {
  float slopes = 0, sum = 0;
  for (int j = -kHalf; j <= kHalf; ++j) {
    const float* const row = first_.row(y + j) + x;
    for (int i = 1 - kHalf; i < kHalf; ++i) {
      const float slope = 0.5F * (row[i + 1] - row[i - 1]);
      slopes += slope * slope;
      sum += row[i];
    }
  }
  if (std::isnan(slopes)) return Fate::unknown;
  const double variance = noise_.variance(sum / static_cast<float>((kWidth - 2) * kWidth));
  constexpr double kSlopePower = power_of_smoothing() * power_of_slope() * (kWidth - 2) * kWidth;
  const double of_texture = slopes - kSlopePower * variance;
  if (!(of_texture * kMostSigma_px * kMostSigma_px > 2 * variance)) return Fate::plain;
  return std::nullopt;
}

// Correlation coefficient of the window with each place of the other picture's row: free of gain and offset.
// @param side  1: a disparity moves to the left, -1: to the right
WindowMatcher::Best WindowMatcher::search(const LevelPicture& from, const LevelPicture& to, int side, int x,
                                          int y) const {
  Best best;
  const int lowest = side > 0 ? x - range_.highest : x + range_.lowest,
            highest = side > 0 ? x - range_.lowest : x + range_.highest;
  const int begin = std::max(lowest, kSearchHalf), end = std::min(highest, to.width_px - 1 - kSearchHalf);
  // Where the picture's border leaves less than half of the places, nothing tells that the best is the only one.
  if (2 * (end - begin) < highest - lowest || x < kSearchHalf || x + kSearchHalf >= from.width_px) return best;
  const auto places = static_cast<std::size_t>(end - begin + 1);

  std::array<float, kSearchWidth * kSearchWidth> window;
  float mean = 0, square = 0;
  for (int j = 0; j < kSearchWidth; ++j) {
    for (int i = 0; i < kSearchWidth; ++i) {
      const float level = from.row(y + j - kSearchHalf)[x + i - kSearchHalf];
      window[static_cast<std::size_t>(j * kSearchWidth + i)] = level;
      mean += level;
    }
  }
  mean /= static_cast<float>(window.size());
  for (float& level : window) {
    level -= mean;
    square += level * level;
  }
  // Levels are counted from the window's mean: squares of small numbers lose no digits.
  static thread_local std::vector<float> cross, sums, squares, column_sum, column_square;
  const std::size_t columns = places + kSearchWidth - 1;
  cross.assign(places, 0);
  column_sum.assign(columns, 0);
  column_square.assign(columns, 0);
  for (int j = 0; j < kSearchWidth; ++j) {
    const float* const row = to.row(y + j - kSearchHalf) + begin - kSearchHalf;
    for (std::size_t c = 0; c < columns; ++c) {
      const float level = row[c] - mean;
      column_sum[c] += level;
      column_square[c] += level * level;
    }
    for (std::size_t i = 0; i < kSearchWidth; ++i) {
      const float weight = window[static_cast<std::size_t>(j) * kSearchWidth + i];
      for (std::size_t k = 0; k < places; ++k) cross[k] += weight * row[k + i];
    }
  }
  sums.assign(places, 0);
  squares.assign(places, 0);
  for (std::size_t i = 0; i < kSearchWidth; ++i) {
    for (std::size_t k = 0; k < places; ++k) {
      sums[k] += column_sum[k + i];
      squares[k] += column_square[k + i];
    }
  }
  constexpr float kInverse = 1.F / (kSearchWidth * kSearchWidth);
  const auto score_at = [&](std::size_t k) {
    const float product = square * (squares[k] - sums[k] * sums[k] * kInverse);
    return product > 0 ? cross[k] / std::sqrt(product) : -1.F;  // unknown levels too
  };
  std::size_t at = 0;
  for (std::size_t k = 0; k < places; ++k) {
    cross[k] = score_at(k);
    if (cross[k] > best.score) {
      best.score = cross[k];
      at = k;
    }
  }
  for (std::size_t k = 0; k < places; ++k) {
    if (std::abs(static_cast<int>(k) - static_cast<int>(at)) > kBeside) best.rival = std::max(best.rival, cross[k]);
  }
  best.disparity = side * (x - (begin + static_cast<int>(at)));
  return best;
}

// u = o + g w(x - D) - (g dD) w'(x - D): linear in o, g and g dD, whatever gain and offset are.
WindowMatcher::Fate WindowMatcher::refine(int x, int y, int start, WindowMatch& match) const {
  Shape disparity = Shape::Zero();
  disparity[0] = start;
  Columns A;
  Eigen::Matrix<double, kPixels, 1> u;
  double level = 0;
  for (int j = -kHalf, k = 0; j <= kHalf; ++j) {
    for (int i = -kHalf; i <= kHalf; ++i, ++k) {
      u[k] = first_.row(y + j)[x + i];
      level += u[k] / kPixels;
    }
  }
  double gain = 1, step = 0;
  Unknowns found;
  Eigen::LDLT<Eigen::Matrix<double, kUnknowns, kUnknowns>> normal;
  for (int pass = 0;; ++pass) {
    for (int j = -kHalf, k = 0; j <= kHalf; ++j) {
      const float* const row = second_.row(y + j);
      for (int i = -kHalf; i <= kHalf; ++i, ++k) {
        const Shape shape = shape_at(i, j);
        const double place = x + i - shape.dot(disparity), left = std::floor(place);
        if (!(left >= 1 && left + 2 < second_.width_px)) return Fate::unknown;
        const auto t = static_cast<float>(place - left);
        const float* const s = row + static_cast<std::ptrdiff_t>(left) - 1;
        const auto w = cubic_weights(t), d = cubic_slopes(t);
        const double value = w[0] * s[0] + w[1] * s[1] + w[2] * s[2] + w[3] * s[3],
                     slope = d[0] * s[0] + d[1] * s[1] + d[2] * s[2] + d[3] * s[3];
        A(k, 0) = 1;
        A(k, 1) = value;
        A.row(k).tail<kShape>() = -slope * shape.transpose();
      }
    }
    normal.compute(A.transpose() * A);
    found = normal.solve(A.transpose() * u);
    gain = found[1];
    if (!found.allFinite()) return Fate::unknown;  // a level within is
    if (!(gain >= kLeastGain && gain <= kMostGain)) return Fate::misfit;
    const Shape change = found.tail<kShape>() / gain;
    disparity += change;
    step = std::abs(change[0]);
    if (!(std::abs(disparity[0] - start) <= kFurthest_px)) return Fate::misfit;
    if (step < kConverged_px) break;
    if (pass == kPasses) return Fate::misfit;
  }
  if (!(std::abs(disparity[1]) <= kSteepest * kHalf && std::abs(disparity[2]) <= kSteepest * kHalf))
    return Fate::misfit;
  const double noise = noise_.variance(level) + gain * gain * noise_.variance((level - found[0]) / gain);
  // Noise came before the smoothing: unknowns of covariance N^-1 B N^-1, residuals of n power^2 - tr(N^-1 B) variances.
  const auto B = spread(A);
  const Eigen::Matrix<double, kUnknowns, kUnknowns> of_noise = B.transpose() * B;
  constexpr double kPower = power_of_smoothing() * power_of_smoothing();
  match.misfit = (u - A * found).squaredNorm() / ((kPixels * kPower - normal.solve(of_noise).trace()) * noise);
  if (!(match.misfit >= 0 && match.misfit <= kMostMisfit)) return Fate::misfit;
  const Unknowns disparity_row = normal.solve(Unknowns::Unit(2));
  const double curvature = disparity_row.dot(of_noise * disparity_row);
  match.x_px = x;
  match.y_px = y;
  match.disparity_px = disparity[0];
  match.sigma_px = std::sqrt(curvature * noise * std::max(1., match.misfit)) / gain;
  match.gain = gain;
  match.offset = found[0];
  return match.sigma_px <= kMostSigma_px ? Fate::found : Fate::plain;
}

}  // namespace celadon
