#pragma once
// The extraction as acquisition/README.md describes it, one pixel at a time in double precision: what every SIMD target
// must agree with.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "acquisition/laser_line.h"

namespace celadon::reference {

/// Bytes of a frame and what is to be read from them.
struct Frame {
  CameraMode mode;
  LineChannel channel = LineChannel::luma;
  const std::uint8_t* bytes = nullptr;

  const std::uint8_t* pair(int row, int px) const { return line(row) + 4 * (px / 2); }
  const std::uint8_t* line(int row) const { return bytes + static_cast<std::size_t>(row) * mode.stride_bytes; }
  int luma(int row, int px) const { return mode.format == PixelFormat::grey8 ? line(row)[px] : line(row)[2 * px]; }
  static int floor_div(int a, int b) { return static_cast<int>(std::floor(static_cast<double>(a) / b)); }
  int colour(int y, int u, int v) const {
    if (mode.format == PixelFormat::grey8 || channel == LineChannel::luma) return y;
    if (channel == LineChannel::red) return y + (v - 128) + floor_div((v - 128) * 206, 512);
    return y - floor_div((u - 128) * 44 + (v - 128) * 91, 128);
  }
  bool has_chroma() const { return mode.format == PixelFormat::yuyv && channel != LineChannel::luma; }
  int signal(int row, int px) const {
    if (!has_chroma()) return luma(row, px);
    return colour(luma(row, px), pair(row, px)[1], pair(row, px)[3]);
  }
};

inline int mean(int a, int b) {
  return (a + b + 1) / 2;
}

/// Mean signal of pixels 4 i .. 4 i + 3.
inline int cell(const Frame& on, const Frame* off, int row, int i) {
  if (!on.has_chroma()) {
    const auto value = [&](int k) {
      const int px = 4 * i + k;
      return off == nullptr ? on.luma(row, px) : std::max(0, on.luma(row, px) - off->luma(row, px));
    };
    return mean(mean(value(0), value(1)), mean(value(2), value(3)));
  }
  const auto colour_of = [&](const Frame& f) {
    const std::uint8_t *first = f.pair(row, 4 * i), *second = f.pair(row, 4 * i + 2);
    const auto luma = [&](int k) { return f.luma(row, 4 * i + k); };
    return f.colour(mean(mean(luma(0), luma(2)), mean(luma(1), luma(3))), mean(first[1], second[1]),
                    mean(first[3], second[3]));
  };
  return std::clamp(colour_of(on) - (off == nullptr ? 0 : colour_of(*off)), 0, 255);
}

inline double squared(double a) {
  return a * a;
}

/// One row; pixels k are counted from `center_`.
class Row {
 public:
  Row(const Frame& on, const Frame* off, int row, const LaserLineOptions& options)
      : on_(on), off_(off), row_(row), width_(on.mode.width_px), options_(options) {
    result.status = RowStatus::no_line;
    coarse();
  }

  LineRow result;
  bool has_window = false, partial = false;
  bool has_start = false;
  double width_start = 0;
  /// What the row says of the speckle: excess of its residuals over the noise, and that figure's weight.
  double excess = 0, weight = 0;

  void prepare() {
    double top = 0;
    bool crossing = false;
    x_start_ = 0;
    if (partial) {
      for (int k = -4; k <= 4; ++k) top = std::max<double>(top, value(k));
    } else {
      crossing = zero_crossing(top);
    }
    const double half = std::nearbyint((top + background(13).level) / 2 - 0.29);
    double above = 0, moment = 0, flat = 0;
    const int far = partial ? 20 : 10;
    for (int k = -far; k <= far; ++k) {
      if (value(k) <= half) continue;
      above += 1;
      moment += k;
      flat += partial && !usable(k);
    }
    x_start_ = std::clamp(moment / std::max(above, 1.0), -10.0, 10.0);
    constexpr double kFullWidth = 2.3548;
    width_start = above / kFullWidth;
    double growth = 1;
    if (partial) {
      width_start = std::sqrt(std::max(above * above - flat * flat, 2 * above)) / kFullWidth;
      growth = std::exp(std::min(flat * flat / (8 * width_start * width_start), 4.0));
    }
    width_start = std::clamp(width_start, 0.5, 6.5);
    has_start = partial ? above > 0 : crossing;
    background_ =
        background(static_cast<int>(std::nearbyint(std::clamp(3.3 * width_start + 1 + std::abs(x_start_), 3.0, 22.0))));
    amplitude_ = growth * std::max(top - background_.level, 1.0);
    x_ = x_start_;
  }

