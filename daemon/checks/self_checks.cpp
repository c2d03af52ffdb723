#include "daemon/checks/self_checks.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <iterator>
#include <map>
#include <numbers>
#include <optional>
#include <utility>
#include <variant>

#include "daemon/checks/error_harmonics.h"
#include "daemon/checks/spread.h"
#include "daemon/laser_agreement.h"
#include "daemon/profile_log.h"
#include "fitting/coefficient_covariance.h"
#include "fitting/own_frame.h"

namespace celadon {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi, kDegrees = 180 / std::numbers::pi;
constexpr double kSigmas = 4;               // of the check itself: 6e-5 of all good scans are beyond, a check
constexpr double kCoverage = 2;             // of what the calibration states
constexpr double kScatterSigmas = 3;        // of the scatters of closure and lasers, in noise
constexpr double kCoarsestTurn_deg = 0.25;  // a limit beyond this says nothing of the angle
constexpr double kFinestTurn_deg = 0.005;   // encoders and clocks are no better
constexpr const char* kHoldStill = "fasten object, camera and laser, let the machine warm up, and scan again";

template <class... Values>
std::string text_of(const char* format, Values... values) {
  char text[320];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

double limit_of(double u, double stated) {
  return std::hypot(kSigmas * u, kCoverage * stated);
}

/// A check of the size of a value; cause and remedy count where it failed.
SelfCheck judged(const char* name, const char* unit, double value, double u, double limit, std::string note,
                 std::string cause, std::string remedy) {
  SelfCheck check{name, unit, value, u, limit, CheckVerdict::passed, std::move(note), {}, {}};
  if (!(std::abs(value) <= limit)) {
    check.verdict = CheckVerdict::failed;
    check.cause = std::move(cause);
    check.remedy = std::move(remedy);
  }
  return check;
}

SelfCheck unknown(const char* name, const char* unit, std::string why) {
  return {name, unit, {}, {}, {}, CheckVerdict::not_verifiable, std::move(why), {}, {}};
}

using Cause = OverlapResult::Cause;

std::string either_text(const OverlapResult& overlap) {
  return text_of("on this object a turn that is %.3f degrees too long and a shift along r of %.4f mm look alike",
                 overlap.turn_rad * kDegrees, overlap.shift_mm);
}

SelfCheck closure(const OverlapResult& overlap, double systematic_mm) {
  if (!overlap.missing.empty()) return unknown("closure", "mm", overlap.missing);
  const Cause by = overlap.cause;
  return judged("closure", "mm", overlap.shift_mm, overlap.shift_u_mm, limit_of(overlap.shift_u_mm, systematic_mm),
                "mean difference along r between 360 and 0 degrees",
                by == Cause::turn    ? "the places that are seen again are other places: the turn was not a whole one"
                : by == Cause::shift ? "camera, laser or object moved during the scan"
                                     : "the object slipped, the steps per turn are wrong, or camera or laser "
                                       "moved: " +
                                           either_text(overlap),
                by == Cause::turn    ? "see the check 'turn'"
                : by == Cause::shift ? kHoldStill
                                     : std::string(kHoldStill) + "; an object that is not round tells which it is");
}

SelfCheck closure_scatter(const std::optional<ClosureError>& error, const OverlapResult& overlap, double noise_mm,
                          double kappa) {
  if (!error) return unknown("closure_scatter", "mm", "nothing was seen again after 360 degrees");
  // The fit's noise would swallow what does not close, and is that of its best samples where they are weighted; that of
  // the first look is neither.
  const double noise = overlap.missing.empty() ? overlap.noise_mm : noise_mm;
  const double u = error->rms * std::sqrt(kappa / (2 * static_cast<double>(error->samples)));
  return judged("closure_scatter", "mm", error->rms, u, kScatterSigmas * std::numbers::sqrt2 * noise,
                "root mean square difference of the samples at 360 and 0 degrees",
                "after a full turn the same places measure differently",
                "check that the object stands firmly, and the steps per turn, belt and backlash of the table");
}

SelfCheck turn(const OverlapResult& overlap, const Measured& encoder_scale) {
  constexpr const char* kUnit = "deg/turn";
  if (!overlap.missing.empty()) return unknown("turn", kUnit, overlap.missing);
  const double value = overlap.turn_rad * kDegrees, u = overlap.turn_u_rad * kDegrees;
  const double stated = encoder_scale.u / encoder_scale.value * 360;
  const double limit = std::max(limit_of(u, stated), kFinestTurn_deg);
  if (!(kSigmas * u <= kCoarsestTurn_deg)) {
    return unknown(
        "turn", kUnit,
        "the object changes too little with the angle, for how its samples scatter, to show a small turn; what is "
        "round about the table's axis never does");
  }
  if (std::abs(value) > limit && overlap.cause != Cause::turn) {
    return unknown("turn", kUnit,
                   overlap.cause == Cause::either
                       ? either_text(overlap)
                       : "what is seen again is not what a turn would show; see the check 'closure'");
  }
  return judged(
      "turn", kUnit, value, u, limit,
      "how much further than 360 degrees the object turned while the encoder counted them",
      text_of("the object turned %.3f degrees for 360 of the encoder: it slipped on the table or the table on "
              "its drive, or the steps per turn are wrong by %.2f %%",
              360 + value, value / 3.6),
      "fasten object, coupling and belt and scan again; if the same value comes back, set the drive's steps "
      "per turn, or let celadon calibrate measure the encoder's scale");
}

/// The piece with most samples.
const RangeFit& main_piece(const BodyFit& fit) {
  const auto pieces = fit.pieces();
  return *std::max_element(pieces.begin(), pieces.end(), [](const RangeFit& a, const RangeFit& b) {
    return a.report.points - a.report.rejected < b.report.points - b.report.rejected;
  });
}

std::size_t samples_of(const RangeFitReport& r) {
  const std::size_t out = r.rejected + r.unfollowable;
  return r.points > out ? r.points - out : 1;
}

void add_harmonics(std::vector<SelfCheck>& checks, const RangeFit& piece, double systematic_mm) {
  const char* const names[] = {"harmonic_1", "harmonic_2"};
  const BaseSurface& base = piece.function.base();
  const auto around = base.arcs.closed() ? errors_around(piece.geometric_errors) : std::nullopt;
  if (!is_round(piece.report.model) || !around) {
    const char* const why =
        around ? "the surface is not round and follows what a harmonic would show" : "the samples do not go all around";
    for (const char* name : names) checks.push_back(unknown(name, "mm", why));
    return;
  }
  // Each of cos and sin has the variance 2 kappa sigma^2 / n.
  const double u =
      piece.report.noise_mm * std::sqrt(2 * piece.report.kappa / static_cast<double>(samples_of(piece.report)));
  const auto amplitude = first_harmonics(*around);
  checks.push_back(judged(names[0], "mm", amplitude[0], u, limit_of(u, systematic_mm),
                          "first harmonic of the samples about the surface's axis",
                          "the object stands beside the axis that the surface has, or the table's axis moves",
                          "scan again with the model left to the samples; check the table's bearing"));
  checks.push_back(judged(names[1], "mm", amplitude[1], u, limit_of(u, systematic_mm),
                          "second harmonic of the samples about the surface's axis",
                          "the object is not round, or the table's bearing or its encoder errs periodically",
                          "turn the object by 90 degrees on the table and scan again: what turns with it is the "
                          "object's own"));
  // A circle of radius R that stands e beside the axis has r = e cos + sqrt(R^2 - e^2 sin^2): its first harmonic is e.
  // An axis that was calibrated wrong makes none, but a wrong radius.
  const Eigen::Vector3d middle(0, 0, base.spherical() ? 0 : 0.5 * (base.band_start + base.band_end));
  const double beside_mm = (base.X_WB * middle).head<2>().norm();
  checks.push_back({"eccentricity",
                    "mm",
                    beside_mm > 0 ? beside_mm : amplitude[0],
                    u,
                    {},
                    CheckVerdict::not_verifiable,
                    "first harmonic of the fitted radius about the scanner's axis: where the object stands, which "
                    "nothing else says",
                    {},
                    {}});
}

/// What fields of angle are off by, all around, of a scan that is steady but for noise.
struct Fields {
  std::vector<double> off_mm;
  double noise_mm = 0;
  bool may_be_followed = false;  ///< by the surface: less than what is left may have been there
};

/// Of two turns, what they differ by: whatever the object's shape. Else what the surface misses its samples by; a text
/// where that is its own.
std::variant<Fields, std::string> fields_of(const CheckedScan& scan, const RangeFit& piece, bool lasers_differ) {
  constexpr double kMostSeen = 0.95;
  if (lasers_differ) return "the lasers differ, which would look like shaking";
  if (scan.agreement && !scan.agreement->around.empty()) {
    Fields fields{scan.agreement->around, scan.agreement->around_noise / std::numbers::sqrt2, false};
    for (double& off : fields.off_mm) off /= std::numbers::sqrt2;
    return fields;
  }
  if (scan.agreement) {
    return "each laser sees places that the other does not, and edges that the surface cannot follow would look like "
           "shaking";
  }
  const auto around = errors_around(piece.geometric_errors);
  if (!around) return "the samples do not go all around";
  if (piece.report.coverage < kMostSeen) {
    return "too much of the surface was hidden: beside holes it follows no samples, and its errors are its own";
  }
  const bool freeform =
      piece.report.model == SurfaceModel::general || piece.report.model == SurfaceModel::translational;
  if (freeform && piece.report.stopped_by.starts_with("the finest intervals")) {
    return "the surface's intervals are as fine as they get: edges that it cannot follow would look like shaking";
  }
  // Correlation along the line only: what profiles have in common is what is looked for.
  const double kappa = piece.errors ? piece.errors->inflation.within : piece.report.kappa;
  const double per_field = static_cast<double>(samples_of(piece.report)) / ErrorMap::kAround;
  return Fields{*around, piece.report.noise_mm * std::sqrt(kappa / per_field), freeform};
}

SelfCheck shaking(const char* name, double value, double noise, double u, double systematic_mm, const char* note) {
  return judged(name, "mm", value, u, std::hypot(kSigmas * u + noise, kCoverage * systematic_mm), note,
                "the object rocks, or camera, laser or table shake while the table turns",
                "fasten the object, keep the machine away from what shakes it, scan slower or in steps");
}

SelfCheck jitter(const CheckedScan& scan) {
  if (!scan.jitter) return unknown("jitter", "mm", "too few profiles stand between neighbours of the same laser");
  return shaking("jitter", scan.jitter->mm, scan.jitter->noise_mm, scan.jitter->u_mm, scan.calibration.systematic_mm,
                 "what the samples of a profile are off by in common between their neighbours, standard deviation");
}

SelfCheck steadiness(const CheckedScan& scan, const RangeFit& piece, bool lasers_differ) {
  const auto fields = fields_of(scan, piece, lasers_differ);
  if (const auto* const why = std::get_if<std::string>(&fields)) return unknown("steadiness", "mm", *why);
  const auto& [off_mm, noise_mm, may_be_followed] = std::get<Fields>(fields);
  // What shakes does so all around; a dent, or edges that the surface cannot follow, are in some places.
  const std::vector<double> left = beyond_harmonics(off_mm);
  double square = 0;
  for (const double off : left) square += off * off / static_cast<double>(left.size());
  const double value = std::min(std::sqrt(square), robust_deviation(left, median(left)));
  SelfCheck check = shaking("steadiness", value, noise_mm, noise_mm / std::sqrt(2. * static_cast<double>(left.size())),
                            scan.calibration.systematic_mm,
                            "what fields of 2 degrees are off by over the whole height, root mean square");
  if (check.verdict == CheckVerdict::passed && may_be_followed) {
    return unknown(
        "steadiness", "mm",
        "a surface of free form takes slow rocking for shape; a second turn, by another laser, tells them apart");
  }
  return check;
}

/// Mean and scatter of what two lasers differ by; nothing where there is one laser.
std::vector<SelfCheck> laser_checks(const CheckedScan& scan) {
  if (!scan.agreement) {
    if (scan.calibration.lasers.size() < 2) return {};
    return {unknown("laser_agreement", "mm", "this scan did not compare its lasers")};
  }
  const AgreementError& e = *scan.agreement;
  const AgreementCause by = cause_of(e);
  const double systematic_mm = scan.calibration.systematic_mm;
  // Each cell has its noise, and the uncertainty of both planes.
  const double scatter_limit = kScatterSigmas * std::hypot(e.noise, std::numbers::sqrt2 * systematic_mm);
  return {judged("laser_agreement", "mm", e.bias, e.bias_sd, limit_of(e.bias_sd, systematic_mm),
                 "mean difference along r of what two lasers see", by.cause, by.remedy),
          judged("laser_scatter", "mm", e.rms, e.noise / std::sqrt(2 * static_cast<double>(e.cells)), scatter_limit,
                 "root mean square difference of what two lasers see, over fields of the object", by.cause, by.remedy)};
}

/// "head at 40.00 degrees, lift at 0.00 mm"
std::string where(const AxisStop& stop) {
  return text_of("head at %.2f degrees, lift at %.2f mm", stop.elevation_rad * kDegrees, stop.lift_mm);
}

/// The same of two stops of head and lift; nothing where there was one.
std::vector<SelfCheck> stop_checks(const CheckedScan& scan) {
  if (!scan.stops) return {};
  if (!scan.stops->error) {
    return {unknown("stop_agreement", "mm", "no two stops of head and lift saw enough of the object in common")};
  }
  const StopComparison& stops = *scan.stops;
  const AgreementError& e = *stops.error;
  const std::string cause = "an axis is no longer where it was calibrated, or the object moved, between " +
                            where(stops.first) + " and " + where(stops.second);
  const char* const remedy =
      "check what holds head, table and object, home the axes and scan again; then calibrate the axes again";
  return {judged("stop_agreement", "mm", e.bias, e.bias_sd, limit_of(e.bias_sd, stops.stated_mm),
                 "mean difference along r of what two stops of head and lift see", cause, remedy),
          judged("stop_scatter", "mm", e.rms, e.noise / std::sqrt(2 * static_cast<double>(e.cells)),
                 kScatterSigmas * std::hypot(e.noise, stops.stated_mm),
                 "root mean square difference of what two stops see, over fields of the object", cause, remedy)};
}

}  // namespace

OverlapResult compare_overlap(const std::filesystem::path& log_file) {
  OverlapResult bad;
  auto log = ProfileLogReader::open(log_file);
  if (!log) {
    bad.missing = log.error().message;
    return bad;
  }
  // Each turn by itself: a laser's rows show other places after head or lift moved, and others of them at another
  // exposure.
  struct TurnEnds {
    double start_rad;
    OverlapComparison comparison;
  };
  std::map<std::pair<int, int>, TurnEnds> turns;
  int begun = 0;  // turns, by a log that tells them apart
  while (const auto entry = (*log)->next_entry()) {
    begun += std::holds_alternative<LogStop>(*entry);
    const auto* const logged = std::get_if<LoggedProfile>(&*entry);
    if (logged == nullptr) continue;
    const Profile& profile = *logged->profile;
    const auto key = std::pair(begun, int{profile.laser});
    TurnEnds& ends = turns.try_emplace(key, TurnEnds{profile.table_angle_rad, {}}).first->second;
    const double turned = std::abs(profile.table_angle_rad - ends.start_rad);
    if (logged->overlap) {
      ends.comparison.again(turned - kTurn_rad, profile);
    } else {
      ends.comparison.first(turned, profile);
    }
  }
  if (!(*log)->error().empty()) {
    bad.missing = (*log)->error();
    return bad;
  }
  OverlapResult worst;
  worst.missing = "the log holds no profile";
  double most = -1;
  for (const auto& [key, ends] : turns) {
    OverlapResult result = ends.comparison.result();
    const auto sigmas = [](double value, double u) { return u > 0 ? std::abs(value) / u : 0; };
    const double size = result.missing.empty() ? std::max(sigmas(result.shift_mm, result.shift_u_mm),
                                                          sigmas(result.turn_rad, result.turn_u_rad))
                                               : -1;
    if (turns.size() == 1 || size > most || (most < 0 && !result.missing.empty())) worst = std::move(result);
    most = std::max(most, size);
  }
  return worst;
}

std::vector<SelfCheck> self_checks(const CheckedScan& scan) {
  const RangeFit& piece = main_piece(scan.fit);
  const double systematic_mm = scan.calibration.systematic_mm;
  std::vector<SelfCheck> checks{
      closure(scan.overlap, systematic_mm),
      closure_scatter(scan.closure, scan.overlap, scan.fit.whole().noise_mm, scan.fit.whole().kappa),
      turn(scan.overlap, scan.calibration.encoder.scale)};
  add_harmonics(checks, piece, systematic_mm);
  std::vector<SelfCheck> lasers = laser_checks(scan);
  const bool differ = std::any_of(lasers.begin(), lasers.end(),
                                  [](const SelfCheck& check) { return check.verdict == CheckVerdict::failed; });
  checks.push_back(steadiness(scan, piece, differ));
  checks.push_back(jitter(scan));
  std::move(lasers.begin(), lasers.end(), std::back_inserter(checks));
  std::vector<SelfCheck> stops = stop_checks(scan);
  std::move(stops.begin(), stops.end(), std::back_inserter(checks));
  return checks;
}

}  // namespace celadon
