#include "daemon/frame_feed.h"

#include <algorithm>
#include <cstdio>

namespace celadon {
namespace {

constexpr std::int64_t kRestLimit_ns = 30'000'000'000;
constexpr std::int64_t kMillisecond_ns = 1'000'000;
constexpr std::int64_t kCameraSilence_ns = 2'000 * kMillisecond_ns;
constexpr int kMostStaleFrames = 200;
constexpr int kMostUnlitFrames = 20;                           // in a row
constexpr std::int64_t kDarkLimit_ns = 100 * kMillisecond_ns;  // of a laser that is switched on
constexpr std::int64_t kStampSlack_ns = 5 * kMillisecond_ns;

std::string milliseconds(std::int64_t ns) {
  char text[32];
  std::snprintf(text, sizeof text, "%.0f ms", static_cast<double>(ns) / 1e6);
  return text;
}

}  // namespace

ScanStop stop_of(const DeviceError& error) {
  using Kind = DeviceError::Kind;
  if (error.kind == Kind::interrupted) return cancelled_by(error.cause + " during \"" + error.operation + "\"");
  const bool lost = error.kind == Kind::lost || error.kind == Kind::timed_out || error.kind == Kind::not_found ||
                    error.kind == Kind::broken_reply || error.kind == Kind::system;
  return {ScanState::failed, error.message(), lost, false};
}

ScanStop stop_of(const CameraError& error) {
  return {ScanState::failed, error.message, false, true};
}

ScanStop cancelled_by(const std::string& whom) {
  return {ScanState::cancelled, "It was cancelled " + whom + "; what a scan recorded is kept, start again.", false,
          false};
}

tl::expected<std::unique_ptr<FrameFeed>, ScanStop> FrameFeed::start(const ScanEquipment& equipment,
                                                                    ScanObserver& observer,
                                                                    const Triangulator& triangulator, int laser) {
  const std::int64_t period_ns = equipment.camera.mode().frame_period_ns;
  const std::int64_t lease_ns =
      equipment.device != nullptr ? equipment.device->capabilities().lease_ms * kMillisecond_ns : INT64_MAX;
  if (period_ns > lease_ns / 2) {
    return tl::make_unexpected(ScanStop{ScanState::failed,
                                        "The camera's frame period of " + milliseconds(period_ns) +
                                            " is longer than half the laser's lease of " + milliseconds(lease_ns) +
                                            ", so that the laser would go out between frames; choose a faster mode.",
                                        false, false});
  }
  std::unique_ptr<FrameFeed> feed(new FrameFeed(equipment, observer, triangulator, laser));
  if (auto started = equipment.camera.start(); !started) {
    ScanStop stop = stop_of(started.error());
    stop.camera_was_gone = true;
    return tl::make_unexpected(std::move(stop));
  }
  if (auto polled = feed->poll(); !polled) return tl::make_unexpected(polled.error());
  return feed;
}

FrameFeed::FrameFeed(const ScanEquipment& equipment, ScanObserver& observer, const Triangulator& triangulator,
                     int laser)
    : equipment_(equipment),
      observer_(observer),
      triangulator_(triangulator),
      laser_(laser),
      timeline_(equipment.device != nullptr ? equipment.device->capabilities().encoder_resolution_rad : 0,
                equipment.device != nullptr && equipment.device->capabilities().stamped_by_host
                    ? StampedBy::host
                    : StampedBy::controller),
      arrivals_(equipment.camera.mode().frame_period_ns) {}

FrameFeed::~FrameFeed() {
  equipment_.camera.stop();
}

/// What the controller reports that no scan can go on with.
std::optional<ScanStop> FrameFeed::unfit() const {
  const auto stop = [](const std::string& reason) { return ScanStop{ScanState::failed, reason, false, false}; };
  if (status_.emergency_stop) {
    return stop("The emergency stop is pressed; release it, press the button on the machine and start again.");
  }
  if (!status_.interlock_closed) {
    return stop("The interlock is open; close the cover, press the button on the machine and start again.");
  }
  if (status_.fault_code != 0) {
    return stop("The controller reports fault " + std::to_string(status_.fault_code) + ", " + status_.fault_text +
                "; remove the cause and start again.");
  }
  return std::nullopt;
}

/// A laser that should shine, as the controller measures it. Moments without light are counted; longer ones end the
/// scan.
std::optional<ScanStop> FrameFeed::dark_laser() {
  const std::int64_t now_ns = status_.host_after_ns;
  if (!lit_ || status_.lease_left_ms == 0 || now_ns - shining_since_ns() < kDarkLimit_ns) {
    dark_since_ns_ = 0;
    return std::nullopt;
  }
  ++counts_.looks_lit;
  if ((status_.lasers_on >> laser_ & 1) != 0) {
    dark_since_ns_ = 0;
    return std::nullopt;
  }
  ++counts_.looks_dark;
  if (dark_since_ns_ == 0) dark_since_ns_ = now_ns;
  if (now_ns - dark_since_ns_ < kDarkLimit_ns) return std::nullopt;
  return ScanStop{ScanState::failed,
                  "Laser " + std::to_string(laser_) +
                      " does not emit although it is switched on; check its supply and its cable, then start again.",
                  false, false};
}

tl::expected<void, ScanStop> FrameFeed::poll() {
  if (const auto reason = observer_.cancelled()) return tl::make_unexpected(cancelled_by(*reason));
  if (equipment_.device == nullptr) return {};
  auto status = equipment_.device->poll();
  if (!status) return tl::make_unexpected(stop_of(status.error()));
  status_ = *status;
  observer_.on_status(status_);
  if (equipment_.device->take_button_presses() > 0) {
    return tl::make_unexpected(cancelled_by("by the button on the machine"));
  }
  if (auto stop = unfit()) return tl::make_unexpected(*stop);
  if (auto stop = dark_laser()) return tl::make_unexpected(*stop);
  const PositionSample sample{status_.position_counter, status_.position_time_us, status_.angle_rad,
                              status_.host_before_ns,   status_.host_after_ns,    status_.uptime_us};
  timeline_.add(sample);
  if (equipment_.device->capabilities().stamped_by_host)
    counts_.longest_exchange_ns = std::max(counts_.longest_exchange_ns, sample.host_after_ns - sample.host_before_ns);
  if (log_ != nullptr) log_->append(sample);
  return {};
}

tl::expected<void, ScanStop> FrameFeed::renew_lease(bool granting) {
  const std::int64_t lease_ms = equipment_.device->capabilities().lease_ms;
  const std::int64_t now_ns = equipment_.clock.now_ns();
  if (!granting && now_ns - granted_ns_ < lease_ms * kMillisecond_ns / 3) return {};
  if (auto renewed = equipment_.device->renew_laser(laser_, lease_ms); !renewed) {
    // One lost answer: the lease ends, the next good frame asks for a new one. A link that is dead shows at the next
    // poll.
    if (!granting && renewed.error().kind == DeviceError::Kind::timed_out) return {};
    return tl::make_unexpected(stop_of(renewed.error()));
  }
  granted_ns_ = now_ns;
  leases_.grant(now_ns, equipment_.clock.now_ns(), lease_ms * kMillisecond_ns);
  return {};
}

tl::expected<void, ScanStop> FrameFeed::expose_for(std::int64_t exposure_ns) {
  if (exposure_ns == exposure_asked_ns_) return {};
  auto in_force = equipment_.camera.set_exposure(exposure_ns);
  if (!in_force) {
    ScanStop stop = stop_of(in_force.error());
    stop.camera_lost = in_force.error().kind == CameraError::Kind::unplugged;
    return tl::make_unexpected(std::move(stop));
  }
  exposure_asked_ns_ = exposure_ns;
  exposure_in_force_ns_ = *in_force;
  return {};
}

tl::expected<void, ScanStop> FrameFeed::laser_on() {
  lit_ = true;
  return renew_lease(true);
}

tl::expected<void, ScanStop> FrameFeed::laser_off() {
  lit_ = false;
  leases_.end(equipment_.clock.now_ns());
  if (auto off = equipment_.device->laser_off(); !off) return tl::make_unexpected(stop_of(off.error()));
  return {};
}

/// Stamps of the host's clock cannot lie in its future, nor go back.
std::optional<ScanStop> FrameFeed::wrong_stamp(const FrameInfo& frame) const {
  const std::int64_t future_ns = frame.stamp_ns - status_.host_after_ns;
  const std::int64_t back_ns = last_stamp_ns_ == INT64_MIN ? 0 : last_stamp_ns_ - frame.stamp_ns;
  std::string what;
  if (future_ns > kStampSlack_ns) what = "lies " + milliseconds(future_ns) + " in the future";
  if (back_ns > 2 * equipment_.camera.mode().frame_period_ns)
    what = "is " + milliseconds(back_ns) + " older than the last";
  if (what.empty()) return std::nullopt;
  return ScanStop{ScanState::failed,
                  "The time stamp of frame " + std::to_string(frame.sequence) + " " + what +
                      ": the clock that stamps frames was set. Start a new scan; if it comes again, check the camera's "
                      "driver.",
                  false, true};
}

ArrivalWatch::Exposure FrameFeed::exposure_of(const FrameInfo& frame) const {
  return {frame.sequence, triangulator_.row_instant_ns(frame, 0) - frame.exposure_ns / 2};
}

/// A loop that gets frames more slowly than the lease lasts sees some of them without the laser.
LeaseHistory::Light FrameFeed::light_on(const FrameInfo& frame) const {
  if (!lit_) return LeaseHistory::Light::on;  // nobody asked for it
  const double last_row = static_cast<double>(equipment_.camera.mode().height_px) - 1;
  const std::int64_t half_ns = frame.exposure_ns / 2;
  return leases_.between(triangulator_.row_instant_ns(frame, 0) - half_ns,
                         triangulator_.row_instant_ns(frame, last_row) + half_ns);
}

std::optional<ScanStop> FrameFeed::too_slow(int unlit_frames, const FrameInfo& frame) const {
  if (unlit_frames < kMostUnlitFrames) return std::nullopt;
  return ScanStop{
      ScanState::failed,
      "The laser's lease of " + std::to_string(equipment_.device->capabilities().lease_ms) +
          " ms had run out at each of the last " + std::to_string(unlit_frames) + " frames, up to frame " +
          std::to_string(frame.sequence) +
          ": frames arrive too slowly; choose a smaller picture, or take load off this computer or its USB.",
      false, true};
}

tl::expected<Frame, ScanStop> FrameFeed::next() {
  for (int unlit = 0;;) {
    auto frame = next_whole();
    if (!frame) return frame;
    if (!frame->info.exposure_sure) {
      verdict(frame->info, FrameVerdict::stale);
      continue;
    }
    if (light_on(frame->info) != LeaseHistory::Light::not_sure) return frame;
    verdict(frame->info, FrameVerdict::unlit);
    if (auto stop = too_slow(++unlit, frame->info)) return tl::make_unexpected(*stop);
  }
}

/// A frame that is whole and new, whatever the laser did.
tl::expected<Frame, ScanStop> FrameFeed::next_whole() {
  const std::int64_t period_ns = equipment_.camera.mode().frame_period_ns;
  const std::int64_t wait_ns = std::max(4 * period_ns, 250 * kMillisecond_ns);
  std::int64_t silent_ns = 0;  // without a good frame; and the lease runs out: only those renew it
  int damaged = 0;
  while (true) {
    auto frame = equipment_.camera.next(wait_ns);
    if (!frame && frame.error().kind != CameraError::Kind::timed_out)
      return tl::make_unexpected(stop_of(frame.error()));
    if (frame && !counts_lost_) frame->info.lost_before = 0;
    const bool good = frame && !frame->info.corrupt && frame->info.stamp_ns != last_stamp_ns_;
    if (good && lit_) {
      if (auto renewed = renew_lease(false); !renewed) return tl::make_unexpected(renewed.error());
    }
    if (auto polled = poll(); !polled) return tl::make_unexpected(polled.error());
    if (good) {
      if (auto stop = wrong_stamp(frame->info)) return tl::make_unexpected(*stop);
      last_stamp_ns_ = frame->info.stamp_ns;
      arrivals_.see(exposure_of(frame->info));
      return std::move(*frame);
    }
    silent_ns += frame ? period_ns : wait_ns;
    if (frame) {
      ++damaged;
      verdict(frame->info, frame->info.corrupt ? FrameVerdict::corrupt : FrameVerdict::stale);
    }
    if (silent_ns < kCameraSilence_ns) continue;
    const std::string what =
        damaged == 0 ? "no frame for " : "no good frame, but " + std::to_string(damaged) + " damaged ones, for ";
    return tl::make_unexpected(ScanStop{ScanState::failed,
                                        "The camera delivered " + what + milliseconds(silent_ns) +
                                            "; check its cable and power, then start again." +
                                            (frame ? "" : " (" + frame.error().message + ")"),
                                        false, true});
  }
}

tl::expected<Frame, ScanStop> FrameFeed::next_after(std::int64_t instant_ns) {
  std::optional<Frame> doubtful;  // good but for its stamp, which the next frame confirms
  for (int stale = 0, unlit = 0; stale < kMostStaleFrames;) {
    auto frame = next_whole();
    if (!frame) return frame;
    const FrameInfo& info = frame->info;
    const ArrivalWatch::Exposure exposure = exposure_of(info);
    if (doubtful) {
      if (!came_late(doubtful->info, info)) {
        arrivals_.trust(exposure_of(doubtful->info), exposure);
        verdict(info, FrameVerdict::stale);
        return std::move(*doubtful);
      }
      leave_out_late(doubtful->info);
      ++stale;
      doubtful.reset();
    }
    const LeaseHistory::Light light = light_on(info);
    const bool other_exposure = exposure_in_force_ns_ != 0 && info.exposure_ns != exposure_in_force_ns_;
    if (!info.exposure_sure || other_exposure || exposure.began_ns < instant_ns ||
        light == LeaseHistory::Light::warming_up) {
      verdict(info, FrameVerdict::stale);
      ++stale;
    } else if (light == LeaseHistory::Light::not_sure) {
      verdict(info, FrameVerdict::unlit);
      if (auto stop = too_slow(++unlit, info)) return tl::make_unexpected(*stop);
    } else if (arrivals_.may_be_late()) {
      doubtful = std::move(*frame);
    } else {
      return frame;
    }
  }
  return tl::make_unexpected(
      ScanStop{ScanState::failed,
               "The camera delivered " + std::to_string(kMostStaleFrames) +
                   " frames in a row whose time stamps lie before the table came to rest; check the calibration's time "
                   "model and the camera's clock.",
               false, true});
}

tl::expected<void, ScanStop> FrameFeed::keep(const Frame& frame, const AngleAtInstant& angle, FrameUse use) {
  if (recording_ == nullptr) return {};
  if (auto kept = recording_->append(frame, angle, use, laser_, stop_); !kept) {
    ScanStop stop = stop_of(kept.error());
    stop.camera_lost = false;
    stop.failure = ScanFailure::system;
    return tl::make_unexpected(std::move(stop));
  }
  return {};
}

tl::expected<void, ScanStop> FrameFeed::come_to_rest() {
  const std::int64_t since_ns = equipment_.clock.now_ns();
  while (status_.motion != MotionState::standstill) {
    if (equipment_.clock.now_ns() - since_ns > kRestLimit_ns) {
      return tl::make_unexpected(ScanStop{ScanState::failed,
                                          "The table did not come to rest within 30 s after its turn; check the drive "
                                          "and start again."});
    }
    if (auto frame = next(); !frame) return tl::make_unexpected(frame.error());
  }
  return {};
}

void FrameFeed::verdict(const FrameInfo& frame, FrameVerdict verdict) {
  if (log_ == nullptr) return;
  ++counts_.frames;
  if (verdict == FrameVerdict::unlit) ++counts_.unlit;
  counts_.lost += frame.lost_before;
  if (verdict == FrameVerdict::stale) ++counts_.stale;
  if (verdict == FrameVerdict::corrupt) ++counts_.corrupt;
  log_->append(LogFrame{frame.sequence, frame.stamp_ns, frame.exposure_ns, frame.lost_before, verdict});
}

}  // namespace celadon
