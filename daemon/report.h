#pragma once
// report.json: what was measured and how well. Grammar: RESULTS.md.

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "acquisition/axis_stop.h"
#include "acquisition/stereo/match_counts.h"
#include "daemon/checks/self_check.h"
#include "daemon/dimension.h"
#include "daemon/export/cad_client.h"
#include "daemon/exposure_plan.h"
#include "daemon/view_watch.h"
#include "fitting/composite_fit.h"
#include "fitting/flat_ends.h"
#include "fitting/local_frame.h"
#include "fitting/range_fit.h"
#include "fitting/symmetry.h"
#include "fitting/turned_over.h"

namespace celadon {

/// Wall-clock time of one stage, in the order in which the stages ran.
struct StageSeconds {
  std::string stage;
  double seconds = 0;
};

/// Fitted range minus true range along the ray, mm. Simulated scans only.
struct TruthError {
  double bias = 0, rms = 0, max = 0;
};

/// Second reading of a place minus the first after a full turn, mm.
struct ClosureError {
  double bias = 0, rms = 0;
  std::uint64_t samples = 0;
};

/// What one laser contributed in one turn.
struct LaserShare {
  int laser = 0;
  AxisStop stop = {};  ///< of the axes beside the table
  std::uint64_t profiles = 0, samples = 0;
  std::optional<ClosureError> closure_mm = {};
};

/// Radius by one laser minus that by another at the same places of the object, mm; second minus first.
struct AgreementError {
  int first = 0, second = 0;  ///< lasers
  double bias = 0, bias_sd = 0;
  double rms = 0, noise = 0;   ///< over cells; what of it the samples' own scatter explains
  double shift = 0, tilt = 0;  ///< parts of it that go like cos(theta - ..), and like the height from -1 to 1
  std::uint64_t cells = 0;
  /// Its mean over the height in fields of equal angle all around, and what noise makes of one; empty: not seen all
  /// around.
  std::vector<double> around{};
  double around_noise = 0;
};

/// What became of the frames of a scan.
struct ScanCounters {
  std::string mode;  ///< "step" or "sweep"
  std::uint64_t profiles = 0, frames = 0, lost = 0, stale = 0, corrupt = 0, rows_ambiguous = 0;
};

/// What became of a scan by stereo.
struct StereoShare {
  double pair_rad = 0;  ///< the table's turn from the first picture of a pair to the second
  int pairs = 0;
  MatchCounts counts;
  double calibration_mm = 0;  ///< standard uncertainty that the calibration gives a radius
};

/// An object scanned again at another height of the lift.
struct RaisedPose {
  double asked_mm = 0;  ///< by how much it was said to be raised
  double lift_mm = 0;   ///< by how much it was
  double sd_mm = 0;     ///< standard deviation of that; 0: taken as it was said
};

/// What the calibration that a scan was measured with states of itself.
struct StatedCalibration {
  std::string date;          ///< ISO 8601 UTC
  double systematic_mm = 0;  ///< standard uncertainty of a radius
  double scale_u = 0;        ///< relative standard uncertainty of lengths
};

/// What a dry turn says of the scan to come.
struct DryTurn {
  int profiles = 0;               ///< a turn of that scan
  std::optional<double> seconds;  ///< that it takes; nullopt: not foreseen
  double sd_mm = 0;               ///< mean standard deviation of its surface, by what this one has
  ViewReading view;
  ExposureAdvice exposure;
};

/// The exposures of one turn at each stop, found from the line's own peaks.
struct TurnExposures {
  int laser = 0;
  std::vector<ExposurePlan::Stretch> stretches;  ///< all around
};

/// What the result files say besides the fit itself.
struct ResultNotes {
  std::string name = "object";
  std::string date;     ///< ISO 8601 UTC, of the scan; empty for a fit of a file without a date
  std::string machine;  ///< empty for a fit of a file
  bool simulated = false;
  std::vector<std::string> warnings;  ///< beside those of the fit
  std::vector<StageSeconds> seconds;
  std::optional<TruthError> truth_mm;
  std::optional<ScanCounters> scan;
  std::optional<ClosureError> closure_mm;      ///< of several lasers the worst
  std::optional<std::uint64_t> coloured = {};  ///< of a camera that delivers colours: samples with one
  std::vector<LaserShare> lasers = {};         ///< after a scan, in the order of their turns
  std::vector<TurnExposures> exposures = {};   ///< of a scan with the exposure auto
  std::optional<AgreementError> agreement_mm = {};
  std::optional<StereoShare> stereo = {};  ///< of a scan without a laser
  std::vector<SelfCheck> checks;           ///< of a scan
  std::optional<DryTurn> dry_turn = {};
  std::optional<StatedCalibration> calibration;  ///< of a scan
  std::vector<Dimension> dimensions = {};        ///< of a scan of a round object
  std::optional<CadResult> solid;
  std::string shape_reason;                  ///< why this base was chosen; empty: as it was named
  std::optional<LocalFrame> own_axis;        ///< how the surface's frame was found, if it was looked for
  std::optional<PoseAlignment> turned_over;  ///< how the object's second pose was found
  FlatEnds flat_ends{};                      ///< faces whose samples were left out of the wall
  std::optional<RaisedPose> raised;          ///< how far the object's second set of samples was raised
  std::optional<Symmetry> symmetry;          ///< that the surface was made to have
  /// Of a part that stands off the scanner's axis: what it was about that one.
  std::optional<RangeFitReport> about_scanner_axis;
};

/// Extent of the pieces of a body along x, y and z of the scanner frame, mm, to about 1e-4 of the size.
Eigen::Vector3d size_of(std::span<const RangeFunction* const> pieces);

/// The report as a JSON object, fields in the order of RESULTS.md.
nlohmann::ordered_json report_json(const RangeFit& fit, const ResultNotes& notes);
/// The same of a body of pieces.
nlohmann::ordered_json report_json(const CompositeFit& fit, const ResultNotes& notes);
/// Of a scan to which no surface was fitted.
nlohmann::ordered_json report_json(std::uint64_t points, const ResultNotes& notes);
/// The text of report.json.
std::string format_report(const nlohmann::ordered_json& report);

}  // namespace celadon
