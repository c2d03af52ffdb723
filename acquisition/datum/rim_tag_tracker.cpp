#include "acquisition/datum/rim_tag_tracker.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

namespace celadon {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kCornersAt = 1;     // of the black square, tag coordinates
constexpr double kLeastSide_px = 8;  // two cells a pixel tell nothing
constexpr int kMargin_px = 2;        // of the patch about the white border
constexpr int kSearch_px = 24, kSearchStep_px = 2;
constexpr std::size_t kFramesToSearch = 16;
constexpr double kConverged_px = 0.03, kLargestStep_px = 3;
constexpr int kMostSteps = 6;
constexpr double kLeastContrast = 8;       // in its standard deviations
constexpr double kLeastCorrelation = 0.3;  // of a search, which has many tries
constexpr double kOfStrongest = 0.5;
constexpr double kQuarterShare = 0.5, kQuarterSigmas = 3;
constexpr std::array<std::array<double, 2>, 4> kTagCorners{{{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}};

/// H with q ~ H p for four points.
Eigen::Matrix3d homography(const std::array<Vector2d, 4>& p, const std::array<Vector2d, 4>& q) {
  Eigen::Matrix<double, 8, 8> A = Eigen::Matrix<double, 8, 8>::Zero();
  Eigen::Matrix<double, 8, 1> b;
  for (Eigen::Index k = 0; k < 4; ++k) {
    const Vector2d& from = p[static_cast<std::size_t>(k)];
    const Vector2d& to = q[static_cast<std::size_t>(k)];
    A.row(2 * k) << from.x(), from.y(), 1, 0, 0, 0, -to.x() * from.x(), -to.x() * from.y();
    A.row(2 * k + 1) << 0, 0, 0, from.x(), from.y(), 1, -to.y() * from.x(), -to.y() * from.y();
    b.segment<2>(2 * k) = to;
  }
  const Eigen::Matrix<double, 8, 1> h = A.partialPivLu().solve(b);
  Eigen::Matrix3d H;
  H << h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1;
  return H;
}

Vector3d turned(const Vector3d& p, double angle_rad) {
  return Eigen::AngleAxisd(angle_rad, Vector3d::UnitZ()) * p;
}

}  // namespace

Vector3d tag_middle_C(const Calibration& calibration, const RimTag& tag, double angle_rad) {
  Vector3d middle = Vector3d::Zero();
  for (const Vector3d& corner : tag.corners_mm) middle += corner / 4;
  return calibration.axis.X_CW * (turned(middle, angle_rad) / calibration.scale.value);
}

RimTagTracker::RimTagTracker(const Calibration& calibration)
    : calibration_(calibration),
      lens_(calibration.camera_model),
      last_px_(calibration.rim_tags.size(), Vector2d::Zero()),
      known_(calibration.rim_tags.size(), false) {
  for (const RimTag& tag : calibration.rim_tags) pictures_.emplace_back(tag.number);
}

Vector2d RimTagTracker::shift_by_angle(std::size_t tag, double angle_rad) const {
  constexpr double kSmall = 1e-3;
  const auto at = [&](double angle) {
    const Vector3d p = tag_middle_C(calibration_, calibration_.rim_tags[tag], angle);
    return lens_.project(p.x() / p.z(), p.y() / p.z());
  };
  return (at(angle_rad + kSmall) - at(angle_rad - kSmall)) / (2 * kSmall);
}

std::optional<RimTagTracker::Place> RimTagTracker::place(std::size_t tag, const std::function<double(double)>& angle_at,
                                                         double ahead_rad) const {
  const RimTag& rim_tag = calibration_.rim_tags[tag];
  const int width = calibration_.camera_model.width_px, height = calibration_.camera_model.height_px;
  const auto project = [&](const Vector3d& p_C) -> std::optional<Vector2d> {
    if (!(p_C.z() > 1)) return std::nullopt;
    return lens_.project(p_C.x() / p_C.z(), p_C.y() / p_C.z());
  };
  Place out;
  double row = 0.5 * height;
  for (int round = 0; round < 2; ++round) {  // the row tells the instant, that the angle, that the row
    out.angle_rad = angle_at(row);
    const auto expected = project(tag_middle_C(calibration_, rim_tag, out.angle_rad)),
               middle = project(tag_middle_C(calibration_, rim_tag, out.angle_rad + ahead_rad));
    if (!expected || !middle) return std::nullopt;
    out.expected_px = *expected;
    out.middle_px = *middle;
    row = std::clamp(middle->y(), 0., height - 1.);
  }
  std::array<Vector2d, 4> at, in_tag;
  for (std::size_t k = 0; k < 4; ++k) {
    const auto corner = project(calibration_.axis.X_CW *
                                (turned(rim_tag.corners_mm[k], out.angle_rad + ahead_rad) / calibration_.scale.value));
    if (!corner) return std::nullopt;
    at[k] = *corner - out.middle_px;
    in_tag[k] = Vector2d(kCornersAt * kTagCorners[k][0], kCornersAt * kTagCorners[k][1]);
  }
  double least_side = INFINITY, reach_x = 0, reach_y = 0;
  for (std::size_t k = 0; k < 4; ++k) {
    least_side = std::min(least_side, (at[(k + 1) % 4] - at[k]).norm());
    reach_x = std::max(reach_x, std::abs(at[k].x()));
    reach_y = std::max(reach_y, std::abs(at[k].y()));
  }
  if (!(least_side >= kLeastSide_px)) return std::nullopt;
  out.half_width_px = static_cast<int>(std::ceil(TagPicture::kBorder * reach_x)) + kMargin_px;
  out.half_height_px = static_cast<int>(std::ceil(TagPicture::kBorder * reach_y)) + kMargin_px;
  if (out.middle_px.x() < out.half_width_px || out.middle_px.x() > width - 1 - out.half_width_px ||
      out.middle_px.y() < out.half_height_px || out.middle_px.y() > height - 1 - out.half_height_px) {
    return std::nullopt;
  }
  out.to_tag = homography(at, in_tag);
  return out;
}

// White at each pixel of the patch about the shifted tag's nearest whole pixel.
void RimTagTracker::fill(std::size_t tag, const Place& place, const Vector2d& shift_px, Patch& patch) const {
  patch.width = 2 * place.half_width_px + 1;
  patch.height = 2 * place.half_height_px + 1;
  patch.white.resize(static_cast<std::size_t>(patch.width) * static_cast<std::size_t>(patch.height));
  const Vector2d to = place.middle_px + shift_px, origin(std::round(to.x()), std::round(to.y()));
  const Vector2d off = origin - to;
  const TagPicture& picture = pictures_[tag];
  const Eigen::Matrix3d& H = place.to_tag;
  const auto white = [&](double x, double y) {
    const double w = 1 / (H(2, 0) * x + H(2, 1) * y + H(2, 2));
    return picture.white((H(0, 0) * x + H(0, 1) * y + H(0, 2)) * w, (H(1, 0) * x + H(1, 1) * y + H(1, 2)) * w);
  };
  std::size_t k = 0;
  for (int j = -place.half_height_px; j <= place.half_height_px; ++j) {
    for (int i = -place.half_width_px; i <= place.half_width_px; ++i) {
      const double x = i + off.x(), y = j + off.y();
      patch.white[k++] = 0.25 * (white(x - 0.25, y - 0.25) + white(x + 0.25, y - 0.25) + white(x - 0.25, y + 0.25) +
                                 white(x + 0.25, y + 0.25));
    }
  }
}

std::optional<TagSighting> RimTagTracker::align(std::size_t tag, const Place& place, const CameraMode& mode,
                                                std::span<const std::uint8_t> bytes, Vector2d shift) {
  const std::size_t step = bytes_per_pixel(mode.format);
  for (int round = 0; round < kMostSteps; ++round) {
    const int x0 = static_cast<int>(std::round(place.middle_px.x() + shift.x())) - place.half_width_px,
              y0 = static_cast<int>(std::round(place.middle_px.y() + shift.y())) - place.half_height_px;
    if (x0 < 0 || y0 < 0 || x0 + 2 * place.half_width_px >= mode.width_px ||
        y0 + 2 * place.half_height_px >= mode.height_px) {
      return std::nullopt;
    }
    fill(tag, place, shift, patch_);
    const int width = patch_.width;
    // level ~ black + contrast * white - (contrast * shift) . gradient
    Eigen::Matrix4d N = Eigen::Matrix4d::Zero();
    Eigen::Vector4d b = Eigen::Vector4d::Zero();
    double square = 0;
    std::array<std::array<double, 5>, 4> quarter{};  // n, w, ww, I, wI
    double n = 0;
    const Eigen::Matrix3d& H = place.to_tag;
    for (int j = 1; j + 1 < patch_.height; ++j) {
      const std::uint8_t* const row =
          bytes.data() + static_cast<std::size_t>(y0 + j) * mode.stride_bytes + static_cast<std::size_t>(x0) * step;
      const double* const w = patch_.white.data() + static_cast<std::ptrdiff_t>(j) * width;
      const double y = j - place.half_height_px;
      for (int i = 1; i + 1 < width; ++i) {
        const double x = i - place.half_width_px;
        const double depth = 1 / (H(2, 0) * x + H(2, 1) * y + H(2, 2));
        const double u = (H(0, 0) * x + H(0, 1) * y + H(0, 2)) * depth,
                     v = (H(1, 0) * x + H(1, 1) * y + H(1, 2)) * depth;
        if (std::abs(u) > TagPicture::kBorder || std::abs(v) > TagPicture::kBorder) continue;
        const double level = row[static_cast<std::size_t>(i) * step];
        const Eigen::Vector4d a(1, w[i], -0.5 * (w[i + 1] - w[i - 1]), -0.5 * (w[i + width] - w[i - width]));
        N.selfadjointView<Eigen::Lower>().rankUpdate(a);
        b += level * a;
        square += level * level;
        n += 1;
        auto& q = quarter[(u > 0 ? 1U : 0U) + (v > 0 ? 2U : 0U)];
        q[0] += 1, q[1] += w[i], q[2] += w[i] * w[i], q[3] += level, q[4] += w[i] * level;
      }
    }
    if (n < 40) return std::nullopt;
    const Eigen::Matrix4d full = N.selfadjointView<Eigen::Lower>();
    const Eigen::LDLT<Eigen::Matrix4d> solver(full);
    if (!(solver.vectorD().minCoeff() > 1e-9 * n)) return std::nullopt;
    const Eigen::Vector4d s = solver.solve(b);
    const double contrast = s[1], variance = std::max((square - s.dot(b)) / (n - 4), 1. / 12);
    const Eigen::Matrix4d C = variance * solver.solve(Eigen::Matrix4d::Identity());
    if (!(contrast > kLeastContrast * std::sqrt(C(1, 1)))) return std::nullopt;
    const bool weak = contrast < kOfStrongest * strongest_;
    const Vector2d by = s.tail<2>() / contrast;
    if (!(by.norm() <= kLargestStep_px)) return std::nullopt;
    shift += by;
    if (by.norm() > kConverged_px) continue;
    if (weak) return std::nullopt;
    for (const auto& [count, w, ww, I, wI] : quarter) {
      const double spread = ww - w * w / std::max(count, 1.);
      if (!(spread > 0)) return std::nullopt;
      const double of_quarter = (wI - w * I / count) / spread;
      if (of_quarter < kQuarterShare * contrast - kQuarterSigmas * std::sqrt(variance / spread)) return std::nullopt;
    }
    strongest_ = std::max(strongest_, contrast);
    TagSighting out{tag, place.angle_rad, place.middle_px + shift - place.expected_px, {}};
    out.information = (C.bottomRightCorner<2, 2>() / (contrast * contrast)).inverse();
    return out;
  }
  return std::nullopt;
}

// The shift of best correlation about where the tag should be.
std::optional<Vector2d> RimTagTracker::search(std::size_t tag, const Place& place, const CameraMode& mode,
                                              std::span<const std::uint8_t> bytes) {
  fill(tag, place, Vector2d::Zero(), patch_);
  const std::size_t step = bytes_per_pixel(mode.format);
  double w = 0, ww = 0;
  for (const double white : patch_.white) w += white, ww += white * white;
  const auto n = static_cast<double>(patch_.white.size());
  const double spread_w = ww - w * w / n;
  const int x0 = static_cast<int>(std::round(place.middle_px.x())) - place.half_width_px,
            y0 = static_cast<int>(std::round(place.middle_px.y())) - place.half_height_px;
  double best = kLeastCorrelation;
  std::optional<Vector2d> shift;
  for (int dy = -kSearch_px; dy <= kSearch_px; dy += kSearchStep_px) {
    for (int dx = -kSearch_px; dx <= kSearch_px; dx += kSearchStep_px) {
      if (x0 + dx < 0 || y0 + dy < 0 || x0 + dx + patch_.width > mode.width_px ||
          y0 + dy + patch_.height > mode.height_px) {
        continue;
      }
      double I = 0, II = 0, wI = 0;
      for (int j = 0; j < patch_.height; ++j) {
        const std::uint8_t* const row = bytes.data() + static_cast<std::size_t>(y0 + dy + j) * mode.stride_bytes +
                                        static_cast<std::size_t>(x0 + dx) * step;
        const double* const white = patch_.white.data() + static_cast<std::ptrdiff_t>(j) * patch_.width;
        for (int i = 0; i < patch_.width; ++i) {
          const double level = row[static_cast<std::size_t>(i) * step];
          I += level, II += level * level, wI += white[i] * level;
        }
      }
      const double spread_I = II - I * I / n;
      if (!(spread_I > 0)) continue;
      const double correlation = (wI - w * I / n) / std::sqrt(spread_w * spread_I);
      if (correlation > best) best = correlation, shift = Vector2d(dx, dy);
    }
  }
  return shift;
}

const std::vector<TagSighting>& RimTagTracker::track(const CameraMode& mode, std::span<const std::uint8_t> bytes,
                                                     const std::function<double(double)>& angle_at) {
  // Of the frame before: how far the table was ahead of its encoder, and what the tags had in common beyond that. A tag
  // that comes into view will not differ by much.
  double along = 0, squares = 0;
  for (const TagSighting& sighting : seen_) {
    const Vector2d by_angle = shift_by_angle(sighting.tag, sighting.angle_rad);
    along += by_angle.dot(sighting.shift_px);
    squares += by_angle.squaredNorm();
  }
  const double ahead_rad = squares > 0 ? along / squares : 0;
  Vector2d mean = Vector2d::Zero();
  for (const TagSighting& sighting : seen_) {
    mean += (sighting.shift_px - ahead_rad * shift_by_angle(sighting.tag, sighting.angle_rad)) /
            static_cast<double>(seen_.size());
  }
  seen_.clear();
  expected_ = 0;
  for (std::size_t tag = 0; tag < pictures_.size(); ++tag) {
    const auto at = place(tag, angle_at, ahead_rad);
    if (!at) {
      known_[tag] = false;
      continue;
    }
    ++expected_;
    const Vector2d start = known_[tag] ? Vector2d(last_px_[tag] + at->expected_px - at->middle_px) : mean;
    auto sighting = align(tag, *at, mode, bytes, start);
    // Most that are not seen are hidden behind the object: a search in every frame would cost more than the scan.
    if (!sighting && (frames_ == 0 || (frames_ + tag) % kFramesToSearch == 0)) {
      const auto near = search(tag, *at, mode, bytes);
      if (near) sighting = align(tag, *at, mode, bytes, *near);
    }
    known_[tag] = sighting.has_value();
    if (!sighting) continue;
    last_px_[tag] = sighting->shift_px;
    seen_.push_back(*sighting);
  }
  ++frames_;
  return seen_;
}

}  // namespace celadon
