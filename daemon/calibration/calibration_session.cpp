#include "daemon/calibration/calibration_session.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <span>
#include <vector>

#include "acquisition/calibrate/board_lines.h"
#include "acquisition/calibrate/view_planner.h"
#include "acquisition/datum/rim_tag_finder.h"
#include "daemon/calibration/axes_home.h"
#include "daemon/calibration/board_passes.h"
#include "daemon/calibration/stop_plan.h"
#include "daemon/calibration/unmeasured.h"
#include "daemon/frame_feed.h"
#include "daemon/safe_on_exit.h"
#include "daemon/scan_preparation.h"
#include "daemon/scan_stops.h"

namespace celadon {
namespace {

constexpr double kStill_px = 0.3;                          // between two looks, of the corners in the middle
constexpr std::int64_t kExposureSettles_ns = 200'000'000;  // cameras take a new exposure some frames later
constexpr std::int64_t kAskAgain_ns = 100'000'000;
constexpr int kRimAngles = 36;      // of the table, a turn, at which fiducials are looked for
constexpr int kFewestAngles = 4;    // of a placement at which the board has to be seen
constexpr double kPassShare = 0.8;  // of the angles that show the board, over which it passes the camera
constexpr double kPass_rad = 35 * std::numbers::pi / 180;  // at most, to both sides
constexpr double kReach = 0.3;  // share of the picture's height that the lift moves the board by, to both sides

using Stop = tl::unexpected<ScanStop>;

/// A frame's bytes, and its grey levels without padding.
struct Picture {
  std::vector<std::uint8_t> bytes, grey;
};

Picture picture_of(const CameraMode& mode, std::span<const std::uint8_t> bytes) {
  Picture picture;
  picture.bytes.assign(bytes.begin(), bytes.end());
  const auto width = static_cast<std::size_t>(mode.width_px), step = bytes_per_pixel(mode.format);
  for (std::size_t y = 0; y < static_cast<std::size_t>(mode.height_px); ++y) {
    const std::uint8_t* const row = picture.bytes.data() + y * mode.stride_bytes;
    for (std::size_t x = 0; x < width; ++x) picture.grey.push_back(row[x * step]);
  }
  return picture;
}

std::vector<std::uint8_t> over_the_diagonal(const std::vector<std::uint8_t>& grey, std::size_t width) {
  std::vector<std::uint8_t> turned(grey.size());
  const std::size_t height = grey.size() / width;
  for (std::size_t y = 0; y < height; ++y) {
    for (std::size_t x = 0; x < width; ++x) turned[x * height + y] = grey[y * width + x];
  }
  return turned;
}

/// Median distance of corners that both looks have; infinite without any.
double moved_px(std::span<const SeenCorner> before, std::span<const SeenCorner> now) {
  std::map<int, Eigen::Vector2d> was;
  for (const SeenCorner& c : before) was[c.id] = c.p_px;
  std::vector<double> moved;
  for (const SeenCorner& c : now) {
    if (const auto at = was.find(c.id); at != was.end()) moved.push_back((c.p_px - at->second).norm());
  }
  if (moved.empty()) return std::numeric_limits<double>::infinity();
  const auto middle = moved.begin() + static_cast<std::ptrdiff_t>(moved.size() / 2);
  std::nth_element(moved.begin(), middle, moved.end());
  return *middle;
}

class Session final : public ScanObserver {
 public:
  Session(ScannerConnection& machine, const CalibrationPlan& plan, CalibrationGuide& guide)
      : plan_(plan),
        guide_(guide),
        device_(*machine.device),
        nothing_known_(nothing_known(machine)),
        equipment_{machine.device.get(), *machine.camera, *machine.clock, nothing_known_, nullptr, {}},
        triangulator_(nothing_known_, 0, equipment_.volume),
        finder_(plan.board),
        rows_(static_cast<std::size_t>(mode().height_px)) {}

