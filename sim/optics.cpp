#include "sim/optics.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <utility>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr std::uint64_t kPixelPurpose = 1, kSpecklePurpose = 2;
constexpr double kSpeckleCell_rad = 2e-4;  // a table turned by more shows another speckle pattern
constexpr double kAmbientCell_rad = 5 * std::numbers::pi / 180;
constexpr int kAmbientBlock = 8;  // room light is rendered on every eighth pixel
constexpr double kBlackDark = 1e-6;

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

Vector3d turned(const Vector3d& p, double cos_a, double sin_a) {
  return {cos_a * p.x() - sin_a * p.y(), sin_a * p.x() + cos_a * p.y(), p.z()};
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

}  // namespace

double MotionRecord::angle_rad(std::int64_t time_ns) const {
  const double at = std::clamp(static_cast<double>(time_ns - first_ns) / static_cast<double>(step_ns), 0.0,
                               static_cast<double>(samples.size() - 1));
  const auto i = std::min(static_cast<std::size_t>(at), samples.size() - 1), j = std::min(i + 1, samples.size() - 1);
  const double f = at - static_cast<double>(i), dt = static_cast<double>(step_ns) * 1e-9;
  const double a = samples[i].angle_rad, b = samples[j].angle_rad;
  const double va = samples[i].speed_rad_per_s * dt, vb = samples[j].speed_rad_per_s * dt;
  const double d = b - a;
  return a + f * (va + f * ((3 * d - 2 * va - vb) + f * (va + vb - 2 * d)));
}

double MotionRecord::mean_power(std::int64_t from_ns, std::int64_t to_ns) const {
  if (to_ns <= from_ns) return 0;
  // Integral of the piecewise linear power, interval by interval.
  const auto power_at = [this](double at) {
    const double x = std::clamp(at, 0.0, static_cast<double>(samples.size() - 1));
    const auto i = static_cast<std::size_t>(x), j = std::min(i + 1, samples.size() - 1);
    const double f = x - static_cast<double>(i);
    return samples[i].laser_power * (1 - f) + samples[j].laser_power * f;
  };
  const auto place = [this](std::int64_t t) {
    return static_cast<double>(t - first_ns) / static_cast<double>(step_ns);
  };
  const double begin = place(from_ns), end = place(to_ns);
  double sum = 0, a = begin;
  while (a < end) {
    const double b = std::min(end, std::floor(a) + 1);
    sum += (b - a) * 0.5 * (power_at(a) + power_at(b));
    a = b;
  }
  return sum / (end - begin);
}

OpticsConfig default_optics(int width_px, int height_px, double sheet_offset_mm, double sheet_tilt_rad) {
  OpticsConfig config;
  const double s = height_px / 1024.0;
  config.camera = {
      width_px, height_px, 2100 * s, 2102 * s, (width_px - 1) / 2.0 + 6.3 * s, (height_px - 1) / 2.0 - 4.1 * s, -0.12,
      0.05,     4e-4,      -3e-4,    0.01};
  config.blur_px = 0.6;
  constexpr double kDistance = 300, kBeside = std::numbers::pi / 6, kAbove = 12 * std::numbers::pi / 180;
  const Vector3d target(0, 0, 58);
  const Vector3d centre = target + kDistance * Vector3d(std::cos(kAbove) * std::cos(kBeside),
                                                        std::cos(kAbove) * std::sin(kBeside), std::sin(kAbove));
  const Vector3d view = (target - centre).normalized();
  const Vector3d right = view.cross(Vector3d::UnitZ()).normalized();
  Eigen::Matrix3d R_CW;
  R_CW.row(0) = right;
  R_CW.row(1) = view.cross(right);
  R_CW.row(2) = view;
  config.X_CW.linear() = R_CW;
  config.X_CW.translation() = -R_CW * centre;
  LaserSheet& sheet = config.sheet;
  sheet.normal_W = Vector3d(0, std::cos(sheet_tilt_rad), std::sin(sheet_tilt_rad));
  sheet.distance_mm = sheet_offset_mm;
  sheet.emitter_W = Vector3d(310, 0, 60);
  sheet.emitter_W.y() = (sheet_offset_mm - sheet.normal_W.z() * sheet.emitter_W.z()) / sheet.normal_W.y();
  return config;
}

