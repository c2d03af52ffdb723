#include "daemon/checks/datum_checks.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <numbers>
#include <string>
#include <utility>

namespace celadon {
namespace {

constexpr double kDegreesPerRad = 180 / std::numbers::pi;
constexpr double kDatumSigmas = 4, kDatumCoverage = 2;
// Below these the model of lens and tags is no better.
constexpr double kFinestDatumTurn_deg = 0.02, kFinestAngle_deg = 0.02, kFinestTime_ms = 0.3, kFinestCamera_px = 0.25,
                 kFinestLaser_mm = 0.05;
constexpr double kLeastSpeed_rad_per_s = 0.01;
constexpr std::size_t kFewestPlaces = 5;
constexpr double kShareOfFrames = 0.5;

template <class... Values>
std::string text(const char* format, Values... values) {
  char out[400];
  std::snprintf(out, sizeof out, format, values...);
  return out;
}

SelfCheck not_seen(std::string name, const char* unit, std::string why) {
  return {std::move(name), unit, {}, {}, {}, CheckVerdict::not_verifiable, std::move(why), {}, {}};
}

SelfCheck of_size(std::string name, const char* unit, double value, double u, double limit, std::string note,
                  std::string cause, std::string remedy) {
  SelfCheck check{std::move(name), unit, value, u, limit, CheckVerdict::passed, std::move(note), {}, {}};
  if (!(std::abs(value) <= limit)) {
    check.verdict = CheckVerdict::failed;
    check.cause = std::move(cause);
    check.remedy = std::move(remedy);
  }
  return check;
}

void add_tag_checks(std::vector<SelfCheck>& checks, const DatumEvidence& evidence, const Calibration& calibration) {
  constexpr const char* kTurn = "deg/turn";
  const std::pair<const char*, const char*> names[] = {
      {"datum_turn", kTurn}, {"datum_angle", "deg"}, {"datum_time", "ms"}, {"datum_camera", "px"}};
  if (!evidence.has_tags) {
    checks.push_back(
        not_seen("datum", "px",
                 "the calibration knows no fiducials on the platter, so that nothing watched table, camera "
                 "and clocks; put some on its rim and calibrate"));
    return;
  }
  std::string why;
  if (!evidence.reading || evidence.frames_with_tags < kShareOfFrames * evidence.frames) {
    why = text(
        "three fiducials or more were recognised in %d of %d frames: too few; light the platter, and keep its "
        "rim free",
        evidence.frames_with_tags, evidence.frames);
  }
  if (!why.empty()) {
    for (const auto& [name, unit] : names) checks.push_back(not_seen(name, unit, why));
    return;
  }
  const DatumReading& r = *evidence.reading;
  const double turn_deg = r.turn_error_rad * kDegreesPerRad, turn_u = r.turn_sd_rad * kDegreesPerRad;
  const double stated_deg = calibration.encoder.scale.u / calibration.encoder.scale.value * 360;
  checks.push_back(of_size(
      "datum_turn", kTurn, turn_deg, turn_u,
      std::max(std::hypot(kDatumSigmas * turn_u, kDatumCoverage * stated_deg), kFinestDatumTurn_deg),
      "how much further than 360 degrees the platter's fiducials turned while the encoder counted them",
      text("the platter turned %.3f degrees for 360 of the encoder: the steps per turn are wrong by %.2f %%, or the "
           "platter slipped on its drive",
           360 + turn_deg, turn_deg / 3.6),
      "set the drive's steps per turn, check coupling and belt, and scan again"));
  const double wander_deg = r.wander_rad * kDegreesPerRad, wander_u = r.wander_sd_rad * kDegreesPerRad;
  checks.push_back(of_size("datum_angle", "deg", wander_deg, wander_u,
                           std::max(kDatumSigmas * wander_u, kFinestAngle_deg),
                           "largest distance of the fiducials' angle from the encoder's, but for what grows evenly",
                           "the platter does not follow the encoder evenly: it slipped or was pushed during the turn, "
                           "or the encoder is mounted off centre",
                           "check coupling and belt, keep hands off the platter, and scan again; if the same comes "
                           "back, calibrate: that measures what the encoder errs by once a turn"));
  if (!r.start_error_rad || evidence.sweep_rad_per_s < kLeastSpeed_rad_per_s) {
    checks.push_back(not_seen("datum_time", "ms",
                              r.start_error_rad
                                  ? "the table stood while frames were taken"
                                  : "no fiducial was recognised before the turn, with the table at rest"));
  } else {
    const double sign = calibration.encoder.direction;
    const double ms = sign * *r.start_error_rad / evidence.sweep_rad_per_s * 1e3,
                 u = r.start_sd_rad / evidence.sweep_rad_per_s * 1e3;
    const double stated_ms = calibration.time.stamp_offset_ns.u * 1e-6;
    const double limit = std::max({std::hypot(kDatumSigmas * u, kDatumCoverage * stated_ms), kFinestTime_ms,
                                   kFinestAngle_deg / kDegreesPerRad / evidence.sweep_rad_per_s * 1e3});
    checks.push_back(of_size("datum_time", "ms", ms, u, limit,
                             "by how much later than the calibration's time model says frames of the moving table were "
                             "exposed",
                             text("frames and angles do not belong together: the moving platter is seen where the "
                                  "encoder has it %.2f ms %s, or the drive has play",
                                  std::abs(ms), ms > 0 ? "later" : "earlier"),
                             "check the drive for play, scan in steps, or calibrate again with this camera mode"));
  }
  checks.push_back(of_size(
      "datum_camera", "px", r.camera_px, r.camera_sd_px, std::max(kDatumSigmas * r.camera_sd_px, kFinestCamera_px),
      "distance of the platter's picture from where it was calibrated, in the eighth of the turn where it is most",
      r.camera_first_px > 0.5 * r.camera_px
          ? "the camera stands otherwise against the table than when it was calibrated"
          : text("the camera was moved during the scan, before the table had turned by %.0f degrees",
                 r.camera_at_rad * kDegreesPerRad),
      "fasten the camera and calibrate again"));
}

/// Mean and slope of heights over the distance from the axis, with standard uncertainties in the middle and at the
/// ends.
struct StraightLine {
  double mean = 0, slope = 0, middle = 0, half_length = 0, u_middle = 0, u_end = 0;
  double farthest() const { return std::abs(mean) + std::abs(slope) * half_length; }
};

StraightLine straight_through(const std::vector<PlatterHeight>& heights) {
  StraightLine out;
  std::vector<double> weights(heights.size(), 1);
  double low = INFINITY, high = -INFINITY;
  for (const PlatterHeight& h : heights) low = std::min(low, h.r_mm), high = std::max(high, h.r_mm);
  out.half_length = 0.5 * (high - low);
  double stated = 0;
  for (const PlatterHeight& h : heights) stated += h.sd_mm / static_cast<double>(heights.size());
  for (int round = 0; round < 4; ++round) {
    double n = 0, r = 0, z = 0, rr = 0, rz = 0;
    for (std::size_t k = 0; k < heights.size(); ++k) {
      const double w = weights[k];
      n += w, r += w * heights[k].r_mm, z += w * heights[k].z_mm;
      rr += w * heights[k].r_mm * heights[k].r_mm, rz += w * heights[k].r_mm * heights[k].z_mm;
    }
    const double spread = rr - r * r / n;
    out.slope = spread > 1e-9 * rr ? (rz - r * z / n) / spread : 0;
    out.middle = r / n;
    out.mean = z / n;
    std::vector<double> off;
    for (const PlatterHeight& h : heights)
      off.push_back(std::abs(h.z_mm - out.mean - out.slope * (h.r_mm - out.middle)));
    std::vector<double> sorted = off;
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2), sorted.end());
    // Of n heights the line has taken up two; and none is known better than it says.
    const double taken = std::sqrt(n / std::max(n - 2, 1.)),
                 scatter = std::max(sorted[sorted.size() / 2] / 0.6745, 1e-6);
    for (std::size_t k = 0; k < off.size(); ++k) {
      const double share = off[k] / (3 * scatter);
      weights[k] = 1 / ((1 + share * share) * (1 + share * share));
    }
    const double u = std::max(scatter * taken, stated);
    out.u_middle = u / std::sqrt(n);
    out.u_end = u * std::sqrt(1 / n + out.half_length * out.half_length / spread);
  }
  return out;
}