  tl::expected<CalibrationInput, ScanStop> run() {
    SafeOnExit safe(&device_, *this);
    ScanTask task;
    task.request.exposure_ms = plan_.exposure_ms;
    task.from_afar = plan_.from_afar;
    guide_.on_state(ScanState::preparing);
    if (auto ready = make_device_ready(equipment_, task, *this); !ready) return Stop(ready.error());
    // What is calibrated is the machine with its other axes at 0.
    if (auto brought = bring_axes_to({}, device_, nothing_known_); !brought) return Stop(brought.error());
    auto feed = FrameFeed::start(equipment_, *this, triangulator_, 0);
    if (!feed) return Stop(feed.error());
    feed_ = std::move(*feed);
    CalibrationInput input{.board = plan_.board,
                           .width_px = mode().width_px,
                           .height_px = mode().height_px,
                           .views = {},
                           .platter = {},
                           .rim = {},
                           .pitch_x = plan_.pitch_x,
                           .pitch_y = plan_.pitch_y,
                           .assumed_time = assumed_time(mode())};
    auto taken = take_held_views(input);
    for (int placement = 0; taken && placement < plan_.placements; ++placement) {
      taken = take_placement(placement, input);
    }
    if (taken) taken = take_platter(input);
    if (taken) taken = take_rim(input);
    feed_.reset();
    if (!taken) return Stop(taken.error());
    if (const auto unsafe = safe.now()) return Stop(ScanStop{ScanState::failed, *unsafe, true, false});
    return input;
  }

  void on_state(ScanState) override {}
  void on_progress(const ScanProgress&) override {}
  void on_status(const DeviceStatus& status) override { guide_.on_status(status); }
  std::optional<std::string> cancelled() override { return guide_.cancelled(); }

 private:
  const CameraMode& mode() const { return equipment_.camera.mode(); }
  GreyView view(const Picture& picture) const { return {picture.grey, mode().width_px, mode().height_px}; }

  tl::expected<Picture, ScanStop> look(std::int64_t after_ns) {
    auto frame = feed_->next_after(after_ns);
    if (!frame) return Stop(frame.error());
    return picture_of(mode(), frame->bytes());
  }

  tl::expected<std::vector<SeenCorner>, std::string> find(const Picture& picture) {
    return finder_.find(picture.grey, mode().width_px, mode().height_px);
  }

  /// The picture with one laser on.
  tl::expected<Picture, ScanStop> look_lit(int laser) {
    feed_->use_laser(laser);
    if (auto on = feed_->laser_on(); !on) return Stop(on.error());
    auto lit = look(feed_->shining_since_ns());
    if (auto off = feed_->laser_off(); !off) return Stop(off.error());
    return lit;
  }

  /// The view of a board that was found in `dark`, with every laser's line on it.
  tl::expected<BoardView, ScanStop> lit_view(const std::vector<SeenCorner>& corners, const Picture& dark) {
    BoardView seen;
    seen.corners = corners;
    for (int laser = 0; laser < device_.capabilities().lasers; ++laser) {
      auto lit = look_lit(laser);
      if (!lit) return Stop(lit.error());
      extractor_.extract(mode(), lit->bytes, dark.bytes, rows_);
      auto points = line_points_on_board(plan_.board, corners, view(dark), rows_);
      if (!points.empty()) seen.lines.push_back({laser, std::move(points)});
    }
    return seen;
  }

  tl::expected<void, ScanStop> take_held_views(CalibrationInput& input) {
    if (plan_.held_views == 0) return {};
    ViewPlanner planner(plan_.board, mode().width_px, mode().height_px, plan_.held_views);
    if (auto done = ask("Hold the board in front of the camera, still for a second in each place."); !done) return done;
    std::vector<SeenCorner> before;
    std::int64_t after_ns = equipment_.clock.now_ns();
    while (!planner.complete()) {
      auto dark = look(after_ns);
      if (!dark) return Stop(dark.error());
      BoardLook told;
      auto found = find(*dark);
      told.found = found.has_value();
      if (!found) told.problem = found.error();
      if (found) {
        told.still = moved_px(before, *found) < kStill_px;
        told.known = !planner.is_new(*found);
        before = *found;
        if (told.still && !told.known) {
          auto seen = lit_view(*found, *dark);
          if (!seen) return Stop(seen.error());
          auto afterwards = look(equipment_.clock.now_ns());
          if (!afterwards) return Stop(afterwards.error());
          const auto there = find(*afterwards);
          told.still = there && moved_px(*found, *there) < kStill_px;
          if (told.still) {
            planner.add(*found);
            input.views.push_back(std::move(*seen));
          }
        }
      }
      told.views = planner.views();
      told.wanted = planner.wanted();
      told.advice = planner.advice();
      guide_.on_look(told);
      after_ns = 0;
    }
    return {};
  }