Renderer::Renderer(Scene scene, const OpticsConfig& config)
    : scene_(std::move(scene)), config_(config), camera_(config.camera, config.X_CW) {
  const LaserSheet& sheet = config_.sheet;
  // The fan in steps of nearly two rows at 30 mm in front of the axis; cubics in between err by 1e-4 px.
  const double step = 0.22 * 1024 / config_.camera.height_px;
  double z = -15;
  while (z < scene_.z_max_mm() + 6) {
    Vector3d aim(30, 0, z);
    aim.y() = (sheet.distance_mm - sheet.normal_W.x() * aim.x() - sheet.normal_W.z() * z) / sheet.normal_W.y();
    fan_.push_back((aim - sheet.emitter_W).normalized());
    z += step;
  }
  const auto width = static_cast<std::size_t>(config_.camera.width_px),
             height = static_cast<std::size_t>(config_.camera.height_px);
  for (auto& beams : strand_.beams) beams.resize(fan_.size());
  signal_.assign(width * height, 0.F);
  lit_.assign(height, {});
  ambient_.assign(width * height, 0.F);
  mean_.assign(width + 16, 0.F);
  speckle_.assign(width + 16, 0.F);
  white_.assign(width + 32, 0.F);
  for (auto& plane : colour_) plane.assign(width + 16, 0);
}

void Renderer::place(const ObjectPose& pose, double camera_turn_rad) {
  if (pose == scene_.pose() && camera_turn_rad == camera_turn_rad_) return;
  scene_.set_pose(pose);
  camera_turn_rad_ = camera_turn_rad;
  const Eigen::Isometry3d turn(Eigen::AngleAxisd(camera_turn_rad, Vector3d::UnitY()));
  camera_ = VirtualCamera(config_.camera, turn * config_.X_CW);
  strand_is_current_ = ambient_ready_ = false;
}

double Renderer::across_mm(int k) const {
  constexpr int kMiddle = kAcross / 2;
  return (k - kMiddle) * 1.2 * std::max(config_.sheet.sigma_mm, 0.01);
}

double Renderer::angle_for_row(const Exposure& exposure, double row, double node) const {
  const double y = std::clamp(row, 0.0, config_.camera.height_px - 1.0);
  const double at =
      static_cast<double>(exposure.line_time_ns) * y + 0.5 * (node - 1) * static_cast<double>(exposure.exposure_ns);
  return exposure.motion.angle_rad(exposure.first_row_end_ns + std::llround(at));
}

// One ray of the sheet to where it meets the scene, and that point into the image. t_hint: the neighbour's t if known.
Renderer::Beam Renderer::trace(const Ray& ray_W, double angle_rad, double* t_hint) const {
  Beam beam;
  const double c = std::cos(angle_rad), s = std::sin(angle_rad);
  const Ray ray_T{turned(ray_W.p, c, -s), turned(ray_W.d, c, -s)};
  std::optional<Hit> hit;
  if (*t_hint > 0) hit = scene_.refine(ray_T, *t_hint);
  if (!hit) hit = scene_.intersect(ray_T);
  if (!hit) return beam;
  const Vector3d centre_T = turned(camera_.centre_W(), c, -s);
  const Vector3d to_camera = centre_T - hit->p;
  const double facing = -hit->normal.dot(ray_T.d);
  if (hit->normal.dot(to_camera) <= 0 || facing <= 0) return beam;
  const bool known_visible = *t_hint > 0;
  if (!known_visible && scene_.intersect({hit->p + 0.02 * hit->normal, to_camera}, 0, 1)) return beam;
  *t_hint = hit->t;
  const Vector3d p_W = turned(hit->p, c, s);
  const Eigen::Vector2d pixel = camera_.project(p_W);
  beam.x_px = pixel.x();
  beam.y_px = pixel.y();
  beam.p = p_W.cast<float>();
  beam.material = static_cast<std::int8_t>(hit->material);
  // A fan spreads in one direction: irradiance falls as 1 / distance.
  const double irradiance = facing * std::hypot(config_.sheet.emitter_W.x(), config_.sheet.emitter_W.y()) / hit->t;
  double reflectance = hit->material == Material::platter ? config_.platter_albedo : 1;
  if (config_.glaze > 0 && hit->material == Material::object) {
    const double gloss = std::max(0.0, hit->normal.dot((to_camera.normalized() - ray_T.d).normalized()));
    reflectance += config_.glaze * std::pow(gloss, config_.glaze_exponent);
  }
  beam.brightness = static_cast<float>(irradiance * reflectance);
  return beam;
}

