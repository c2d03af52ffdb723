#include "daemon/cli/fit_input.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>
#include <utility>

#include "fitting/even_points.h"

namespace celadon::cli {
namespace {

constexpr std::size_t kFramePoints = 12000;

tl::expected<LocalFrame, std::string> frame_of(ProfileStream& samples) {
  auto frame = local_frame(even_points(samples, kFramePoints));
  if (!frame) return tl::make_unexpected(frame.error().message);
  return *frame;
}

// What CloudOptions::axis does to a file's frame.
Eigen::Isometry3d with_axis_up(Axis axis) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  if (axis == Axis::x) X.linear() << 0, 1, 0, 0, 0, 1, 1, 0, 0;
  if (axis == Axis::y) X.linear() << 0, 0, 1, 1, 0, 0, 0, 1, 0;
  return X;
}

// In one part.
tl::expected<std::unique_ptr<CloudFile>, std::string> open_one(const std::filesystem::path& file,
                                                               const CloudOptions& options) {
  if (is_profile_log(file)) return LogFile::open(file, options);
  auto cloud = open_cloud(file, options);
  if (!cloud) return tl::make_unexpected(cloud.error().message);
  return std::move(*cloud);
}

}  // namespace

bool on_z(const LocalFrame& own) {
  constexpr double kSigmas = 3, kRounding = 1e-6;
  const Eigen::Vector3d k = own.X_SL.linear().col(2), o = own.X_SL.translation();
  const double tilt = k.head<2>().norm(), beside = (o - k * (o.z() / std::max(k.z(), 0.5))).head<2>().norm();
  const double misfit = std::sqrt(std::max(0.0, own.scale_mm * own.scale_mm - own.noise_mm * own.noise_mm));
  const double per_mm = own.origin_sd_mm > 0 ? own.axis_sd_rad / own.origin_sd_mm : 0;
  const bool any_tilt = own.shape == FrameShape::sphere;  // it has a centre
  return k.z() > 0 && (any_tilt || tilt <= std::max({kRounding, kSigmas * own.axis_sd_rad, misfit * per_mm})) &&
         beside <= std::max({kRounding * std::max(1.0, o.norm()), kSigmas * own.origin_sd_mm, misfit});
}

std::string reason_for_z(const LocalFrame& own) {
  constexpr double kInliers = 0.6, kAxisRad = 0.02;
  if (on_z(own)) return "the body's own axis is the same within its uncertainty";
  const bool sure = own.shape == FrameShape::sphere || own.axis_sd_rad <= kAxisRad;
  if (sure && own.inliers >= kInliers) return {};
  char text[200];
  std::snprintf(text, sizeof text, "the body shows no axis of its own well enough (%s, %.0f %% of the points on it)",
                to_string(own.shape), 100 * own.inliers);
  return text;
}

tl::expected<FitInput, std::string> FitInput::open(const std::filesystem::path& file, const CloudOptions& options) {
  FitInput input;
  input.first_file_ = file;
  input.options_ = options;
  if (auto opened = input.reopen(); !opened) return tl::make_unexpected(opened.error());
  return input;
}

const LogFile* FitInput::log() const {
  return dynamic_cast<const LogFile*>(files_.front().get());
}

tl::expected<void, std::string> FitInput::reopen() {
  const Eigen::Isometry3d X_LS = X_SL_.value_or(Eigen::Isometry3d::Identity()).inverse();
  CloudOptions options = options_;
  if (X_SL_) options.X_SF = X_LS * with_axis_up(options_.axis);
  std::vector<std::unique_ptr<CloudFile>> files;
  const auto add = [&](const std::filesystem::path& file) -> tl::expected<void, std::string> {
    if (is_profile_log(file)) {
      auto log = LogFile::open(file, options);
      if (!log) return tl::make_unexpected(log.error());
      files.push_back(std::move(*log));
      return {};
    }
    auto opened = open_cloud_parts(file, options);
    if (!opened) return tl::make_unexpected(opened.error().message);
    std::move(opened->begin(), opened->end(), std::back_inserter(files));
    return {};
  };
  if (auto added = add(first_file_); !added) return added;
  first_parts_ = files.size();
  if (!second_file_.empty()) {
    options.X_SF = X_LS * X_S2_ * with_axis_up(options_.axis);
    if (auto added = add(second_file_); !added) return added;
  }
  files_ = std::move(files);
  parts_ = std::make_unique<std::vector<ProfileStream*>>();
  for (const auto& file : files_) parts_->push_back(file.get());
  joined_ = std::make_unique<JoinedStream>(*parts_);
  return {};
}