  tl::expected<void, ScanStop> take_placement(int placement, CalibrationInput& input) {
    // Together the placements, each facing the camera, show the encoder's whole turn.
    const double now_rad = feed_->status().angle_rad, share_rad = 2 * std::numbers::pi * placement / plan_.placements;
    if (auto on = turn_to(now_rad + std::remainder(share_rad - now_rad, 2 * std::numbers::pi)); !on) {
      return Stop(on.error());
    }
    const char* const leaning = stops_of_head() > 0 ? ", leaning back as far as it stands" : "";
    std::string instruction = "Stand the board on the platter, facing the camera" + std::string(leaning) +
                              ", and let go of it (placement " + std::to_string(placement + 1) + " of " +
                              std::to_string(plan_.placements) + ").";
    while (true) {
      if (auto done = ask(instruction); !done) return done;
      auto views = take_turn(placement);
      if (!views) return Stop(views.error());
      if (static_cast<int>(views->size()) < kFewestAngles) {
        instruction = "The board was seen at " + std::to_string(views->size()) + " of " + std::to_string(plan_.angles) +
                      " angles of the table; stand it upright over the middle of the platter, facing the camera.";
        continue;
      }
      if (placement < plan_.timed_placements) {
        auto passes = take_passes_of(placement, *views);
        if (!passes) return Stop(passes.error());
        std::move(passes->begin(), passes->end(), std::back_inserter(input.sweeps));
      }
      auto at_stops = take_stops(placement, *views);
      if (!at_stops) return Stop(at_stops.error());
      input.views.insert(input.views.end(), views->begin(), views->end());
      input.views.insert(input.views.end(), at_stops->begin(), at_stops->end());
      return {};
    }
  }

  /// The board at every angle of the table that shows it, with every laser's line.
  tl::expected<std::vector<BoardView>, ScanStop> take_turn(int placement) {
    std::vector<BoardView> views;
    const double start_rad = feed_->status().angle_rad;
    for (int k = 0; k < plan_.angles; ++k) {
      // One step before the first look: each angle is approached from the same side.
      auto settled = turn_to(start_rad + (k + 1) * step_rad());
      if (!settled) return Stop(settled.error());
      auto dark = look(settled->host_after_ns);
      if (!dark) return Stop(dark.error());
      const auto found = find(*dark);
      guide_.on_turn(placement, k + 1, plan_.angles, found.has_value());
      if (!found) continue;
      auto seen = lit_view(*found, *dark);
      if (!seen) return Stop(seen.error());
      stand(placement, *settled, *seen);
      views.push_back(std::move(*seen));
    }
    return views;
  }

  /// @pre `turn` is not empty
  tl::expected<std::vector<BoardSweep>, ScanStop> take_passes_of(int placement, const std::vector<BoardView>& turn) {
    const double half_rad = std::min(kPass_rad, kPassShare * static_cast<double>(turn.size()) * step_rad() / 2);
    const PassTools tools{equipment_, *feed_, [&](std::span<const std::uint8_t> bytes) {
                            return find(picture_of(mode(), bytes)).value_or(std::vector<SeenCorner>{});
                          }};
    auto passes = take_passes(tools, placement, facing_view(turn, 0).encoder_rad, half_rad);
    if (!passes) return passes;
    int found = 0;
    for (const BoardSweep& pass : *passes) {
      for (const MovingView& view : pass.views) found += view.corners.empty() ? 0 : 1;
    }
    guide_.on_passes(placement, found);
    return passes;
  }

  int stops_of_head() const { return device_.has_axis(AxisKind::elevation) ? plan_.stops : 0; }