void Renderer::trace_fan(const Exposure& exposure, double node, Strand& strand) const {
  constexpr int kMiddle = kAcross / 2;
  const double middle_row = 0.5 * (config_.camera.height_px - 1);
  const double middle_angle = angle_for_row(exposure, middle_row, node);
  const bool rows_differ = exposure.line_time_ns != 0 && !scene_.turns_invisibly() &&
                           std::abs(angle_for_row(exposure, 0, node) - angle_for_row(exposure, 1e9, node)) > 1e-9;
  for (std::size_t j = 0; j < fan_.size(); ++j) {
    const Ray middle{config_.sheet.emitter_W, fan_[j]};
    double t = 0, angle = middle_angle;
    Beam& centre = strand.beams[kMiddle][j];
    centre = trace(middle, angle, &t);
    if (rows_differ && centre.material >= 0) {
      // The row a point falls on sets its instant, the instant the angle, the angle (weakly) the row.
      angle = angle_for_row(exposure, centre.y_px, node);
      t = 0;
      centre = trace(middle, angle, &t);
    }
    for (int k = 0; k < kAcross; ++k) {
      if (k == kMiddle) continue;
      Beam& beam = strand.beams[static_cast<std::size_t>(k)][j];
      beam.material = -1;
      if (centre.material < 0) continue;
      double hint = centre.material == static_cast<std::int8_t>(Material::object) ? t : 0;
      beam = trace({config_.sheet.emitter_W + across_mm(k) * config_.sheet.normal_W, fan_[j]}, angle, &hint);
      if (beam.material != centre.material) beam.material = -1;
    }
  }
}

void Renderer::draw_line(const Exposure& exposure) {
  const int height = config_.camera.height_px, width = config_.camera.width_px;
  for (int y = 0; y < height; ++y) {
    Span& span = lit_[static_cast<std::size_t>(y)];
    float* row = &signal_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width)];
    std::fill(row + span.from, row + span.to, 0.F);
    span = {};
  }
  const std::int64_t last_end = exposure.first_row_end_ns + exposure.line_time_ns * (height - 1);
  if (exposure.motion.mean_power(exposure.first_row_end_ns - exposure.exposure_ns, last_end) < kBlackDark) return;
  if (scene_.turns_invisibly()) {
    if (!strand_is_current_) trace_fan(exposure, 0, strand_);
    strand_is_current_ = true;
    draw_strand(strand_, 1, exposure);
    return;
  }
  // Three-point Gauss rule over the exposure while the table turns.
  const double turned_by = std::abs(angle_for_row(exposure, 0, -1) - angle_for_row(exposure, 0, 1)) +
                           std::abs(angle_for_row(exposure, 1e9, -1) - angle_for_row(exposure, 1e9, 1));
  static constexpr std::array<std::pair<double, double>, 3> kGauss{
      {{-0.7745966692414834, 5.0 / 18}, {0, 8.0 / 18}, {0.7745966692414834, 5.0 / 18}}};
  if (turned_by < 1e-7) {
    trace_fan(exposure, 0, strand_);
    draw_strand(strand_, 1, exposure);
    return;
  }
  for (const auto& [node, weight] : kGauss) {
    trace_fan(exposure, node, strand_);
    draw_strand(strand_, weight, exposure);
  }
}

