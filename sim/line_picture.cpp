#include "sim/line_picture.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>

namespace celadon::sim {
namespace {

constexpr auto kMiddle = static_cast<std::size_t>(kAcross / 2);

// e^-u for u >= 0 to 2e-7 relative; plain arithmetic, so that the loop around it vectorises.
inline float exp_minus(float u) {
  const float t = std::min(u, 80.F) * -1.44269504F;
  const auto whole = static_cast<std::int32_t>(t - 0.5F);
  const float f = t - static_cast<float>(whole);
  const float p =
      1.F +
      f * (0.693147182F +
           f * (0.240226462F + f * (0.0555032864F + f * (0.00961813331F + f * (0.00133389514F + f * 0.000154697F)))));
  return p * std::bit_cast<float>((whole + 127) << 23);
}

// Value at y of the polynomial through up to four points.
template <class Value>
double lagrange(const double* y, const Value* v, int n, double at) {
  double sum = 0;
  for (int i = 0; i < n; ++i) {
    double w = v[i];
    for (int j = 0; j < n; ++j) {
      if (j != i) w *= (at - y[j]) / (y[i] - y[j]);
    }
    sum += w;
  }
  return sum;
}

bool brackets(const std::vector<Beam>& b, int i, double y) {
  if (i < 0 || i + 1 >= static_cast<int>(b.size()) || !b[static_cast<std::size_t>(i)].joined) return false;
  const double y0 = b[static_cast<std::size_t>(i)].y_px, y1 = b[static_cast<std::size_t>(i + 1)].y_px;
  return (y >= y0 && y < y1) || (y <= y0 && y > y1);
}

// Rays i and i + 1 meet one surface: a curve through them may be continued.
bool smooth(const std::vector<Beam>& b, int i) {
  if (i < 0 || i + 1 >= static_cast<int>(b.size())) return false;
  const Beam &p = b[static_cast<std::size_t>(i)], &q = b[static_cast<std::size_t>(i + 1)];
  return p.joined && p.surface == q.surface;
}

// The pair of rays, `ray` or one near it, between which a place across the sheet meets the row; -1: none.
int pair_at(const std::vector<Beam>& b, int ray, double y) {
  constexpr int kNear = 6;
  for (int step = 0; step <= kNear; ++step) {
    if (brackets(b, ray - step, y)) return ray - step;
    if (brackets(b, ray + step, y)) return ray + step;
  }
  return -1;
}

// Where rays lie dense about an edge: the pair on this surface that meets the row, or the one that nearly does: an edge
// cuts the places across the sheet at slightly different rows.
int pair_on_surface(const std::vector<Beam>& b, int ray, int surface, double y) {
  constexpr int kNear = 48;
  constexpr double kBeyond_px = 2.5;
  int best = -1;
  double least = kBeyond_px;
  const auto look = [&](int i) {
    if (!smooth(b, i) || b[static_cast<std::size_t>(i)].surface != surface) return false;
    const double y0 = b[static_cast<std::size_t>(i)].y_px, y1 = b[static_cast<std::size_t>(i + 1)].y_px;
    const double beyond = std::max(std::min(y0, y1) - y, y - std::max(y0, y1));
    if (beyond < least && std::abs(y1 - y0) > 0.2) {
      least = beyond;
      best = i;
    }
    return beyond <= 0;
  };
  for (int step = 0; step <= kNear; ++step) {
    if (look(ray - step)) return ray - step;
    if (look(ray + step)) return ray + step;
  }
  return best;
}

/// Brightness along a row: s(u) by Newton's divided differences, u in pixels from the line's middle.
struct Profile {
  std::array<float, kAcross> node, c;
  float low, high;  ///< ends of what was traced
  float share;
  float shift;  ///< u of the first pixel
  float b0, b1;
  float variance, blur2;
};

// The number of nodes is a constant, so that the loop over pixels vectorises.
template <std::size_t n>
void add_light(const Profile& profile, float* out, int count) {
  const Profile p = profile;
  for (int i = 0; i < count; ++i) {
    const float u = p.shift + static_cast<float>(i);
    const float source = std::min(std::max(u * p.share, p.low), p.high);
    float s = p.c[n - 1], slope = 0;
    for (std::size_t m = n - 1; m-- > 0;) {
      const float step = source - p.node[m];
      slope = slope * step + s;
      s = s * step + p.c[m];
    }
    s += slope * (u - source);
    const float spread = p.variance + slope * slope * p.blur2;
    const float b = std::max(0.F, p.b0 + p.b1 * source);
    out[i] += b / std::sqrt(spread) * exp_minus(0.5F * s * s / spread);
  }
}

void add_light(int nodes, const Profile& profile, float* out, int count) {
  switch (nodes) {
    case 2:
      return add_light<2>(profile, out, count);
    case 3:
      return add_light<3>(profile, out, count);
    case 4:
      return add_light<4>(profile, out, count);
    default:
      return add_light<kAcross>(profile, out, count);
  }
}

}  // namespace

LinePicture::LinePicture(const OpticsConfig& config)
    : config_(config),
      levels_(static_cast<std::size_t>(config.camera.width_px) * static_cast<std::size_t>(config.camera.height_px),
              0.F),
      lit_(static_cast<std::size_t>(config.camera.height_px)) {}

void LinePicture::clear() {
  const auto width = static_cast<std::size_t>(config_.camera.width_px);
  for (std::size_t y = 0; y < lit_.size(); ++y) {
    float* row = &levels_[y * width];
    std::fill(row + lit_[y].from, row + lit_[y].to, 0.F);
    lit_[y] = {};
  }
}

// The row's pixels, of which [from, to) get light.
float* LinePicture::light(int row, int from, int to) {
  Span& span = lit_[static_cast<std::size_t>(row)];
  span = span.from == span.to ? Span{from, to} : Span{std::min(span.from, from), std::max(span.to, to)};
  return &levels_[static_cast<std::size_t>(row) * static_cast<std::size_t>(config_.camera.width_px)];
}

bool LinePicture::cross(const Strand& strand, int ray, int row, Crossing& crossing) const {
  const double y = row;
  std::array<bool, kAcross> have{};
  std::array<int, kAcross> pairs{};
  Places& x = crossing.x;
  for (std::size_t k = 0; k < kAcross; ++k) {
    const std::vector<Beam>& b = strand.beams[k];
    const int surface = strand.beams[kMiddle][static_cast<std::size_t>(ray)].surface;
    int at = k == kMiddle ? ray : pair_at(b, ray, y);
    if (strand.dense && k != kMiddle && (at < 0 || b[static_cast<std::size_t>(at)].surface != surface)) {
      at = pair_on_surface(b, ray, surface, y);
    }
    if (at < 0) continue;
    int from = at, to = at + 1;
    if (smooth(b, at) && brackets(b, at, y)) {
      from = smooth(b, at - 1) ? at - 1 : at;
      to = smooth(b, at + 1) ? at + 2 : at + 1;
    }
    std::array<double, 4> ys{}, xs{}, bs{};
    for (int m = from; m <= to; ++m) {
      const Beam& beam = b[static_cast<std::size_t>(m)];
      const auto n = static_cast<std::size_t>(m - from);
      ys[n] = beam.y_px;
      xs[n] = beam.x_px;
      bs[n] = static_cast<double>(beam.brightness);
    }
    x[k] = lagrange(ys.data(), xs.data(), to - from + 1, y);
    crossing.brightness[k] = lagrange(ys.data(), bs.data(), to - from + 1, y);
    have[k] = true;
    pairs[k] = at;
  }
  int first = static_cast<int>(kMiddle), last = first;
  const auto usable = [&](int k, int next) {
    if (!have[static_cast<std::size_t>(next)]) return false;
    const double step = (x[static_cast<std::size_t>(next)] - x[static_cast<std::size_t>(k)]) * (next - k);
    const double sense = have[kMiddle + 1] ? x[kMiddle + 1] - x[kMiddle] : x[kMiddle] - x[kMiddle - 1];
    return step * sense > 0;
  };
  while (first > 0 && usable(first, first - 1)) --first;
  while (last + 1 < kAcross && usable(last, last + 1)) ++last;
  crossing.first = first;
  crossing.last = last;
  if (first == last) return false;
  if (config_.subsurface.share > 0 || config_.fields.contrast != 1) note_surface(strand, ray, pairs, row, crossing);
  return true;
}

void LinePicture::note_surface(const Strand& strand, int ray, const std::array<int, kAcross>& pairs, int row,
                               Crossing& crossing) const {
  const auto between = [&](std::size_t k, float Beam::*value) {
    const Beam& a = strand.beams[k][static_cast<std::size_t>(pairs[k])];
    const Beam& b = strand.beams[k][static_cast<std::size_t>(pairs[k] + 1)];
    double step = static_cast<double>(b.*value - a.*value);
    if (std::abs(step) > 0.5 * ReflectanceFields::kAround) step -= std::copysign(ReflectanceFields::kAround, step);
    const double per_row = step / (b.y_px - a.y_px);
    return std::pair(static_cast<double>(a.*value) + (row - a.y_px) * per_row, per_row);
  };
  const Beam& beam = strand.beams[kMiddle][static_cast<std::size_t>(ray)];
  crossing.halo_px = between(kMiddle, &Beam::halo_px).first;
  crossing.px_per_mm = config_.camera.fx_px / (config_.X_CW * beam.p.cast<double>()).z();
  const auto first = static_cast<std::size_t>(crossing.first), last = static_cast<std::size_t>(crossing.last);
  const double width = crossing.x[last] - crossing.x[first];
  const auto along = [&](float Beam::*value, double& middle, double& per_px, double& blur) {
    const auto [at, per_row] = between(kMiddle, value);
    double step = between(last, value).first - between(first, value).first;
    if (std::abs(step) > 0.5 * ReflectanceFields::kAround) step -= std::copysign(ReflectanceFields::kAround, step);
    middle = at;
    per_px = step / width;
    blur = config_.blur_px * std::hypot(per_px, per_row);
  };
  FieldsOnRow& fields = crossing.fields;
  along(&Beam::around, fields.around, fields.around_per_px, fields.around_blur);
  along(&Beam::up, fields.up, fields.up_per_px, fields.up_blur);
}

void LinePicture::draw(const Strand& strand, int laser, double weight, const Exposure& exposure) {
  const LaserSheet& sheet = laser == 0 ? config_.sheet : *config_.second_sheet;
  const int height = config_.camera.height_px;
  const double levels = config_.line_levels * 0.25 / std::max(sheet.sigma_mm, 1e-9) *
                        static_cast<double>(exposure.exposure_ns) / static_cast<double>(config_.reference_exposure_ns);
  const std::int64_t begin = exposure.first_row_end_ns - exposure.exposure_ns, end = exposure.first_row_end_ns;
  const double power_of_all = exposure.motion.mean_power(begin, end, laser);
  const std::vector<Beam>& middle = strand.beams[kMiddle];
  for (int i = 0; i + 1 < static_cast<int>(middle.size()); ++i) {
    if (!middle[static_cast<std::size_t>(i)].joined) continue;
    const double ya = middle[static_cast<std::size_t>(i)].y_px, yb = middle[static_cast<std::size_t>(i + 1)].y_px;
    const int first_row = std::max(0, static_cast<int>(std::ceil(std::min(ya, yb))));
    const int last_row = std::min(height - 1, static_cast<int>(std::floor(std::max(ya, yb))));
    for (int y = first_row; y <= last_row; ++y) {
      Crossing crossing;
      if (!brackets(middle, i, y) || !cross(strand, i, y, crossing)) continue;
      const std::int64_t later = y * exposure.line_time_ns;
      const double power = later == 0 ? power_of_all : exposure.motion.mean_power(begin + later, end + later, laser);
      draw_row(y, sheet, crossing, levels * power * weight);
    }
  }
}

// Each pixel of the row looks at its own place s(x) across the sheet: irradiance e^(-s^2 / 2 sigma^2), incidence and
// reflectance of that place. Blur by Laplace's method: s linearised where most of the pixel's light comes from, sigma^2
// grown by (ds/dx blur)^2; exact where s is linear over the blur.
void LinePicture::draw_row(int row, const LaserSheet& sheet, const Crossing& crossing, double all) {
  const Places &x = crossing.x, &brightness = crossing.brightness;
  const int first = crossing.first, last = crossing.last;
  const double scale = all * (1 - config_.subsurface.share);
  const int n = last - first + 1, middle = kAcross / 2;
  const double origin = x[middle];
  std::array<float, kAcross> node{}, c{};
  {
    std::array<double, kAcross> d{}, u{};
    for (int i = 0; i < n; ++i) {
      u[static_cast<std::size_t>(i)] = x[static_cast<std::size_t>(first + i)] - origin;
      d[static_cast<std::size_t>(i)] = across_mm(sheet, first + i);
    }
    for (int order = 1; order < n; ++order) {
      for (int i = n - 1; i >= order; --i) {
        const auto a = static_cast<std::size_t>(i);
        d[a] = (d[a] - d[a - 1]) / (u[a] - u[a - static_cast<std::size_t>(order)]);
      }
    }
    for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
      node[i] = static_cast<float>(u[i]);
      c[i] = static_cast<float>(d[i]);
    }
  }
  const double slope_mm_per_px = (across_mm(sheet, last) - across_mm(sheet, first)) /
                                 (x[static_cast<std::size_t>(last)] - x[static_cast<std::size_t>(first)]);
  const double sigma = sheet.sigma_mm;
  const double sigma_px =
      std::sqrt(sigma * sigma / (slope_mm_per_px * slope_mm_per_px) + config_.blur_px * config_.blur_px);
  const double reach = 5.5 * sigma_px;
  const int width = config_.camera.width_px;
  const int from = std::max(0, static_cast<int>(std::floor(origin - reach)));
  const int to = std::min(width, static_cast<int>(std::ceil(origin + reach)) + 1);
  if (from >= to) return;
  const float low = std::min(node[0], node[static_cast<std::size_t>(n - 1)]);
  const float high = std::max(node[0], node[static_cast<std::size_t>(n - 1)]);
  const auto b0 = static_cast<float>(brightness[static_cast<std::size_t>(middle)] * scale * sigma);
  // Brightness across the sheet: linear between the ends is enough, its square term is below 1e-4.
  const auto b1 =
      static_cast<float>((brightness[static_cast<std::size_t>(last)] - brightness[static_cast<std::size_t>(first)]) *
                         scale * sigma / (x[static_cast<std::size_t>(last)] - x[static_cast<std::size_t>(first)]));
  const auto variance = static_cast<float>(sigma * sigma),
             blur2 = static_cast<float>(config_.blur_px * config_.blur_px);
  float* out = light(row, from, to);
  const auto shift = static_cast<float>(from - origin);
  // Light that blur brings to column u comes mostly from this share of u: all of it for a thick sheet, none for a thin
  // one.
  const auto share = static_cast<float>(
      sigma * sigma / (sigma * sigma + slope_mm_per_px * slope_mm_per_px * config_.blur_px * config_.blur_px));
  const Profile profile{node, c, low, high, share, shift, b0, b1, variance, blur2};
  const bool plain = config_.fields.contrast == 1;
  if (!plain) row_.assign(static_cast<std::size_t>(to - from), 0.F);
  add_light(n, profile, plain ? out + from : row_.data(), to - from);
  for (int i = from; !plain && i < to; ++i) {
    out[i] += row_[static_cast<std::size_t>(i - from)] *
              static_cast<float>(crossing.fields.reflectance(config_.fields.contrast, i - origin));
  }
  if (config_.subsurface.share > 0) {
    const double length = config_.subsurface.depth_mm * crossing.px_per_mm, centre = origin + crossing.halo_px;
    const int begin = std::clamp(static_cast<int>(centre - 8 * length), 0, width);
    const int end = std::clamp(static_cast<int>(centre + 8 * length) + 1, 0, width);
    const double energy = brightness[static_cast<std::size_t>(middle)] * all * config_.subsurface.share * sigma *
                          std::sqrt(2 * std::numbers::pi) / std::abs(slope_mm_per_px);
    if (begin < end) add_halo(light(row, begin, end), begin, end, centre, length, energy);
  }
  if (config_.reflection > 0)
    draw_reflection(
        row, origin, sigma_px,
        brightness[static_cast<std::size_t>(middle)] * scale * sigma /
            std::sqrt(sigma * sigma + slope_mm_per_px * slope_mm_per_px * config_.blur_px * config_.blur_px));
}

// A stray copy of the line, twice as wide, beside it over part of the rows: light that came by way of the enclosure.
void LinePicture::draw_reflection(int row, double x_px, double sigma_px, double peak) {
  const double at = static_cast<double>(row) / config_.camera.height_px, s = config_.camera.height_px / 1024.0;
  if (at < 0.38 || at > 0.66) return;
  const double fade = std::sin(std::numbers::pi * (at - 0.38) / 0.28);
  const double centre = x_px + s * (85 + 30 * std::sin(9 * at));
  const double sigma = 2 * sigma_px;
  const int width = config_.camera.width_px;
  const int from = std::max(0, static_cast<int>(std::floor(centre - 4 * sigma)));
  const int to = std::min(width, static_cast<int>(std::ceil(centre + 4 * sigma)) + 1);
  if (from >= to) return;
  const auto amplitude = static_cast<float>(config_.reflection * peak * fade),
             inverse = static_cast<float>(0.5 / (sigma * sigma));
  float* out = light(row, from, to);
  for (int i = from; i < to; ++i) {
    const auto u = static_cast<float>(i - centre);
    out[i] += amplitude * exp_minus(u * u * inverse);
  }
}

}  // namespace celadon::sim