tl::expected<LocalFrame, std::string> FitInput::own_frame() {
  return frame_of(samples());
}

tl::expected<void, std::string> FitInput::place(const Eigen::Isometry3d& X_SL) {
  X_SL_ = X_SL;
  return reopen();
}

tl::expected<PoseAlignment, std::string> FitInput::add_turned_over(const std::filesystem::path& file,
                                                                   const RangeFunction& wall,
                                                                   const std::optional<LocalFrame>& about_own_axis) {
  const auto named = [&](const std::string& why) { return tl::make_unexpected("'" + file.string() + "': " + why); };
  CloudOptions options = options_;
  auto second = open_one(file, options);
  if (!second) return tl::make_unexpected(second.error());
  Eigen::Isometry3d X_S2 = Eigen::Isometry3d::Identity();
  if (about_own_axis) {
    const auto own = frame_of(**second);
    if (!(*second)->error().empty()) return tl::make_unexpected((*second)->error());
    if (!own) return named(own.error());
    X_S2 = about_own_axis->X_SL * own->X_SL.inverse();
    options.X_SF = X_S2 * with_axis_up(options_.axis);
    second = open_one(file, options);
    if (!second) return tl::make_unexpected(second.error());
  }
  auto pose = align_turned_over(wall, **second);
  if (!(*second)->error().empty()) return tl::make_unexpected((*second)->error());
  if (!pose) return named(pose.error().message);
  second_file_ = file;
  X_S2_ = pose->X_12 * X_S2;
  if (auto opened = reopen(); !opened) return tl::make_unexpected(opened.error());
  return *pose;
}

tl::expected<void, std::string> FitInput::add_raised(const std::filesystem::path& file, double lift_mm) {
  second_file_ = file;
  X_S2_ = Eigen::Isometry3d(Eigen::Translation3d(0, 0, -lift_mm));
  return reopen();
}

tl::expected<JointPose, std::string> FitInput::refine_second(const RangeFunction& wall, PoseFreedom freedom,
                                                             double noise_mm) {
  const Eigen::Isometry3d X_SL = X_SL_.value_or(Eigen::Isometry3d::Identity());
  BaseSurface base = wall.base();
  base.X_WB = X_SL.inverse() * base.X_WB;
  const RangeFunction wall_L(base, wall.degree_u(), wall.degree_v(), wall.knots_u(), wall.knots_v(),
                             wall.coefficients());
  const ProfileParts all(*parts_);
  JoinedStream first(all.first(first_parts_)), second(all.subspan(first_parts_));
  auto joint = refine_pose(wall_L, first, second, freedom, noise_mm);
  if (!joint) return tl::make_unexpected("'" + second_file_.string() + "': " + joint.error().message);
  X_S2_ = X_SL * joint->X_12 * X_SL.inverse() * X_S2_;
  if (auto opened = reopen(); !opened) return tl::make_unexpected(opened.error());
  return *joint;
}

std::string FitInput::error() const {
  for (const auto& file : files_)
    if (!file->error().empty()) return file->error();
  return {};
}

std::uint64_t FitInput::skipped() const {
  std::uint64_t sum = 0;
  for (const auto& file : files_) sum += file->skipped();
  return sum;
}

}  // namespace celadon::cli