void Renderer::draw_strand(const Strand& strand, double weight, const Exposure& exposure) {
  constexpr auto kMiddle = static_cast<std::size_t>(kAcross / 2);
  const int height = config_.camera.height_px;
  const auto count = static_cast<int>(fan_.size());
  const auto joined = [&](const std::vector<Beam>& b, int i, int j) {
    if (i < 0 || j < 0 || i >= count || j >= count) return false;
    const Beam &p = b[static_cast<std::size_t>(i)], &q = b[static_cast<std::size_t>(j)];
    return p.material >= 0 && p.material == q.material && (p.p - q.p).squaredNorm() < 16.F && p.y_px != q.y_px;
  };
  const auto brackets = [&](const std::vector<Beam>& b, int i, double y) {
    if (!joined(b, i, i + 1)) return false;
    const double y0 = b[static_cast<std::size_t>(i)].y_px, y1 = b[static_cast<std::size_t>(i + 1)].y_px;
    return (y >= y0 && y < y1) || (y <= y0 && y > y1);
  };
  const double levels = config_.line_levels * 0.25 / std::max(config_.sheet.sigma_mm, 1e-9) *
                        static_cast<double>(exposure.exposure_ns) / static_cast<double>(config_.reference_exposure_ns);
  const double power_of_all =
      exposure.motion.mean_power(exposure.first_row_end_ns - exposure.exposure_ns, exposure.first_row_end_ns);
  for (int i = 0; i + 1 < count; ++i) {
    if (!joined(strand.beams[kMiddle], i, i + 1)) continue;
    const double ya = strand.beams[kMiddle][static_cast<std::size_t>(i)].y_px;
    const double yb = strand.beams[kMiddle][static_cast<std::size_t>(i + 1)].y_px;
    const int first_row = std::max(0, static_cast<int>(std::ceil(std::min(ya, yb))));
    const int last_row = std::min(height - 1, static_cast<int>(std::floor(std::max(ya, yb))));
    for (int y = first_row; y <= last_row; ++y) {
      if (!brackets(strand.beams[kMiddle], i, y)) continue;
      std::array<double, kAcross> x{}, brightness{};
      std::array<bool, kAcross> have{};
      for (std::size_t k = 0; k < kAcross; ++k) {
        const std::vector<Beam>& b = strand.beams[k];
        int at = -1;
        for (int step = 0; step <= 6 && at < 0; ++step) {  // other places across the sheet meet the row nearby
          if (brackets(b, i - step, y))
            at = i - step;
          else if (brackets(b, i + step, y))
            at = i + step;
        }
        if (at < 0) continue;
        const int from = joined(b, at - 1, at) ? at - 1 : at, to = joined(b, at + 1, at + 2) ? at + 2 : at + 1;
        std::array<double, 4> ys{}, xs{}, bs{};
        for (int m = from; m <= to; ++m) {
          const Beam& beam = b[static_cast<std::size_t>(m)];
          const auto n = static_cast<std::size_t>(m - from);
          ys[n] = beam.y_px;
          xs[n] = beam.x_px;
          bs[n] = static_cast<double>(beam.brightness);
        }
        x[k] = lagrange(ys.data(), xs.data(), to - from + 1, y);
        brightness[k] = lagrange(ys.data(), bs.data(), to - from + 1, y);
        have[k] = true;
      }
      // The run of traced places around the middle along which x rises or falls strictly.
      int first = static_cast<int>(kMiddle), last = first;
      if (!have[kMiddle]) continue;
      const auto usable = [&](int k, int next) {
        if (!have[static_cast<std::size_t>(next)]) return false;
        const double step = (x[static_cast<std::size_t>(next)] - x[static_cast<std::size_t>(k)]) * (next - k);
        const double sense = have[kMiddle + 1] ? x[kMiddle + 1] - x[kMiddle] : x[kMiddle] - x[kMiddle - 1];
        return step * sense > 0;
      };
      while (first > 0 && usable(first, first - 1)) --first;
      while (last + 1 < kAcross && usable(last, last + 1)) ++last;
      if (first == last) continue;
      const double power =
          exposure.line_time_ns == 0
              ? power_of_all
              : exposure.motion.mean_power(exposure.first_row_end_ns - exposure.exposure_ns + y * exposure.line_time_ns,
                                           exposure.first_row_end_ns + y * exposure.line_time_ns);
      draw_row(y, x, brightness, first, last, levels * power * weight);
    }
  }
}

