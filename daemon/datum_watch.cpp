#include "daemon/datum_watch.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "acquisition/triangulation.h"

namespace celadon {
namespace {

constexpr double kBeyondObject_mm = 3, kMargin_mm = 2;
constexpr double kLargestRadius_mm = 511;  // of those that are told apart
constexpr double kStrays = 1e-3;           // share of the samples
constexpr std::size_t kEnoughTags = 3;
constexpr std::uint64_t kEveryFrame = 4;  // for the line on the platter: the background's noise is in all of them
constexpr double kSmallestRunUp_rad = 1e-6;

/// The calibration as if its head always stood like that, and the table so high: z = 0 is the platter there, too.
Calibration standing_at(Calibration calibration, const AxisStop& stop) {
  const Eigen::Affine3d X_WC = camera_to_object(calibration, stop);
  calibration.axis.X_CW.linear() = (X_WC.linear() / calibration.scale.value).transpose();
  calibration.axis.X_CW.translation() = -calibration.axis.X_CW.linear() * X_WC.translation() / calibration.scale.value;
  return calibration;
}

}  // namespace

DatumWatch::DatumWatch(const Calibration& calibration, const CameraMode& mode, std::span<const int> lasers,
                       const AxisStop& stop)
    : calibration_(standing_at(calibration, stop)), mode_(mode) {
  if (!calibration.rim_tags.empty()) tracker_ = std::make_unique<RimTagTracker>(calibration_);
  for (const int shining : lasers) {
    const auto lit = std::find_if(calibration.lasers.begin(), calibration.lasers.end(),
                                  [&](const LaserPlane& plane) { return plane.laser == shining; });
    if (lit == calibration.lasers.end()) continue;
    for (const LaserPlane& plane : calibration.lasers) {
      // A line is searched along rows or columns as its own laser's asks for.
      lines_.push_back({shining, PlatterLine(calibration_, plane.laser, line_along(*lit))});
    }
  }
}

DatumWatch::~DatumWatch() = default;

void DatumWatch::at_rest(std::span<const std::uint8_t> picture, double encoder_rad) {
  if (!tracker_ || picture.empty()) return;
  const double angle = calibration_.encoder.table_rad(encoder_rad);
  at_rest_ = tracker_->track(mode_, picture, [&](double) { return angle; });
}

void DatumWatch::see(std::span<const std::uint8_t> picture, const std::function<double(double)>& encoder_at,
                     double turned_rad, double speed_rad_per_s) {
  if (!tracker_) return;
  const auto& seen =
      tracker_->track(mode_, picture, [&](double row) { return calibration_.encoder.table_rad(encoder_at(row)); });
  ++frames_;
  if (seen.size() >= kEnoughTags) ++frames_with_tags_;
  for (const TagSighting& tag : seen) sightings_.push_back({tag, turned_rad});
  speed_rad_per_s_ = std::max(speed_rad_per_s_, std::abs(speed_rad_per_s));
}

void DatumWatch::line(int laser, std::span<const std::uint8_t> picture, std::span<const std::uint8_t> dark) {
  if (lit_frames_++ % kEveryFrame != 0) return;
  for (Watched& watched : lines_) {
    if (watched.shining == laser) watched.line.add(mode_, picture, dark);
  }
}

// Higher up nothing lies where the line on the platter is looked for: a belly over a foot does not, nor do strays.
void DatumWatch::object(const Profile& profile) {
  for (std::size_t i = 0; i < profile.size(); ++i) {
    if (profile.z_mm[i] > PlatterLine::kReach_mm + kMargin_mm) continue;
    ++radii_[static_cast<std::size_t>(std::clamp(profile.r_mm[i], 0., kLargestRadius_mm))];
  }
}

double DatumWatch::foot_radius_mm() const {
  std::uint64_t all = 0, beyond = 0;
  for (const std::uint64_t n : radii_) all += n;
  for (std::size_t r = radii_.size(); r-- > 0;) {
    beyond += radii_[r];
    if (static_cast<double>(beyond) > kStrays * static_cast<double>(all)) return static_cast<double>(r + 1);
  }
  return 0;
}

std::vector<DatumSighting> DatumWatch::all_sightings() const {
  std::vector<DatumSighting> all;
  if (!sightings_.empty()) {
    const DatumSighting& first = sightings_.front();
    for (const TagSighting& tag : at_rest_) {
      const double before_rad = std::abs(first.tag.angle_rad - at_rest_.front().angle_rad);
      all.push_back({tag, std::min(first.turned_rad - before_rad, -kSmallestRunUp_rad)});
    }
  }
  all.insert(all.end(), sightings_.begin(), sightings_.end());
  return all;
}

DatumEvidence DatumWatch::result() const {
  DatumEvidence out;
  out.has_tags = tracker_ != nullptr;
  out.frames = frames_;
  out.frames_with_tags = frames_with_tags_;
  out.sweep_rad_per_s = speed_rad_per_s_;
  if (tracker_) out.reading = read_datum(calibration_, all_sightings());
  const double beyond_mm = foot_radius_mm() + kBeyondObject_mm;
  for (const Watched& watched : lines_) {
    out.lines.push_back({watched.shining, watched.line.laser(), watched.line.heights(beyond_mm)});
  }
  return out;
}

}  // namespace celadon