const DatumEvidence::Line* line_of(const DatumEvidence& evidence, int shining, int taken_as) {
  for (const DatumEvidence::Line& line : evidence.lines) {
    if (line.shining == shining && line.taken_as == taken_as) return &line;
  }
  return nullptr;
}

bool is_flat(const DatumEvidence::Line* line) {
  return line != nullptr && line->heights.size() >= kFewestPlaces &&
         straight_through(line->heights).farthest() < 10 * kFinestLaser_mm;
}

SelfCheck laser_check(const DatumEvidence& evidence, int laser, const Calibration& calibration) {
  const std::string name = "datum_laser " + std::to_string(laser);
  const DatumEvidence::Line* const own = line_of(evidence, laser, laser);
  const bool flat = is_flat(own);
  for (const DatumEvidence::Line& other : evidence.lines) {
    if (other.shining != laser || other.taken_as == laser || flat || !is_flat(&other)) continue;
    return {name,
            "mm",
            {},
            {},
            {},
            CheckVerdict::failed,
            "height of the laser's line over the bare platter",
            text("the line of laser %d lies on the platter where the calibration has that of laser %d: the lasers are "
                 "swapped",
                 laser, other.taken_as),
            "exchange the cables of the lasers, or calibrate again"};
  }
  if (own == nullptr || own->heights.size() < kFewestPlaces) {
    return not_seen(name, "mm",
                    "too little of the laser's line is seen on the bare platter, within 4 mm of where the calibration "
                    "has it: the object covers it, the exposure is too short for the dark platter, or the laser moved "
                    "by more");
  }
  const StraightLine seen = straight_through(own->heights);
  const auto limit = [&](double u) {
    return std::max(std::hypot(kDatumSigmas * u, kDatumCoverage * calibration.systematic_mm), kFinestLaser_mm);
  };
  // Whichever is further beyond its limit: the ends move more, the middle is known better.
  const double middle = std::abs(seen.mean), end = seen.farthest();
  const bool by_middle = middle / limit(seen.u_middle) > end / limit(seen.u_end);
  const double value = by_middle ? middle : end, u = by_middle ? seen.u_middle : seen.u_end;
  return of_size(name, "mm", value, u, limit(u), "height of the laser's line over the bare platter",
                 text("the laser's line lies %.3f mm over the platter and %.2f mm/m oblique to it: the laser or the "
                      "camera has moved since the calibration, or the platter is another",
                      seen.mean, seen.slope * 1e3),
                 "fasten laser and camera and calibrate again");
}

}  // namespace

std::vector<SelfCheck> datum_checks(const DatumEvidence& evidence, const Calibration& calibration) {
  std::vector<SelfCheck> checks;
  add_tag_checks(checks, evidence, calibration);
  for (const DatumEvidence::Line& line : evidence.lines) {
    if (line.shining == line.taken_as) checks.push_back(laser_check(evidence, line.shining, calibration));
  }
  return checks;
}

}  // namespace celadon