// Each pixel of the row looks at its own place s(x) across the sheet: irradiance e^(-s^2 / 2 sigma^2), incidence and
// reflectance of that place. Blur by Laplace's method: s linearised where most of the pixel's light comes from, sigma^2
// grown by (ds/dx blur)^2; exact where s is linear over the blur.
void Renderer::draw_row(int row, const std::array<double, kAcross>& x, const std::array<double, kAcross>& brightness,
                        int first, int last, double scale) {
  const int n = last - first + 1, middle = kAcross / 2;
  const double origin = x[middle];
  std::array<float, kAcross> node{}, c{};
  {
    std::array<double, kAcross> d{}, u{};
    for (int i = 0; i < n; ++i) {
      u[static_cast<std::size_t>(i)] = x[static_cast<std::size_t>(first + i)] - origin;
      d[static_cast<std::size_t>(i)] = across_mm(first + i);
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
  const double slope_mm_per_px =
      (across_mm(last) - across_mm(first)) / (x[static_cast<std::size_t>(last)] - x[static_cast<std::size_t>(first)]);
  const double sigma = config_.sheet.sigma_mm;
  const double sigma_px =
      std::sqrt(sigma * sigma / (slope_mm_per_px * slope_mm_per_px) + config_.blur_px * config_.blur_px);
  const double reach = 5.5 * sigma_px;
  const int width = config_.camera.width_px;
  const int from = std::max(0, static_cast<int>(std::floor(origin - reach)));
  const int to = std::min(width, static_cast<int>(std::ceil(origin + reach)) + 1);
  if (from >= to) return;
  Span& span = lit_[static_cast<std::size_t>(row)];
  span = span.from == span.to ? Span{from, to} : Span{std::min(span.from, from), std::max(span.to, to)};
  const float low = std::min(node[0], node[static_cast<std::size_t>(n - 1)]);
  const float high = std::max(node[0], node[static_cast<std::size_t>(n - 1)]);
  const auto b0 = static_cast<float>(brightness[static_cast<std::size_t>(middle)] * scale * sigma);
  // Brightness across the sheet: linear between the ends is enough, its square term is below 1e-4.
  const auto b1 =
      static_cast<float>((brightness[static_cast<std::size_t>(last)] - brightness[static_cast<std::size_t>(first)]) *
                         scale * sigma / (x[static_cast<std::size_t>(last)] - x[static_cast<std::size_t>(first)]));
  const auto variance = static_cast<float>(sigma * sigma),
             blur2 = static_cast<float>(config_.blur_px * config_.blur_px);
  float* out = &signal_[static_cast<std::size_t>(row) * static_cast<std::size_t>(width)];
  const auto shift = static_cast<float>(from - origin);
  // Light that blur brings to column u comes mostly from this share of u: all of it for a thick sheet, none for a thin
  // one.
  const auto share = static_cast<float>(
      sigma * sigma / (sigma * sigma + slope_mm_per_px * slope_mm_per_px * config_.blur_px * config_.blur_px));
  for (int i = from; i < to; ++i) {
    const float u = shift + static_cast<float>(i - from);
    const float source = std::min(std::max(u * share, low), high);
    float s = c[static_cast<std::size_t>(n - 1)], slope = 0;
    for (int m = n - 2; m >= 0; --m) {
      const float step = source - node[static_cast<std::size_t>(m)];
      slope = slope * step + s;
      s = s * step + c[static_cast<std::size_t>(m)];
    }
    s += slope * (u - source);
    const float spread = variance + slope * slope * blur2;
    const float b = std::max(0.F, b0 + b1 * source);
    out[i] += b / std::sqrt(spread) * exp_minus(0.5F * s * s / spread);
  }
  if (config_.reflection > 0)
    draw_reflection(
        row, origin, sigma_px,
        brightness[static_cast<std::size_t>(middle)] * scale * sigma /
            std::sqrt(sigma * sigma + slope_mm_per_px * slope_mm_per_px * config_.blur_px * config_.blur_px));
}

// A stray copy of the line, twice as wide, beside it over part of the rows: light that came by way of the enclosure.
void Renderer::draw_reflection(int row, double x_px, double sigma_px, double peak) {
  const double at = static_cast<double>(row) / config_.camera.height_px, s = config_.camera.height_px / 1024.0;
  if (at < 0.38 || at > 0.66) return;
  const double fade = std::sin(std::numbers::pi * (at - 0.38) / 0.28);
  const double centre = x_px + s * (85 + 30 * std::sin(9 * at));
  const double sigma = 2 * sigma_px;
  const int width = config_.camera.width_px;
  const int from = std::max(0, static_cast<int>(std::floor(centre - 4 * sigma)));
  const int to = std::min(width, static_cast<int>(std::ceil(centre + 4 * sigma)) + 1);
  if (from >= to) return;
  Span& span = lit_[static_cast<std::size_t>(row)];
  span = {std::min(span.from, from), std::max(span.to, to)};
  const auto amplitude = static_cast<float>(config_.reflection * peak * fade),
             inverse = static_cast<float>(0.5 / (sigma * sigma));
  float* out = &signal_[static_cast<std::size_t>(row) * static_cast<std::size_t>(width)];
  for (int i = from; i < to; ++i) {
    const auto u = static_cast<float>(i - centre);
    out[i] += amplitude * exp_minus(u * u * inverse);
  }
}

// Room light: a gradient over the background, and the object and platter shaded by a broad lamp above the camera.
void Renderer::update_ambient(double angle_rad) {
  const long cell = scene_.turns_invisibly() ? 0 : std::lround(angle_rad / kAmbientCell_rad);
  if (ambient_ready_ && cell == ambient_cell_) return;
  ambient_cell_ = cell;
  ambient_ready_ = true;
  const double angle = static_cast<double>(cell) * kAmbientCell_rad, c = std::cos(angle), s = std::sin(angle);
  const int width = config_.camera.width_px, height = config_.camera.height_px;
  const int columns = (width + kAmbientBlock - 1) / kAmbientBlock + 1,
            rows = (height + kAmbientBlock - 1) / kAmbientBlock + 1;
  const Vector3d lamp = Vector3d(0.35, 0.55, 0.75).normalized(), centre_T = turned(camera_.centre_W(), c, -s);
  std::vector<float> grid(static_cast<std::size_t>(columns * rows));
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const double fx = std::min(1.0, static_cast<double>(i * kAmbientBlock) / width),
                   fy = std::min(1.0, static_cast<double>(j * kAmbientBlock) / height);
      double level = config_.ambient_low + (config_.ambient_high - config_.ambient_low) * (0.7 * fx + 0.3 * (1 - fy)) +
                     0.08 * config_.ambient_high * std::sin(9 * fx + 1) * std::sin(6 * fy);
      const Vector3d d_T = turned(camera_.ray_W(i * kAmbientBlock, j * kAmbientBlock), c, -s);
      if (const auto hit = scene_.intersect({centre_T, d_T})) {
        const double lit = std::max(0.0, hit->normal.dot(turned(lamp, c, -s)));
        const double albedo = hit->material == Material::platter ? config_.platter_albedo : 1;
        level = config_.object_ambient * albedo * (0.3 + 0.7 * lit);
      }
      grid[static_cast<std::size_t>(j * columns + i)] = static_cast<float>(std::max(0.0, level));
    }
  }
  // The lamp is broad and the room out of focus: edges of room light are soft.
  std::vector<float> soft = grid;
  for (int j = 1; j + 1 < rows; ++j) {
    for (int i = 1; i + 1 < columns; ++i) {
      const float* g = &grid[static_cast<std::size_t>(j * columns + i)];
      soft[static_cast<std::size_t>(j * columns + i)] =
          0.25F * g[0] + 0.125F * (g[-1] + g[1] + g[-columns] + g[columns]) +
          0.0625F * (g[-columns - 1] + g[-columns + 1] + g[columns - 1] + g[columns + 1]);
    }
  }
  for (int y = 0; y < height; ++y) {
    const int j = y / kAmbientBlock;
    const float fy = static_cast<float>(y % kAmbientBlock) / kAmbientBlock;
    const float *above = &soft[static_cast<std::size_t>(j * columns)], *below = above + columns;
    float* out = &ambient_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width)];
    for (int x = 0; x < width; ++x) {
      const int i = x / kAmbientBlock;
      const float fx = static_cast<float>(x % kAmbientBlock) / kAmbientBlock;
      const float a = above[i] + fx * (above[i + 1] - above[i]), b = below[i] + fx * (below[i + 1] - below[i]);
      out[x] = a + fy * (b - a);
    }
  }
}

