#include "acquisition/surface_colour.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>

namespace celadon {
namespace {

constexpr float kLineReach = 4, kLineReach_px = 2;  // standard deviations, and pixels that share their chroma
constexpr int kWindow_px = 4;
constexpr float kDarkest_levels = 12, kSaturated_levels = 250;

/// Mean colour of some pixels; none of it once one of them was saturated.
class PixelMean {
 public:
  void add(const LinearColour& c) {
    saturated_ = saturated_ || std::max({c.red, c.green, c.blue}) > kSaturated_levels;
    sum_[0] += c.red;
    sum_[1] += c.green;
    sum_[2] += c.blue;
    for (int& n : count_) ++n;
  }
  /// One pixel of a mosaic. @param channel  0 red, 1 green, 2 blue
  void add(std::size_t channel, std::uint8_t level) {
    saturated_ = saturated_ || static_cast<float>(level) > kSaturated_levels;
    sum_[channel] += static_cast<float>(level);
    ++count_[channel];
  }
  void spoil() { saturated_ = true; }

  std::optional<LinearColour> mean() const {
    if (saturated_ || *std::min_element(count_.begin(), count_.end()) == 0) return std::nullopt;
    const auto of = [&](std::size_t k) { return sum_[k] / static_cast<float>(count_[k]); };
    const LinearColour out{of(0), of(1), of(2)};
    if (std::max({out.red, out.green, out.blue}) < kDarkest_levels) return std::nullopt;
    return out;
  }

 private:
  std::array<float, 3> sum_{};
  std::array<int, 3> count_{};
  bool saturated_ = false;
};

/// Of the mosaic's pixel: 0 red, 1 green, 2 blue.
std::size_t mosaic_channel(ColourLayout mosaic, int x, int y) {
  const int red_x = mosaic == ColourLayout::grbg || mosaic == ColourLayout::bggr ? 1 : 0;
  const int red_y = mosaic == ColourLayout::gbrg || mosaic == ColourLayout::bggr ? 1 : 0;
  if ((x + y + red_x + red_y) % 2 != 0) return 1;
  return x % 2 == red_x ? 0 : 2;
}

std::uint8_t level_of(float value) {
  return static_cast<std::uint8_t>(std::lround(std::clamp(value, 0.F, 255.F)));
}

}  // namespace

SurfaceColour::SurfaceColour(const CameraMode& mode, LineAlong along) : mode_(mode), along_(along) {}

// Of a mosaic whole cells, so that each colour has its pixels.
SurfaceColour::Window SurfaceColour::window(std::size_t row, int from_px) const {
  const int number = static_cast<int>(row), cell = is_mosaic(mode_.colour.layout) ? 2 : 1;
  const int across = number - number % cell;
  if (along_ == LineAlong::rows) return {from_px, from_px + kWindow_px, across, across + cell};
  return {across, across + cell, from_px, from_px + kWindow_px};
}

SurfaceColour::Side SurfaceColour::side(const Frame& frame, std::size_t row, int from_px, int outermost_px) const {
  const Window w = window(row, from_px);
  // Pixels beyond an even size share their chroma with none.
  if (w.x0 < 0 || w.y0 < 0 || w.x1 > mode_.width_px - mode_.width_px % 2 ||
      w.y1 > mode_.height_px - mode_.height_px % 2) {
    return {};
  }
  const ColourCoding& coding = mode_.colour;
  const std::uint8_t* const bytes = frame.bytes().data();
  const std::uint8_t* const beside = frame.colour().data();
  const bool packed = coding.layout == ColourLayout::yuyv;
  const int saturated = mode_.saturated_from();
  PixelMean mean;
  for (int y = w.y0; y < w.y1; ++y) {
    const std::uint8_t* const luma = bytes + static_cast<std::size_t>(y) * mode_.stride_bytes;
    const int chroma_row = coding.layout == ColourLayout::uv_cells ? y / 2 : y;
    const std::uint8_t* const colours =
        packed ? luma + 1 : beside + static_cast<std::size_t>(chroma_row) * coding.stride_bytes;
    for (int x = w.x0; x < w.x1; ++x) {
      if (is_mosaic(coding.layout)) {
        mean.add(mosaic_channel(coding.layout, x, y), colours[x]);
        continue;
      }
      const int level = luma[packed ? 2 * x : x];
      if (level >= saturated) mean.spoil();
      const std::uint8_t* const u = colours + (packed ? 4 : 2) * (x / 2);
      mean.add(colour_of(coding, static_cast<float>(level), u[0], u[packed ? 2 : 1]));
    }
  }
  const auto found = mean.mean();
  return {found.has_value(), outermost_px, found.value_or(LinearColour())};
}

void SurfaceColour::read(const Frame& frame, std::span<const LineRow> rows) {
  if (!there()) return;
  sides_.assign(rows.size(), {});
  if (mode_.colour.layout != ColourLayout::yuyv && frame.colour().empty()) return;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const LineRow& line = rows[i];
    if (line.status != RowStatus::found && line.status != RowStatus::saturated) continue;
    const float reach_px = kLineReach * line.width_px + kLineReach_px;
    // Ends lie between pairs of pixels that share their chroma.
    const int low = 2 * static_cast<int>(std::floor((line.x_px - reach_px + 1) / 2));
    const int high = 2 * static_cast<int>(std::ceil((line.x_px + reach_px) / 2));
    sides_[i] = {side(frame, i, low - kWindow_px, low - kWindow_px), side(frame, i, high, high + kWindow_px - 1)};
  }
}

void SurfaceColour::give(const Triangulator& triangulator, Profile& profile) const {
  profile.colour.clear();
  if (!there()) return;
  profile.colour.resize(profile.size());
  for (std::size_t k = 0; k < profile.size(); ++k) {
    const double row = profile.row[k];
    LinearColour sum;
    int count = 0;
    for (const Side& side : sides_[profile.row[k]]) {
      if (!side.tells) continue;
      const double along = side.outermost_px;
      const bool met = along_ == LineAlong::rows ? triangulator.meets_radius(along, row, profile.r_mm[k])
                                                 : triangulator.meets_radius(row, along, profile.r_mm[k]);
      if (!met) continue;
      sum.red += side.colour.red;
      sum.green += side.colour.green;
      sum.blue += side.colour.blue;
      ++count;
    }
    if (count == 0) continue;
    const float share = 1 / static_cast<float>(count);
    profile.colour[k] = {level_of(share * sum.red), level_of(share * sum.green), level_of(share * sum.blue)};
  }
}

}  // namespace celadon
