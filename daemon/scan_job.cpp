#include "daemon/scan_job.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <future>
#include <iterator>
#include <optional>
#include <span>

#include "acquisition/recording.h"
#include "daemon/checks/datum_checks.h"
#include "daemon/checks/self_checks.h"
#include "daemon/dark_frame.h"
#include "daemon/datum_watch.h"
#include "daemon/export/cad_client.h"
#include "daemon/exposure_search.h"
#include "daemon/frame_feed.h"
#include "daemon/laser_agreement.h"
#include "daemon/profile_log.h"
#include "daemon/results.h"
#include "daemon/safe_on_exit.h"
#include "daemon/scan_capture.h"
#include "daemon/scan_dimensions.h"
#include "daemon/scan_lasers.h"
#include "daemon/scan_log.h"
#include "daemon/scan_preparation.h"
#include "daemon/scan_solution.h"
#include "daemon/scan_stops.h"
#include "daemon/stereo_capture.h"
#include "fitting/range_fit.h"

namespace celadon {
namespace {

tl::unexpected<ScanStop> failed(const std::string& reason, ScanFailure failure = ScanFailure::system) {
  return tl::make_unexpected(ScanStop{ScanState::failed, reason, false, false, failure});
}

/// Wall-clock time of the stages, one after the other.
class StageClock {
 public:
  explicit StageClock(std::vector<StageSeconds>& stages) : stages_(stages) {}
  void end(const char* stage) {
    const auto now = std::chrono::steady_clock::now();
    stages_.push_back({stage, std::chrono::duration<double>(now - start_).count()});
    start_ = now;
  }