// speckle_[from..to): gamma of mean 1 and the wanted contrast from Gaussians smoothed over 3 x 3 pixels (0.2, 0.6,
// 0.2), by the cube of Wilson and Hilferty (shape 1 / contrast^2).
void Renderer::speckle_row(const RandomKey& key, int row, int from, int to) {
  const auto stride = static_cast<std::uint32_t>(config_.camera.width_px + 2);
  const auto n = static_cast<std::size_t>(to - from);
  std::fill(speckle_.begin(), speckle_.begin() + static_cast<std::ptrdiff_t>(n), 0.F);
  for (int dy = 0; dy < 3; ++dy) {
    const std::uint32_t first = static_cast<std::uint32_t>(row + dy) * stride + static_cast<std::uint32_t>(from);
    gaussian_row(key, first, n + 2, white_.data());
    const float wy = dy == 1 ? 0.6F / 0.44F : 0.2F / 0.44F;  // 0.44 = sum of the squared weights
    for (std::size_t i = 0; i < n; ++i) speckle_[i] += wy * (0.2F * (white_[i] + white_[i + 2]) + 0.6F * white_[i + 1]);
  }
  const double k = 1 / (config_.speckle_contrast * config_.speckle_contrast);
  const auto a = static_cast<float>(1 - 1 / (9 * k)), b = static_cast<float>(1 / (3 * std::sqrt(k)));
  for (std::size_t i = 0; i < n; ++i) {
    const float g = std::max(0.F, a + b * speckle_[i]);
    speckle_[i] = g * g * g;
  }
}