  void begin(double mean_width) { s_ = width_start = (width_start + mean_width) / 2; }

  /// Gauss-Newton in (x / s, ln A, ln s) by Cramer's rule on the 3 x 3 system.
  void improve(double speckle) {
    double m[3][3] = {}, r[3] = {};
    excess = weight = 0;
    const int reach = std::min(28, static_cast<int>(3.3 * s_ + std::abs(x_)));
    for (int k = -reach; k <= reach; ++k) {
      const double u = (k - x_) / s_, light = amplitude_ * std::exp(-u * u / 2);
      if ((partial && !usable(k)) || u * u > 3.3 * 3.3) continue;
      const double w = 1 / (ambient_variance_ + shot() * light + speckle * light * light);
      const double residual = value(k) - background_.level - background_.slope * k - light;
      const double by[3] = {light * u, light, light * u * u};
      for (int i = 0; i < 3; ++i) {
        r[i] += w * by[i] * residual;
        for (int j = 0; j < 3; ++j) m[i][j] += w * by[i] * by[j];
      }
      excess += squared(w * light * residual) - w * light * light;
      weight += squared(w * light * light);
    }
    excess += 3 * weight / std::max(m[1][1], 1e-6);
    if (!partial) m[0][1] = m[1][0] = m[0][2] = m[2][0] = 0;
    m[0][0] += 1e-3;
    m[2][2] += 50;
    r[2] += 50 * (width_start / s_ - 1);
    if (!partial) m[1][2] = m[2][1] = m[0][0];
    const auto determinant = [](const double(&a)[3][3]) {
      return a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1]) - a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0]) +
             a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
    };
    const double d = determinant(m);
    double step[3];
    for (int i = 0; i < 3; ++i) {
      double replaced[3][3];
      for (int row = 0; row < 3; ++row) {
        for (int col = 0; col < 3; ++col) replaced[row][col] = col == i ? r[row] : m[row][col];
      }
      step[i] = determinant(replaced) / d;
    }
    variance_x_ = (m[1][1] * m[2][2] - m[1][2] * m[2][1]) / d * s_ * s_;
    x_ = std::clamp(x_ + s_ * std::clamp(step[0], -0.6, 0.6), -12.0, 12.0);
    amplitude_ *= 1 + std::clamp(step[1], -0.5, 1.0);
    s_ = std::clamp(s_ * (1 + std::clamp(step[2], -0.3, 0.3)), 0.5, 6.5);
  }

  void finish() {
    const double variance_x =
        variance_x_ + squared(2.83 * s_ * s_ / amplitude_) * ambient_variance_ * background_.slope_variance;
    if (!has_start || !(variance_x > 0) || std::abs(x_ - x_start_) > std::max(3.0, s_)) return;
    if (amplitude_ * amplitude_ * s_ * 1.7725 / (ambient_variance_ + shot() * amplitude_) <= 25) return;
    const double position = center_ + x_;
    if (position < 2 * s_ || position > width_ - 1 - 2 * s_) return;
    result.x_px = static_cast<float>(position);
    result.sigma_px = static_cast<float>(std::sqrt(variance_x));
    result.amplitude = static_cast<float>(amplitude_);
    result.width_px = static_cast<float>(s_);
    result.status = saturated_ ? RowStatus::saturated : RowStatus::found;
  }

 private:
  int saturation() const { return on_.mode.format == PixelFormat::grey8 ? 250 : 235; }
  int column(int k) const { return std::clamp(center_ + k, 0, width_ - 1); }
  int raw(int k) const { return on_.signal(row_, column(k)); }
  int value(int k) const {
    return std::clamp(raw(k) - (off_ == nullptr ? 0 : off_->signal(row_, column(k))), -64, 255);
  }
  bool inside(int k) const { return center_ + k >= 0 && center_ + k < width_; }
  bool usable(int k) const { return inside(k) && raw(k) < saturation(); }
  double shot() const { return 1 / static_cast<double>(options_.electrons_per_level); }

  /// Height and offset (cells) of the parabola through a score and its neighbours.
  static std::pair<double, double> vertex(int before, int score, int after) {
    const double curvature = std::max(2 * score - before - after, 1), lean = after - before;
    return {score + lean * lean / (8 * curvature), lean / (2 * curvature)};
  }

  void coarse() {
    const int n = width_ / 4;
    std::vector<int> cells;
    for (int i = 0; i < n; ++i) cells.push_back(cell(on_, off_, row_, i));
    const auto at = [&](int i) { return cells[static_cast<std::size_t>(std::clamp(i, 0, n - 1))]; };
    const auto mean_of_8 = [&](int i) { return mean(at(i), at(i + 1)); };
    std::vector<int> scores;
    for (int i = 0; i < n; ++i) {
      scores.push_back(std::max(0, mean_of_8(i) - std::max(mean_of_8(i - 3), mean_of_8(i + 3))));
    }
    const int highest = *std::max_element(scores.begin(), scores.end());
    if (highest < options_.minimum_contrast) return;
    const int index = static_cast<int>(std::find(scores.begin(), scores.end(), highest) - scores.begin());
    const auto score = [&](int i) { return i < 0 || i >= n ? 0 : scores[static_cast<std::size_t>(i)]; };
    const auto [height, offset] = vertex(score(index - 1), highest, score(index + 1));
    int second = 0, sum = 0, count = 0, second_index = 0;
    for (int i = 0; i < n; ++i) {
      if (std::abs(i - index) <= 6) {
        scores[static_cast<std::size_t>(i)] = 0;
        continue;
      }
      sum += score(i);
      ++count;
      if (score(i) > second) second_index = i;
      second = std::max(second, score(i));
    }
    if (second > 0 && vertex(score(second_index - 1), second, score(second_index + 1)).first * 100 >
                          options_.ambiguous_percent * height) {
      result.status = RowStatus::ambiguous;
      return;
    }
    if (highest * count < 22 * sum) return;
    center_ = 4 * index + 4 + 2 * static_cast<int>(std::floor(2 * offset + 0.25));
    has_window = true;
    for (int k = -32; k < 32; ++k) {
      saturated_ = saturated_ || raw(k) >= saturation();
      partial = partial || !usable(k);
    }
    const Frame& dark = off_ == nullptr ? on_ : *off_;
    int ambient = 0;
    for (int k : {-24, -23, -22, -21, 20, 21, 22, 23}) ambient += dark.signal(row_, column(k));
    ambient_variance_ = (off_ == nullptr ? 1 : 2) * (squared(static_cast<double>(options_.read_noise)) + 1.0 / 12 +
                                                     std::max(ambient, 0) / 8.0 * shot());
  }

  /// Whether there is one; `top` becomes the mean of the three pixels about it.
  bool zero_crossing(double& top) const {
    static const int taps[9] = {0, 11, 18, 21, 19, 14, 9, 5, 3};
    const auto slope = [&](int k) {
      int sum = 0;
      for (int t = 1; t <= 8; ++t) sum += taps[t] * (value(k + t) - value(k - t));
      return sum;
    };
    int nearest = 100;
    for (int k = 4; k >= -6; --k) {  // from the right: at equal distance the right one is kept
      const int a = slope(k), b = slope(k + 1);
      if (a <= 0 || b > 0 || std::abs(2 * k + 1) >= nearest) continue;
      nearest = std::abs(2 * k + 1);
      top = (value(k) + value(k + 1) + value(a + b > 0 ? k + 2 : k - 1)) / 3.0;
    }
    return nearest < 100;
  }

  struct Background {
    double level = 0, slope = 0, slope_variance = 1e-6;  // per variance of a pixel
  };
  Background background(int near) const {
    double sum[2] = {}, distance[2] = {}, count[2] = {};
    for (int k = near + 1; k <= near + 6; ++k) {
      for (int side : {0, 1}) {
        const int at = side == 0 ? -k : k;
        if (partial && !usable(at)) continue;
        sum[side] += value(at);
        distance[side] += k;
        count[side] += 1;
      }
    }
    Background b;
    if (count[0] > 0 && count[1] > 0) {
      const double span = distance[0] / count[0] + distance[1] / count[1];
      b.slope = (sum[1] / count[1] - sum[0] / count[0]) / span;
      b.level = sum[0] / count[0] + b.slope * distance[0] / count[0];
      b.slope_variance = (1 / count[0] + 1 / count[1]) / (span * span);
    } else {
      b.level = count[0] > 0 ? sum[0] / count[0] : count[1] > 0 ? sum[1] / count[1] : 0;
    }
    return b;
  }

  const Frame& on_;
  const Frame* off_;
  int row_, width_;
  LaserLineOptions options_;
  int center_ = 0;
  bool saturated_ = false;
  double ambient_variance_ = 0, x_start_ = 0, x_ = 0, amplitude_ = 0, s_ = 0, variance_x_ = 0;
  Background background_;
};

