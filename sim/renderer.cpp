#include "sim/renderer.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr std::uint64_t kPixelPurpose = 1, kSpecklePurpose = 2;
constexpr double kSpeckleCell_rad = 2e-4;  // a table turned by more shows another speckle pattern
constexpr double kBlackDark = 1e-6;
constexpr double kSmallTurn_rad = 0.02;  // over an exposure: what is visible in its middle is so all the time
constexpr double kNoSmear_px = 0.1;      // takes 0.2 % off the peak of a line of 1.5 px

// Numbers the cells in which the pattern stays.
std::uint64_t speckle_cell(const Posture& posture) {
  const auto cell = [](double rad) { return static_cast<std::uint64_t>(std::llround(rad / kSpeckleCell_rad)); };
  return cell(posture.table_rad) + 1'000'003 * cell(posture.elevation_rad) + 2'000'029 * cell(posture.lift_mm / 60);
}

}  // namespace

Renderer::Renderer(Scene scene, const OpticsConfig& config)
    : scene_(std::move(scene)), config_(config), camera_(config.camera, config.X_CW), picture_(config), room_(config) {
  aim_lasers();
  const auto width = static_cast<std::size_t>(config_.camera.width_px);
  mean_.assign(width + 16, 0.F);
  speckle_.assign(width + 16, 0.F);
  white_.assign(width + 32, 0.F);
  for (auto& plane : colour_) plane.assign(width + 16, 0);
}

void Renderer::aim_lasers() {
  lines_.clear();
  lines_.push_back({LaserFan(config_, config_.sheet, scene_), {}, false});
  if (config_.second_sheet) lines_.push_back({LaserFan(config_, *config_.second_sheet, scene_), {}, false});
}

void Renderer::put(const Scene& scene) {
  scene_ = scene;
  aim_lasers();
  room_.forget();
}

void Renderer::place(const ObjectPose& pose, double camera_turn_rad) {
  if (pose == scene_.pose() && camera_turn_rad == camera_turn_rad_) return;
  scene_.set_pose(pose);
  camera_turn_rad_ = camera_turn_rad;
  const Eigen::Isometry3d turn(Eigen::AngleAxisd(camera_turn_rad, Vector3d::UnitY()));
  camera_ = VirtualCamera(config_.camera, turn * config_.X_CW);
  for (Line& line : lines_) line.is_current = false;
  room_.forget();
}

void Renderer::draw_lasers(const Exposure& exposure) {
  picture_.clear();
  const std::int64_t begin = exposure.first_row_end_ns - exposure.exposure_ns;
  const std::int64_t last_end = exposure.first_row_end_ns + exposure.line_time_ns * (config_.camera.height_px - 1);
  for (std::size_t i = 0; i < lines_.size(); ++i) {
    const int laser = static_cast<int>(i);
    if (exposure.motion.mean_power(begin, last_end, laser) >= kBlackDark) draw_line(lines_[i], laser, exposure);
  }
}

