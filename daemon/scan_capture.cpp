#include "daemon/scan_capture.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <numbers>

#include "acquisition/surface_colour.h"
#include "daemon/bracketed_rows.h"
#include "daemon/closure_test.h"
#include "daemon/mean_frame.h"
#include "daemon/running_fit.h"
#include "daemon/table_turn.h"

namespace celadon {
namespace {

constexpr double kTurn_rad = 2 * std::numbers::pi;
constexpr auto kProgressInterval = std::chrono::milliseconds(100);
constexpr double kLossWorthTelling = 0.01;  // share of frames

tl::unexpected<ScanStop> capture_failed(const std::string& reason) {
  return tl::make_unexpected(ScanStop{ScanState::failed, reason, false, false});
}

/// Instant of the middle row.
std::int64_t middle_of(const CaptureTools& tools, const FrameInfo& frame) {
  const double last_row = static_cast<double>(tools.equipment.camera.mode().height_px) - 1;
  return tools.turn->triangulator.row_instant_ns(frame, last_row / 2);
}

TurnLayout layout_of(const CaptureTools& tools) {
  return {tools.equipment, tools.request.profiles};
}

/// Takes frames to profiles, and profiles to log, sums, closure test and progress.
class Intake {
 public:
  Intake(const CaptureTools& tools, const TurnLayout& turn)
      : tools_(tools),
        turn_(turn),
        closure_(turn.overlap_rad),
        running_fit_(running_options(tools)),
        extractor_({.along = tools.turn->triangulator.along()}),
        rows_(tools.turn->triangulator.line_count()),
        previous_(rows_.size()),
        colour_(tools.equipment.camera.mode(), tools.turn->triangulator.along()),
        backgrounds_(tools.turn->seen.backgrounds) {
    profile_.laser = static_cast<std::uint8_t>(tools.turn->laser);
    share_.laser = tools.turn->laser;
    share_.stop = tools.turn->stop;
    tools.log.append(LogStop{share_.stop});
  }

  /// @param turned_rad  true angle since the start of the turn, 0 .. 2 pi for the fit, beyond it for the closure test
  tl::expected<void, ScanStop> take(Frame frame, const FrameAngle& angle, double turned_rad) {
    const FrameInfo info = frame.info;
    const bool overlap = turned_rad >= kTurn_rad;
    if (auto kept = tools_.feed.keep(frame, angle.middle, overlap ? FrameUse::overlap : FrameUse::turn); !kept) {
      return kept;
    }
    std::swap(rows_, previous_);
    const std::span<const std::uint8_t> background = backgrounds_.of(info.exposure_ns, table_rad(angle.middle));
    const CameraMode& mode = tools_.equipment.camera.mode();
    extractor_.extract(mode, frame.bytes(), background, rows_, previous_);
    room_change_levels_ =
        tools_.room.see(mode, frame.bytes(), background, rows_, tools_.turn->triangulator.along(), turned_rad);
    if (tools_.so_far->turn == 0) {
      tools_.datum.see(
          frame.bytes(),
          [&](double row) { return angle.at(tools_.turn->triangulator.row_instant_ns(info, row)).angle_rad; },
          turned_rad, angle.middle.speed_rad_per_s);
    }
    if (tools_.turn->stop_number == 0) {
      tools_.datum.line(tools_.turn->laser, frame.bytes(), background);
    }
    colour_.read(frame, rows_);
    frame.release();  // the driver gets its buffer back before anything slower happens
    const auto counts = tools_.turn->triangulator.triangulate(
        rows_, info, [&](std::int64_t ns) { return angle.at(ns); }, profile_);
    colour_.give(tools_.turn->triangulator, profile_);
    if (tools_.turn->stop_number == 0) tools_.datum.object(profile_);
    if (is_other_turns(table_rad(angle.middle))) {
      leave_out(profile_);
    } else if (!tools_.turn->other_plan.empty()) {
      leave_to_other_exposure(rows_, info.exposure_ns, tools_.turn->other_plan.at_ns(table_rad(angle.middle)),
                              profile_);
    }
    tools_.so_far->ambiguous += static_cast<std::uint64_t>(counts.ambiguous);
    tools_.feed.verdict(info, profile_.size() > 0 ? FrameVerdict::profile : FrameVerdict::no_line);
    profile_.index = tools_.so_far->profiles++;
    if (overlap) {
      closure_.again(turned_rad, profile_);
    } else {
      closure_.first(turned_rad, profile_);
      tools_.sums.add(profile_.r_mm, profile_.theta_rad, profile_.z_mm);
      tools_.look.add(profile_);
      tools_.agreement.add(profile_);
      tools_.jitter.add(profile_);
      tools_.view.see(rows_, profile_);
      ++share_.profiles;
      share_.samples += profile_.size();
      if (tools_.request.fits_surface()) running_fit_.offer(tools_.sums);
    }
    if (auto logged = tools_.log.append(profile_, overlap); !logged) {
      return tl::make_unexpected(
          ScanStop{ScanState::failed, logged.error().message, false, false, ScanFailure::system});
    }
    report(turned_rad);
    return {};
  }