  /// The same board from every stop that shows it, at three of the table's angles in turn. Each view has a stop of its
  /// own, so that what a reading is off by is no other view's. @pre `turn` is not empty
  tl::expected<std::vector<BoardView>, ScanStop> take_stops(int placement, const std::vector<BoardView>& turn) {
    const BoardView& facing = facing_view(turn, 0);
    const double px_per_mm = appearance_of(plan_.board, facing.corners).px_per_mm;
    const std::vector<AxisStop> stops = stops_to_visit(device_.capabilities(), plan_.stops, placement, plan_.placements,
                                                       kReach * mode().height_px / px_per_mm);
    std::vector<BoardView> views;
    if (stops.empty()) return views;
    AxesHome home(device_, nothing_known_);
    for (std::size_t k = 0; k < stops.size(); ++k) {
      const double aside = (static_cast<double>(k % 3) - 1) / 6;
      auto seen = view_from(stops[k], placement, facing_view(turn, aside).encoder_rad);
      if (!seen) {
        if (seen.error().state == ScanState::cancelled && !guide_.cancelled()) home.stay();
        return Stop(seen.error());
      }
      guide_.on_stop(placement, stops[k], !(*seen).corners.empty());
      if (!(*seen).corners.empty()) views.push_back(std::move(*seen));
    }
    if (auto back = home.now(); !back) return Stop(back.error());
    return views;
  }

  /// Without corners where the board is not seen.
  tl::expected<BoardView, ScanStop> view_from(const AxisStop& stop, int placement, double angle_rad) {
    if (auto brought = bring_axes_to(stop, device_, nothing_known_); !brought) return Stop(brought.error());
    if (auto before = turn_to(angle_rad - step_rad()); !before) return Stop(before.error());
    auto settled = turn_to(angle_rad);
    if (!settled) return Stop(settled.error());
    auto dark = look(settled->host_after_ns);
    if (!dark) return Stop(dark.error());
    BoardView seen;
    if (auto found = find(*dark)) seen.corners = std::move(*found);
    stand(placement, *settled, seen);
    return seen;
  }

  /// The view of a turn that lies nearest to its middle, moved on by a share of the angles that show the board.
  const BoardView& facing_view(const std::vector<BoardView>& turn, double share) const {
    double x = 0, y = 0;
    for (const BoardView& view : turn) {
      x += std::cos(view.encoder_rad);
      y += std::sin(view.encoder_rad);
    }
    const double wanted_rad = std::atan2(y, x) + share * static_cast<double>(turn.size()) * step_rad();
    return *std::max_element(turn.begin(), turn.end(), [&](const BoardView& a, const BoardView& b) {
      return std::cos(a.encoder_rad - wanted_rad) < std::cos(b.encoder_rad - wanted_rad);
    });
  }

  double step_rad() const { return 2 * std::numbers::pi / plan_.angles; }

  tl::expected<DeviceStatus, ScanStop> turn_to(double angle_rad) {
    auto settled = device_.rotate_to(angle_rad, device_.capabilities().max_speed_rad_per_s);
    if (!settled) return Stop(stop_of(settled.error()));
    return *settled;
  }

  /// Writes down where the machine stood while a view was taken.
  static void stand(int placement, const DeviceStatus& settled, BoardView& view) {
    view.placement = placement;
    view.encoder_rad = settled.angle_rad;
    if (settled.elevation) view.stop.elevation_rad = settled.elevation->position;
    if (settled.lift) view.stop.lift_mm = settled.lift->position;
  }

  tl::expected<void, ScanStop> take_platter(CalibrationInput& input) {
    std::string instruction = "Take everything off the platter.";
    while (true) {
      if (auto done = ask(instruction); !done) return done;
      // Platters are dark, and seen from the side.
      for (const double longer : {1., 4., 16.}) {
        if (auto seen = look_at_platter(longer, input.platter); !seen) return seen;
        if (!input.platter.empty()) return {};
      }
      instruction = "No laser line is seen on the platter: take everything off it, and check the lasers.";
    }
  }

  tl::expected<void, ScanStop> look_at_platter(double longer, std::vector<SeenLine>& lines) {
    const std::int64_t usual_ns = mode().exposure_ns;
    const auto longer_ns = static_cast<std::int64_t>(longer * static_cast<double>(usual_ns));
    if (longer_ns > usual_ns && longer_ns < mode().frame_period_ns) {
      if (auto set = equipment_.camera.set_exposure(longer_ns); !set) return Stop(stop_of(set.error()));
    } else if (longer > 1) {
      return {};
    }
    auto seen = lines_on_platter(lines);
    if (longer > 1) {
      if (auto back = equipment_.camera.set_exposure(usual_ns); !back) return Stop(stop_of(back.error()));
    }
    return seen;
  }