 private:
  std::vector<StageSeconds>& stages_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

/// Name of the object in file names.
std::string file_stem(const std::string& name) {
  std::string stem = name.empty() ? "object" : name;
  std::replace(stem.begin(), stem.end(), ' ', '_');
  return stem;
}

/// A grid over what the object shows where it stands and a margin, as fine as the samples to come can carry.
GridSpecification grid_for(const ScanRequest& request, const ScanPreparation& seen, const ScanVolume& volume) {
  constexpr double kMargin = 0.1, kMargin_mm = 2, kSamplesPerCell = 20;
  constexpr int kMostAlong = 64, kMostAround = 32;
  const double margin = kMargin * (seen.z_high_mm - seen.z_low_mm) + kMargin_mm;
  GridSpecification grid;
  grid.z_start_mm = std::max(volume.z_min_mm, seen.z_low_mm - margin);
  grid.z_end_mm = std::min(volume.z_max_mm, seen.z_high_mm + margin);
  grid.degree_u = request.degree_u;
  grid.degree_v = request.degree_v;
  grid.z_intervals = 4;
  grid.intervals_per_arc = 2;
  // No fit seeks more unknowns around than it has profiles for.
  constexpr double kArcs = 4, kProfilesPerUnknown = 1.5;
  const int most_around =
      std::clamp(static_cast<int>(request.profiles / (kArcs * kProfilesPerUnknown)), 2, kMostAround);
  const double cells = static_cast<double>(seen.samples) * request.profiles / kSamplesPerCell;
  while (grid.z_intervals < kMostAlong || 2 * grid.intervals_per_arc <= most_around) {
    const bool along = grid.z_intervals <= 2 * grid.intervals_per_arc && grid.z_intervals < kMostAlong;
    if (2. * grid.z_intervals * 4 * grid.intervals_per_arc > cells) break;
    (along || 2 * grid.intervals_per_arc > most_around ? grid.z_intervals : grid.intervals_per_arc) *= 2;
  }
  return grid;
}

/// What the scan that a recording holds was asked for; what it does not say is as asked now.
ScanTask as_recorded(ScanTask task, const RecordedScan& scan) {
  if (!scan.date.empty()) task.date = scan.date;
  if (!scan.mode.empty()) task.request.mode = scan.mode == "step" ? ScanMode::step : ScanMode::sweep;
  if (scan.profiles > 0) task.request.profiles = scan.profiles;
  return task;
}

/// The same in a few profiles at constant speed, for its report alone.
ScanTask as_dry_turn(ScanTask task) {
  task.request.mode = ScanMode::sweep;
  task.request.profiles = kDryProfiles;
  task.request.formats.clear();
  return task;
}

/// What a dry turn, which took so long to prepare, says of the scan that was asked for.
DryTurn dry_turn_of(const ScanRequest& asked, const ScanEquipment& equipment, const BodyFit& fit,
                    const ViewReading& view, std::int64_t exposure_ns, std::size_t turns, double prepare_s) {
  DryTurn dry;
  dry.profiles = asked.profiles;
  if (asked.mode == ScanMode::sweep && equipment.device != nullptr) {
    dry.seconds = prepare_s + static_cast<double>(turns) * seconds_of_sweep(equipment, asked.profiles);
  }
  // Samples of one surface: its coefficients' variances go as one over their number.
  double sd_mm = 0;
  for (const RangeFit& piece : fit.pieces()) sd_mm = std::max(sd_mm, piece.report.sd_mean_mm);
  dry.sd_mm = sd_mm * std::sqrt(static_cast<double>(kDryProfiles) / asked.profiles);
  dry.view = view;
  dry.exposure = exposure_advice(view, static_cast<double>(exposure_ns) * 1e-6,
                                 static_cast<double>(equipment.camera.mode().frame_period_ns) * 1e-6);
  return dry;
}

/// What the report says of the exposures.
std::vector<TurnExposures> exposures_of(std::span<const LaserTurn> turns) {
  std::vector<TurnExposures> out;
  for (const LaserTurn& turn : turns) out.push_back({turn.laser, turn.plan.stretches()});
  return out;
}

std::vector<ResultFormat> formats_of(const ScanRequest& request) {
  std::vector<ResultFormat> formats;
  if (!request.fits_surface()) return formats;
  for (const std::string& text : request.formats) {
    if (const auto format = result_format_from(text)) formats.push_back(*format);
  }
  return formats;
}

/// About which spherical samples are, where the request makes the head go about it: the crossing of its axis with the
/// table's, in the object's frame.
std::optional<double> centre_of(const ScanRequest& request, const Calibration& calibration, const AxisStop& first) {
  if (request.elevations_deg.empty() || !calibration.elevation) return std::nullopt;
  const auto& lift = calibration.lift;
  return crossing_of(*calibration.elevation).z_mm -
         (lift ? lift->scale.value * first.lift_mm * lift->direction.z() : 0);
}

/// A scan by stereo sees every place in many pairs, and none again after the turn alone.
OverlapResult nothing_compared() {
  OverlapResult overlap;
  overlap.missing = "a scan by stereo does not compare the end of its turn with the beginning";
  return overlap;
}

/// The samples as the result, where no surface was asked for.
tl::expected<ScanOutcome, ScanStop> keep_samples(const ScanEquipment& equipment, const ScanTask& task,
                                                 ProfileLogWriter& log, ResultNotes& notes) {
  notes.warnings.emplace_back(
      "No surface was fitted, as asked: the samples are the result, and none of the checks that need a surface was "
      "made.");
  if (auto synced = log.wait_synced(); !synced) notes.warnings.push_back(synced.error().message);
  std::uint64_t points = 0;
  for (const LaserShare& share : notes.lasers) points += share.samples;
  if (notes.stereo) points += static_cast<std::uint64_t>(notes.stereo->counts.samples());
  auto coloured = coloured_log(equipment, task);
  if (!coloured) return tl::make_unexpected(coloured.error());
  auto files = write_samples(task.log_file, points, task.results_folder, notes, coloured->get());
  if (!files) return failed(files.error().message);
  ScanOutcome outcome;
  outcome.files = std::move(*files);
  outcome.warnings = notes.warnings;
  outcome.checks = notes.checks;
  return outcome;
}

double seconds_of(const ResultNotes& notes, std::initializer_list<const char*> stages) {
  double sum = 0;
  for (const StageSeconds& s : notes.seconds) {
    if (std::find_if(stages.begin(), stages.end(), [&](const char* name) { return s.stage == name; }) != stages.end()) {
      sum += s.seconds;
    }
  }
  return sum;
}

}  // namespace

tl::expected<ScanOutcome, ScanStop> run_scan(const ScanEquipment& equipment, const ScanTask& asked,
                                             ScanObserver& observer) {
  const RecordedScan* const recorded = equipment.camera.recorded();
  const ScanTask task = recorded != nullptr      ? as_recorded(asked, *recorded)
                        : asked.request.dry_turn ? as_dry_turn(asked)
                                                 : asked;
  ResultNotes notes;
  notes.name = file_stem(task.request.name);
  notes.date = task.date;
  notes.warnings = task.warnings;
  notes.machine = machine_of(equipment);
  notes.simulated = is_simulated(equipment) || equipment.calibration.simulated;
  notes.calibration = StatedCalibration{equipment.calibration.date, equipment.calibration.systematic_mm,
                                        equipment.calibration.scale.u / equipment.calibration.scale.value};
  const bool by_stereo = task.request.method == ScanMethod::stereo;
  if (by_stereo && recorded != nullptr) {
    return failed("A recording holds what a scan with a laser used; scan by stereo on a machine.", ScanFailure::device);
  }
  StageClock clock(notes.seconds);
  SafeOnExit safe(equipment.device, observer);

  // Make ready.
  observer.on_state(ScanState::preparing);
  std::vector<TruthPoint> truth;
  if (equipment.truth != nullptr) {
    auto points = equipment.truth->points();
    if (points) truth = std::move(*points);
    if (!points) notes.warnings.push_back("The simulator's truth is not known: " + points.error());
  }
  const auto lasers = lasers_of(task.request, equipment.calibration,
                                lasers_present(equipment.device, equipment.camera, equipment.calibration));
  if (!lasers) return failed(lasers.error(), ScanFailure::device);
  const auto stops = recorded != nullptr ? stops_of(*recorded, equipment.calibration)
                                         : stops_of(task.request, equipment.calibration, travels_of(equipment.device));
  if (!stops) return failed(stops.error(), ScanFailure::device);
  std::vector<LaserExposures> exposures;
  for (const int laser : *lasers) exposures.push_back({laser, {}});
  std::vector<LaserTurn> turns = turns_with(exposures, *stops, equipment.calibration, equipment.volume);
  AxisStop first_stop = stops->front();
  const ExposureOnExit exposure(equipment.camera);
  if (recorded == nullptr) {
    auto ready = make_device_ready(equipment, task, observer);
    if (!ready) return tl::make_unexpected(ready.error());
    const auto stop = bring_axes_to(first_stop, *equipment.device, equipment.calibration);
    if (!stop) return tl::make_unexpected(stop.error());
    first_stop = *stop;
    stand_at(first_stop, turns_at(0, turns), equipment);
  }
  if (by_stereo && !task.recording_folder.empty()) {
    notes.warnings.emplace_back("The frames of this scan are not kept: recordings are of laser lines, not of stereo.");
  }
  const bool by_peaks = task.request.exposure_auto && recorded == nullptr;
  if (by_peaks && !task.recording_folder.empty()) {
    notes.warnings.emplace_back("The frames of this scan are not kept: recordings are of one exposure a turn.");
  }
  const std::vector<int> shining = by_stereo ? std::vector<int>() : *lasers;
  auto recording = open_recording(equipment, task);
  if (!recording) return tl::make_unexpected(recording.error());
  const Triangulator timing = turns.front().triangulator;
  auto feed = FrameFeed::start(equipment, observer, timing, turns.front().laser);
  if (!feed) return tl::make_unexpected(feed.error());
  if (*recording) (*feed)->record_frames_in(**recording);
  std::vector<std::string> unreached;
  if (by_peaks) {
    for (std::size_t k = 0; k < exposures.size(); ++k) {
      (*feed)->use_laser(exposures[k].laser, first_stop);
      auto found = find_exposures(equipment, **feed, turns[k]);
      if (!found) return tl::make_unexpected(found.error());
      exposures[k].plans =
          task.request.mode == ScanMode::sweep ? one_exposure_a_turn(found->plans) : std::move(found->plans);
      std::move(found->unreached.begin(), found->unreached.end(), std::back_inserter(unreached));
    }
    notes.warnings.insert(notes.warnings.end(), unreached.begin(), unreached.end());
    turns = turns_with(exposures, *stops, equipment.calibration, equipment.volume);
    stand_at(first_stop, turns_at(0, turns), equipment);
    notes.exposures = exposures_of(turns_at(0, turns));
  }
  const std::span<LaserTurn> first_turns = turns_at(0, turns);
  std::optional<StereoCapture> stereo;
  if (by_stereo) stereo.emplace(equipment, task.request, **feed);
  auto seen = stereo ? stereo->look() : look_with_each(equipment, **feed, first_turns);
  if (!seen) return tl::make_unexpected(seen.error());
  notes.warnings.insert(notes.warnings.end(), seen->warnings.begin(), seen->warnings.end());
  auto log = open_log(equipment, task, *seen, shining, stops->size());
  if (!log) return tl::make_unexpected(log.error());
  (*feed)->record_in(**log);
  MomentGrid sums(grid_for(task.request, *seen, equipment.volume));
  FirstLook look(sums);
  LaserAgreement agreement(sums.specification(), shining, task.request.profiles);
  ProfileJitter jitter;
  ViewWatch view;
  RoomLightWatch room;
  DatumWatch datum(equipment.calibration, equipment.camera.mode(), shining, turns.front().stop);
  const ScanPreparation& dark = stereo ? *seen : turns.front().seen;
  // Pictures of a quick turn do not show the fiducials at rest.
  if (!by_peaks) datum.at_rest(dark.backgrounds.of(equipment.camera.mode().exposure_ns, 0), dark.background_at_rad);
  clock.end("prepare");

  // Move, frame, line, profile, log, accumulate. The CAD helper starts meanwhile.
  observer.on_state(ScanState::scanning);
  const std::vector<ResultFormat> formats = formats_of(task.request);
  auto cad = std::find(formats.begin(), formats.end(), ResultFormat::step) != formats.end()
                 ? CadWorker::start()
                 : tl::make_unexpected(std::string());
  const CaptureTools tools{equipment, task.request, **feed, **log, sums,  look,
                           agreement, jitter,       view,   room,  datum, observer};
  auto captured = stereo ? stereo->turn(tools) : turn_with_each(tools, turns);
  clock.end("scan");

  // Make safe, whatever came of it; the log is closed in order.
  const std::optional<std::string> unsafe = safe.now();
  // The camera is this look's alone until it is over, and stops with it.
  const auto look_for_light = [&, dark_since_ns = recorded != nullptr ? 0 : equipment.clock.now_ns()] {
    std::optional<std::string> light;
    const LaserTurn& last = turn_of(**feed, turns);
    if (recorded == nullptr && !by_stereo)
      light = light_although_off(equipment.camera, last.triangulator, last.seen, dark_since_ns,
                                 (*feed)->status().angle_rad * equipment.calibration.encoder.scale.value);
    equipment.camera.stop();
    return light;
  };
  auto shines = std::async(captured ? std::launch::async : std::launch::deferred, look_for_light);
  if (!captured) {
    ScanStop& stop = captured.error();
    if (unsafe && !stop.device_lost) stop.reason += " " + *unsafe;
    if (!unsafe && !stop.device_lost && !stop.camera_lost) {
      if (const auto light = shines.get()) stop.reason += " " + *light;
    }
    const bool cancelled = stop.state == ScanState::cancelled;
    (void)(*log)->finish(cancelled ? LogOutcome::cancelled : LogOutcome::failed, stop.reason);
    return tl::make_unexpected(stop);
  }
  if (unsafe) notes.warnings.push_back(*unsafe);
  if (*recording) {
    if (auto kept = (*recording)->finish(); !kept) return failed(kept.error().message);
  }
  notes.scan = captured->counters;
  notes.closure_mm = captured->closure_mm;
  notes.lasers = captured->lasers;
  notes.agreement_mm = agreement.result();
  if (stereo) notes.stereo = stereo->share();
  notes.warnings.insert(notes.warnings.end(), captured->warnings.begin(), captured->warnings.end());
  if (auto finished = (*log)->finish(LogOutcome::complete, ""); !finished) return failed(finished.error().message);
  clock.end("make_safe");
  if (!task.request.fits_surface()) {
    if (const auto light = shines.get(); light && !unsafe) notes.warnings.push_back(*light);
    feed->reset();
    if (const auto reason = observer.cancelled()) return tl::make_unexpected(cancelled_by(*reason));
    observer.on_state(ScanState::exporting);
    notes.checks = datum_checks(datum.result(), equipment.calibration);
    notes.checks.push_back(room_light_check(room.reading(), view.reading().bright_level));
    return keep_samples(equipment, task, **log, notes);
  }

  // Solve, down to the exact NURBS surface.
  observer.on_state(ScanState::solving);
  const RangeFitOptions options = fit_options(task.request, equipment.calibration);
  auto samples = LogParts::open(task.log_file, **log);
  if (!samples) return tl::make_unexpected(samples.error());
  // The sums know the heights that the first stop showed; more stops show more, and faces too.
  auto body = task.request.shape == "cylinder" && stops->size() == 1
                  ? solve_wall(task.log_file, options, sums, look, *samples, notes)
                  : solve_shape(task.request.shape, options, *samples,
                                centre_of(task.request, equipment.calibration, turns.front().stop), notes);
  if (!body) {
    for (const std::string& why : unreached) body.error().reason += " " + why;
    return tl::make_unexpected(body.error());
  }
  clock.end("solve");
  if (const auto light = shines.get(); light && !unsafe) notes.warnings.push_back(*light);
  feed->reset();
  if (const auto reason = observer.cancelled()) return tl::make_unexpected(cancelled_by(*reason));

  // Files and report; the errors of a wall are measured while the CAD file is written.
  observer.on_state(ScanState::exporting);
  std::vector<const RangeFunction*> functions;
  std::vector<FittedSurface> surfaces;
  for (const FittedPiece& piece : body->pieces) {
    functions.push_back(&piece.function);
    surfaces.push_back({piece.function, piece.surface});
  }
  notes.truth_mm = truth_error(functions, truth);
  std::vector<std::string> warnings;
  const auto measured = [&] {
    auto fit = body->measured.get();
    if (!fit) return fit;
    warnings = fit->whole().warnings;
    notes.checks = self_checks(
        {*fit, equipment.calibration, by_stereo ? nothing_compared() : compare_overlap(task.log_file), notes.closure_mm,
         notes.agreement_mm, stops->size() > 1 ? compare_stops(task.log_file, equipment.calibration) : std::nullopt,
         jitter.result()});
    notes.checks.push_back(room_light_check(room.reading(), view.reading().bright_level));
    if (asked.request.dry_turn && recorded == nullptr) {
      notes.dry_turn = dry_turn_of(asked.request, equipment, *fit, view.reading(), equipment.camera.mode().exposure_ns,
                                   turns.size(), seconds_of(notes, {"prepare"}));
      std::vector<SelfCheck> of_view = view_checks(notes.dry_turn->view, notes.dry_turn->exposure);
      std::move(of_view.begin(), of_view.end(), std::back_inserter(notes.checks));
    }
    std::vector<SelfCheck> of_datum = datum_checks(datum.result(), equipment.calibration);
    std::move(of_datum.begin(), of_datum.end(), std::back_inserter(notes.checks));
    if (!by_stereo) notes.dimensions = dimensions_of_scan(*fit, equipment.calibration, task.log_file);
    return fit;
  };
  tl::expected<std::unique_ptr<ProfileLogReader>, ScanStop> coloured = nullptr;
  if (!asked.request.dry_turn) coloured = coloured_log(equipment, task);
  if (!coloured) return tl::make_unexpected(coloured.error());
  auto files = write_results(surfaces, measured, formats, task.results_folder, notes,
                             {.cad = cad ? &*cad : nullptr, .coloured = coloured->get()});
  if (!files) return failed(files.error().message);

  ScanOutcome outcome;
  outcome.files = std::move(*files);
  outcome.warnings = std::move(warnings);
  outcome.warnings.insert(outcome.warnings.end(), notes.warnings.begin(), notes.warnings.end());
  outcome.checks = notes.checks;
  if (auto synced = (*log)->wait_synced(); !synced) outcome.warnings.push_back(synced.error().message);
  if (notes.solid) outcome.last_frame_to_step_s = seconds_of(notes, {"make_safe", "solve", "step"});
  return outcome;
}

}  // namespace celadon