  /// Of the frame taken last, by how much the room was brighter than in the background.
  double room_change_levels() const { return room_change_levels_; }
  /// Of the frames to come; by a plan of those with that exposure in this part of the turn, others ask for theirs by
  /// what they show.
  void renew_background(std::int64_t exposure_ns, double encoder_rad, std::vector<std::uint8_t> background) {
    const auto part = tools_.turn->plan.empty()
                          ? std::nullopt
                          : std::optional(Backgrounds::part_of(encoder_rad / turn_.encoder_per_true));
    backgrounds_.put(exposure_ns, part, std::move(background));
    tools_.room.renewed();
  }

  CaptureResult result() {
    report(kTurn_rad + turn_.overlap_rad, true);
    CaptureResult result;
    const FrameFeed::Counts& c = tools_.feed.counts();
    result.counters = {tools_.request.mode == ScanMode::step ? "step" : "sweep",
                       tools_.log.counts().profiles,
                       c.frames,
                       c.lost,
                       c.stale,
                       c.corrupt,
                       tools_.so_far->ambiguous};
    result.closure_mm = share_.closure_mm = closure_.result();
    result.lasers = {share_};
    const auto bad = static_cast<double>(c.lost + c.corrupt);
    if (bad > kLossWorthTelling * static_cast<double>(c.frames)) {
      result.warnings.push_back(std::to_string(c.lost) + " frames were lost and " + std::to_string(c.corrupt) +
                                " corrupt of " + std::to_string(c.frames + c.lost) +
                                "; check the camera's cable, its bandwidth and the load of this computer.");
    }
    if (static_cast<double>(c.late) > kLossWorthTelling * static_cast<double>(c.frames)) {
      result.warnings.push_back(std::to_string(c.late) + " of " + std::to_string(c.frames) +
                                " frames reached the driver so late that their time stamps are wrong, and were left "
                                "out; take load off this computer or its USB.");
    }
    if (c.unlit > 0) {
      result.warnings.push_back("The laser's lease had run out at " + std::to_string(c.unlit) + " of " +
                                std::to_string(c.frames) +
                                " frames, which were left out: frames arrive too slowly; choose a smaller picture, or "
                                "take load off this computer or its USB.");
    }
    if (c.looks_dark > 0) {
      result.warnings.push_back("The laser was dark in " + std::to_string(c.looks_dark) + " of " +
                                std::to_string(c.looks_lit) +
                                " looks while it was switched on: it flickers; check its supply and its cable.");
    }
    return result;
  }

 private:
  static RangeFitOptions running_options(const CaptureTools& tools) {
    RangeFitOptions options;
    options.model = SurfaceModel::general;
    options.degree_u = tools.request.degree_u;
    options.degree_v = tools.request.degree_v;
    return options;
  }

  /// A sweep has one exposure: where its plan has another one, the other turn sees it well.
  bool is_other_turns(double table_rad) const {
    const ExposurePlan& plan = tools_.turn->plan;
    return tools_.request.mode == ScanMode::sweep && !tools_.turn->other_plan.empty() &&
           plan.at_ns(table_rad) != plan.longest_ns();
  }
  double table_rad(const AngleAtInstant& encoder) const { return encoder.angle_rad / turn_.encoder_per_true; }