  tl::expected<void, ScanStop> lines_on_platter(std::vector<SeenLine>& lines) {
    auto dark = look(equipment_.clock.now_ns() + kExposureSettles_ns);
    if (!dark) return Stop(dark.error());
    const auto width = static_cast<std::size_t>(mode().width_px), height = static_cast<std::size_t>(mode().height_px);
    CameraMode turned;
    turned.width_px = mode().height_px;
    turned.height_px = mode().width_px;
    turned.stride_bytes = height;
    std::vector<LineRow> columns(width);
    for (int laser = 0; laser < device_.capabilities().lasers; ++laser) {
      auto lit = look_lit(laser);
      if (!lit) return Stop(lit.error());
      extractor_.extract(mode(), lit->bytes, dark->bytes, rows_);
      extractor_.extract(turned, over_the_diagonal(lit->grey, width), over_the_diagonal(dark->grey, width), columns);
      auto points = straight_line(rows_, columns);
      if (!points.empty()) lines.push_back({laser, std::move(points)});
    }
    return {};
  }

  /// The platter's fiducials, all round. @pre nothing else lies on the platter
  tl::expected<void, ScanStop> take_rim(CalibrationInput& input) {
    RimTagFinder finder;
    const double step = 2 * std::numbers::pi / kRimAngles, start_rad = feed_->status().angle_rad;
    std::vector<RimView> views;
    std::size_t tags = 0;
    for (int k = 0; k < kRimAngles; ++k) {
      auto settled = turn_to(start_rad + (k + 1) * step);
      if (!settled) return Stop(settled.error());
      auto dark = look(settled->host_after_ns);
      if (!dark) return Stop(dark.error());
      views.push_back({settled->angle_rad, finder.find(dark->grey, mode().width_px, mode().height_px)});
      tags += views.back().tags.size();
      // A third of a turn without any: this platter has none.
      if (tags == 0 && 3 * (k + 1) >= kRimAngles) return {};
    }
    input.rim = std::move(views);
    return {};
  }

  /// Waits for the operator. The machine is polled meanwhile: its controller stops whatever no host looks at.
  tl::expected<void, ScanStop> ask(const std::string& instruction) {
    guide_.ask(instruction);
    bool from_afar = false;
    while (true) {
      if (guide_.done()) {
        from_afar = guide_.done_from_afar();
        break;
      }
      if (const auto whom = guide_.cancelled()) return Stop(cancelled_by(*whom));
      auto status = device_.poll();
      if (!status) return Stop(stop_of(status.error()));
      on_status(*status);
      if (device_.take_button_presses() > 0) break;
      equipment_.clock.sleep_until(equipment_.clock.now_ns() + kAskAgain_ns);
    }
    if (from_afar) {
      if (auto warned = warn(); !warned) return warned;
    }
    guide_.on_state(ScanState::scanning);
    return feed_->poll();
  }

  /// As before a scan from afar: whoever still has a hand at the board takes it away, or presses the button.
  tl::expected<void, ScanStop> warn() {
    guide_.on_state(ScanState::preparing);
    ScanTask task;
    task.from_afar = true;
    return make_device_ready(equipment_, task, *this);
  }

  const CalibrationPlan& plan_;
  CalibrationGuide& guide_;
  ScannerDevice& device_;
  const Calibration nothing_known_;
  const ScanEquipment equipment_;
  const Triangulator triangulator_;
  BoardFinder finder_;
  LaserLineExtractor extractor_;
  std::vector<LineRow> rows_;
  std::unique_ptr<FrameFeed> feed_;
};

}  // namespace

tl::expected<CalibrationInput, ScanStop> take_calibration_views(ScannerConnection& machine, const CalibrationPlan& plan,
                                                                CalibrationGuide& guide) {
  return Session(machine, plan, guide).run();
}

}  // namespace celadon