/// Rows of a block of 16 that are all whole, or all not: they share widths to begin with, and the speckle.
inline void refine(const std::vector<Row*>& rows, const LaserLineOptions& options) {
  if (rows.empty()) return;
  double widths = 0, count = 0;
  for (Row* row : rows) {
    row->prepare();
    widths += row->has_start ? row->width_start : 0;
    count += row->has_start;
  }
  for (Row* row : rows) row->begin(widths / std::max(count, 1.0));
  const double extent = static_cast<double>(options.speckle_extent_px);
  const double expected = squared(static_cast<double>(options.speckle_contrast)) * extent;
  const int passes = rows.front()->partial ? 6 : 3;
  double speckle = expected;
  for (int pass = 0; pass < passes; ++pass) {
    if (pass + 1 == passes) {
      double excess = 0, weight = 0;
      for (const Row* row : rows) {
        excess += row->has_start ? row->excess : 0;
        weight += row->has_start ? row->weight : 0;
      }
      const double shown = std::min(extent * std::max(speckle + excess / weight, 0.0), 1.0);
      if (weight > 0) speckle = (count * shown + expected) / (count + 1);
    }
    for (Row* row : rows) row->improve(speckle);
  }
  for (Row* row : rows) row->finish();
}

inline std::vector<LineRow> extract(const Frame& on, const Frame* off, const LaserLineOptions& options) {
  std::vector<Row> rows;
  for (int row = 0; row < on.mode.height_px; ++row) rows.emplace_back(on, off, row, options);
  for (std::size_t block = 0; block < rows.size(); block += 16) {
    for (const bool partial : {false, true}) {
      std::vector<Row*> alike;
      for (std::size_t i = block; i < std::min(block + 16, rows.size()); ++i) {
        if (rows[i].has_window && rows[i].partial == partial) alike.push_back(&rows[i]);
      }
      refine(alike, options);
    }
  }
  std::vector<LineRow> results;
  for (const Row& row : rows) results.push_back(row.result);
  return results;
}

}  // namespace celadon::reference