  void report(double turned_rad, bool now = false) {
    const auto time = std::chrono::steady_clock::now();
    if (!now && time - last_report_ < kProgressInterval) return;
    last_report_ = time;
    const CaptureSoFar& so_far = *tools_.so_far;
    const double elapsed_s = std::chrono::duration<double>(time - so_far.start).count();
    const double whole_rad = kTurn_rad + turn_.overlap_rad;
    const double turns = so_far.turn + std::clamp(turned_rad / whole_rad, 0., 1.);
    const FrameFeed::Counts& c = tools_.feed.counts();
    ScanProgress p;
    p.angle_deg = (so_far.turn * whole_rad + turned_rad) * 180 / std::numbers::pi;
    p.fraction = turns / so_far.turns;
    p.frames = static_cast<int>(so_far.profiles);
    p.frames_expected = so_far.turns * (turn_.profiles + turn_.overlap_profiles);
    p.frames_lost = static_cast<int>(c.lost + c.corrupt);
    p.stale_frames = static_cast<int>(c.stale);
    p.frames_per_second = elapsed_s > 0 ? static_cast<double>(so_far.profiles) / elapsed_s : 0;
    p.samples = tools_.sums.samples();
    p.rejected = tools_.sums.rejected();
    p.fit_rms_mm = running_fit_.rms_mm();
    p.seconds_left = p.fraction > 0 ? elapsed_s * (1 - p.fraction) / p.fraction : 0;
    tools_.observer.on_progress(p);
  }