void Renderer::render_line(const Exposure& exposure, std::vector<float>& levels) {
  draw_line(exposure);
  levels = signal_;
}

void Renderer::render(const Exposure& exposure, std::span<std::uint8_t> out, std::size_t stride_bytes) {
  const int width = config_.camera.width_px, height = config_.camera.height_px;
  const auto columns = static_cast<std::size_t>(width);
  draw_line(exposure);
  const double angle = angle_for_row(exposure, 0.5 * height, 0);
  update_ambient(angle);
  const RandomKey speckle_key =
      make_key(exposure.seed, kSpecklePurpose, static_cast<std::uint64_t>(std::llround(angle / kSpeckleCell_rad)));
  const RandomKey pixel_key = make_key(exposure.seed, kPixelPurpose, exposure.frame);
  const auto room = static_cast<float>(exposure.ambient_factor * static_cast<double>(exposure.exposure_ns) /
                                       static_cast<double>(config_.reference_exposure_ns));
  for (int y = 0; y < height; ++y) {
    const std::size_t at = static_cast<std::size_t>(y) * columns;
    const Span span = lit_[static_cast<std::size_t>(y)];
    const auto lit_from = static_cast<std::size_t>(span.from), lit_to = static_cast<std::size_t>(span.to);
    if (span.from < span.to && config_.speckle_contrast > 0) speckle_row(speckle_key, y, span.from, span.to);
    const auto laser = [&](std::size_t x) {
      return signal_[at + x] * (config_.speckle_contrast > 0 ? speckle_[x - lit_from] : 1.F);
    };
    const float* ambient = &ambient_[at];
    std::uint8_t* row = out.data() + static_cast<std::size_t>(y) * stride_bytes;
    if (config_.format == PixelFormat::grey8) {
      for (std::size_t x = 0; x < columns; ++x) mean_[x] = ambient[x] * room;
      for (std::size_t x = lit_from; x < lit_to; ++x) mean_[x] += laser(x);
      expose_row(mean_.data(), columns, config_.noise, pixel_key, static_cast<std::uint32_t>(at), row);
      continue;
    }
    // A red laser through a colour sensor; warm room light. Full-range BT.601, chroma shared by pixel pairs.
    static constexpr std::array<float, 3> kRoom{1.F, 0.9F, 0.8F}, kLaser{1.F, 0.15F, 0.04F};
    for (std::size_t c = 0; c < 3; ++c) {
      for (std::size_t x = 0; x < columns; ++x) mean_[x] = ambient[x] * room * kRoom[c];
      for (std::size_t x = lit_from; x < lit_to; ++x) mean_[x] += laser(x) * kLaser[c];
      expose_row(mean_.data(), columns, config_.noise, pixel_key, static_cast<std::uint32_t>(3 * at + c * columns),
                 colour_[c].data());
    }
    const auto byte = [](int v) { return static_cast<std::uint8_t>(std::clamp(v, 0, 255)); };
    for (std::size_t x = 0; x + 1 < columns; x += 2) {
      const int r0 = colour_[0][x], g0 = colour_[1][x], b0 = colour_[2][x];
      const int r1 = colour_[0][x + 1], g1 = colour_[1][x + 1], b1 = colour_[2][x + 1];
      const int y0 = 19595 * r0 + 38470 * g0 + 7471 * b0, y1 = 19595 * r1 + 38470 * g1 + 7471 * b1;
      const int r = r0 + r1, g = g0 + g1, b = b0 + b1;
      row[2 * x] = byte((y0 + 32768) >> 16);
      row[2 * x + 1] = byte((-11059 * r - 21709 * g + 32768 * b + (257 << 16) - (1 << 16) + 65536) >> 17);
      row[2 * x + 2] = byte((y1 + 32768) >> 16);
      row[2 * x + 3] = byte((32768 * r - 27439 * g - 5329 * b + (257 << 16) - (1 << 16) + 65536) >> 17);
    }
  }
}

}  // namespace celadon::sim