void Renderer::draw_line(Line& line, int laser, const Exposure& exposure) {
  const LaserFan& fan = line.fan;
  const int last_row = config_.camera.height_px - 1;
  const bool invisibly = fan.turns_invisibly(scene_);
  const auto moved = [&](double row) {
    return apart_rad(exposure.posture_at(row, -1), exposure.posture_at(row, 1), !invisibly);
  };
  // In the first row and in the last; while they are not exposed at once, from the one to the other.
  double moved_by = moved(0) + moved(last_row);
  if (invisibly) moved_by += apart_rad(exposure.posture_at(0, 0), exposure.posture_at(last_row, 0), false);
  if (invisibly && moved_by == 0) {
    const Posture posture = exposure.posture_at(0, 0);
    if (!line.is_current || apart_rad(posture, line.posture, false) != 0)
      fan.trace(scene_, camera_, exposure, 0, line.strand);
    line.is_current = true;
    line.posture = posture;
    picture_.draw(line.strand, laser, 1, exposure);
    return;
  }
  line.is_current = false;
  fan.trace(scene_, camera_, exposure, 0, line.strand);
  // Three-point Gauss rule over the exposure while an axis moves; a line that hardly moves looks as in its middle.
  constexpr double kGaussNode = 0.7745966692414834;
  if (moved_by < 1e-7 ||
      (moved_by < kSmallTurn_rad && fan.shift_px(scene_, camera_, exposure, kGaussNode, line.strand) < kNoSmear_px)) {
    picture_.draw(line.strand, laser, 1, exposure);
    return;
  }
  for (const double node : {-kGaussNode, 0.0, kGaussNode}) {
    if (node == 0) {
      picture_.draw(line.strand, laser, 8.0 / 18, exposure);
      continue;
    }
    if (moved_by < kSmallTurn_rad) {
      fan.trace_near(scene_, camera_, exposure, node, line.strand, moved_);
    } else {
      fan.trace(scene_, camera_, exposure, node, moved_);
    }
    picture_.draw(moved_, laser, 5.0 / 18, exposure);
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
  draw_lasers(exposure);
  levels = picture_.levels();
}

void Renderer::render(const Exposure& exposure, std::span<std::uint8_t> out, std::size_t stride_bytes) {
  const int width = config_.camera.width_px, height = config_.camera.height_px;
  const auto columns = static_cast<std::size_t>(width);
  draw_lasers(exposure);
  const Posture posture = exposure.posture_at(0.5 * height, 0);
  room_.update(scene_, camera_, exposure);
  const RandomKey speckle_key = make_key(exposure.seed, kSpecklePurpose, speckle_cell(posture));
  const RandomKey pixel_key = make_key(exposure.seed, kPixelPurpose, exposure.frame);
  const auto room = static_cast<float>(exposure.ambient_factor * static_cast<double>(exposure.exposure_ns) /
                                       static_cast<double>(config_.reference_exposure_ns));
  const std::vector<float>& signal = picture_.levels();
  for (int y = 0; y < height; ++y) {
    const std::size_t at = static_cast<std::size_t>(y) * columns;
    const LinePicture::Span span = picture_.lit(y);
    const auto lit_from = static_cast<std::size_t>(span.from), lit_to = static_cast<std::size_t>(span.to);
    if (span.from < span.to && config_.speckle_contrast > 0) speckle_row(speckle_key, y, span.from, span.to);
    const auto laser = [&](std::size_t x) {
      return signal[at + x] * (config_.speckle_contrast > 0 ? speckle_[x - lit_from] : 1.F);
    };
    const float* ambient = &room_.levels()[at];
    std::uint8_t* row = out.data() + static_cast<std::size_t>(y) * stride_bytes;
    if (config_.format == PixelFormat::grey8) {
      const auto expose = [&](const float* levels, float factor, std::size_t from, std::size_t to) {
        if (from < to) {
          expose_row(levels, factor, to - from, config_.noise, pixel_key, static_cast<std::uint32_t>(at + from),
                     row + from);
        }
      };
      for (std::size_t x = lit_from; x < lit_to; ++x) mean_[x] = ambient[x] * room + laser(x);
      expose(ambient, room, 0, lit_from);
      expose(&mean_[lit_from], 1, lit_from, lit_to);
      expose(ambient + lit_to, room, lit_to, columns);
      continue;
    }
    // A red laser through a colour sensor; warm room light. Full-range BT.601, chroma shared by pixel pairs.
    static constexpr std::array<float, 3> kLaser{1.F, 0.15F, 0.04F};
    for (std::size_t c = 0; c < 3; ++c) {
      const float* const light = &room_.levels(c)[at];
      for (std::size_t x = 0; x < columns; ++x) mean_[x] = light[x] * room * kRoomColour[c];
      for (std::size_t x = lit_from; x < lit_to; ++x) mean_[x] += laser(x) * kLaser[c];
      expose_row(mean_.data(), 1, columns, config_.noise, pixel_key, static_cast<std::uint32_t>(3 * at + c * columns),
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