  const CaptureTools& tools_;
  const TurnLayout turn_;
  ClosureTest closure_;
  RunningFit running_fit_;
  LaserLineExtractor extractor_;
  std::vector<LineRow> rows_, previous_;  ///< of this frame and of the one before
  SurfaceColour colour_;
  Backgrounds backgrounds_;
  double room_change_levels_ = 0;
  Profile profile_;
  LaserShare share_;
  std::chrono::steady_clock::time_point last_report_ = std::chrono::steady_clock::now();
};

/// Laser off, background, laser on again: the table stands.
tl::expected<void, ScanStop> look_at_room(const CaptureTools& tools, Intake& intake) {
  if (auto off = tools.feed.laser_off(); !off) return off;
  auto background = dark_background(tools.feed, tools.equipment.clock);
  if (!background) return tl::make_unexpected(background.error());
  intake.renew_background(tools.feed.exposure_in_force_ns(), tools.feed.status().angle_rad, std::move(*background));
  return tools.feed.laser_on();
}

/// What the turn's plan wants at an angle of the encoder.
tl::expected<void, ScanStop> expose_at(const CaptureTools& tools, const TurnLayout& turn, double encoder_rad) {
  if (tools.turn->plan.empty()) return {};
  return tools.feed.expose_for(tools.turn->plan.at_ns(encoder_rad / turn.encoder_per_true));
}

}  // namespace

double seconds_of_sweep(const ScanEquipment& equipment, int profiles) {
  const TableWay way = way_of_sweep(equipment, TurnLayout(equipment, profiles));
  return way.whole_rad / way.speed_rad_per_s;
}

tl::expected<CaptureResult, ScanStop> sweep(const CaptureTools& tools) {
  const TurnLayout turn = layout_of(tools);
  FrameFeed& feed = tools.feed;
  const DeviceCapabilities& limits = tools.equipment.device->capabilities();
  const TableWay way = way_of_sweep(tools.equipment, turn);
  const double speed = way.speed_rad_per_s;
  if (!tools.turn->plan.empty()) {
    if (auto exposed = feed.expose_for(tools.turn->plan.longest_ns()); !exposed)
      return tl::make_unexpected(exposed.error());
  }
  feed.count_lost_frames();
  Intake intake(tools, turn);
  const auto take = [&](Frame frame, const FrameAngle& angle, double turned) {
    return intake.take(std::move(frame), angle, turned);
  };
  auto swept = sweep_table(tools.equipment, feed, turn, tools.turn->triangulator, take);
  if (!swept) return tl::make_unexpected(swept.error());
  CaptureResult result = intake.result();
  if (limits.stamped_by_host) {
    const double longest_s = static_cast<double>(feed.counts().longest_exchange_ns) * 1e-9;
    char text[240];
    std::snprintf(
        text, sizeof text,
        "The drive does not stamp its positions: beside what the encoder leaves open, angles are uncertain by up "
        "to %.4f deg (standard uncertainty; exchanges of up to %.1f ms at %.1f deg/s); scan in steps to be rid "
        "of it.",
        speed * longest_s / std::sqrt(12.) * 180 / std::numbers::pi, longest_s * 1e3, speed * 180 / std::numbers::pi);
    result.warnings.emplace_back(text);
  }
  return result;
}

tl::expected<CaptureResult, ScanStop> step_around(const CaptureTools& tools) {
  const TurnLayout turn = layout_of(tools);
  ScannerDevice& device = *tools.equipment.device;
  FrameFeed& feed = tools.feed;
  const DeviceCapabilities& limits = device.capabilities();
  const double pitch = turn.pitch_rad * turn.encoder_per_true;
  const double base = feed.status().angle_rad;
  const int steps = turn.profiles + turn.overlap_profiles;
  const double target = base + way_of_steps(turn).whole_rad;
  if (!turn_fits_travel(tools.equipment, target)) {
    return capture_failed("The scan needs the table to turn to " + degrees_text(target) + ", but its travel ends at " +
                          degrees_text(limits.travel_rad) + "; home it, or ask for fewer profiles.");
  }
  const double sigma_rad = limits.encoder_resolution_rad / std::sqrt(12.);

  Intake intake(tools, turn);
  for (int k = 0; k < steps; ++k) {
    // Before the move, so that the camera has it when the table rests.
    const double next_rad = base + (k + 1) * pitch;
    if (auto exposed = expose_at(tools, turn, next_rad); !exposed) return tl::make_unexpected(exposed.error());
    auto settled = device.rotate_to(next_rad, limits.max_speed_rad_per_s);
    if (!settled) return tl::make_unexpected(stop_of(settled.error()));
    if (auto on = feed.keep_laser_on(); !on) return tl::make_unexpected(on.error());
    // A move longer than the lease ended it.
    auto frame = feed.next_after(std::max(settled->host_after_ns, feed.shining_since_ns()));
    if (!frame) return tl::make_unexpected(frame.error());
    const AngleAtInstant angle{settled->angle_rad, sigma_rad, 0};
    const double turned = k < turn.profiles ? k * turn.pitch_rad : kTurn_rad + (k - turn.profiles) * turn.pitch_rad;
    const std::int64_t middle_ns = middle_of(tools, frame->info);
    auto taken = intake.take(std::move(*frame), {angle, middle_ns}, turned);
    if (!taken) return tl::make_unexpected(taken.error());
    if (std::abs(intake.room_change_levels()) > kRenewBackground_levels) {
      if (auto looked = look_at_room(tools, intake); !looked) return tl::make_unexpected(looked.error());
    }
  }
  return intake.result();
}

tl::expected<CaptureResult, ScanStop> replay(const CaptureTools& tools) {
  const TurnLayout turn = layout_of(tools);
  FrameSource& camera = tools.equipment.camera;
  camera.stop();  // from its first frame again
  if (auto started = camera.start(); !started) return tl::make_unexpected(stop_of(started.error()));
  Intake intake(tools, turn);
  std::optional<double> start;
  MeanFrame dark;  // a background that was taken anew within the turn
  while (true) {
    if (auto polled = tools.feed.poll(); !polled) return tl::make_unexpected(polled.error());
    auto frame = camera.next(0);
    if (!frame && frame.error().kind == CameraError::Kind::end_of_stream) break;
    if (!frame) return tl::make_unexpected(stop_of(frame.error()));
    const FrameInfo info = frame->info;
    if (!is_of_turn(camera, info, tools.turn->laser, tools.turn->stop)) continue;
    if (info.use == FrameUse::background && start) {
      if (auto added = dark.add(frame->bytes()); !added) return tl::make_unexpected(added.error());
    }
    if (info.use != FrameUse::turn && info.use != FrameUse::overlap) continue;
    if (dark.count() > 0) {
      intake.renew_background(info.exposure_ns, info.table_angle_rad, dark.mean());
      dark = MeanFrame();
    }
    if (!start) start = info.table_angle_rad;
    // Recordings may turn either way.
    double turned = std::abs(turn.turned_rad(*start, info.table_angle_rad));
    if (info.use == FrameUse::overlap) turned = std::max(turned, kTurn_rad);
    const FrameAngle angle{{info.table_angle_rad, info.table_angle_sigma_rad, info.table_speed_rad_per_s},
                           middle_of(tools, info)};
    auto taken = intake.take(std::move(*frame), angle, turned);
    if (!taken) return tl::make_unexpected(taken.error());
  }
  if (!start) return capture_failed("The recording has no frame of a turn; record again.");
  return intake.result();
}

bool turn_fits_travel(const CaptureTools& tools) {
  const TurnLayout turn = layout_of(tools);
  const TableWay way = tools.request.mode == ScanMode::sweep ? way_of_sweep(tools.equipment, turn) : way_of_steps(turn);
  return turn_fits_travel(tools.equipment, tools.feed.status().angle_rad + way.whole_rad);
}

}  // namespace celadon
