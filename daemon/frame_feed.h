#pragma once
// The loop that accepts frames: the only place that renews the laser's lease. Between two frames it polls the device.

#include <cstddef>
#include <cstdint>
#include <functional>

#include <tl/expected.hpp>

#include "acquisition/angle_timeline.h"
#include "acquisition/axis_stop.h"
#include "acquisition/recording.h"
#include "daemon/arrival_watch.h"
#include "daemon/lease_history.h"
#include "daemon/profile_log.h"
#include "daemon/scan_job.h"

namespace celadon {

/// Good frames, one at a time, with the device's state after each. Starts the camera; stops it when destroyed.
class FrameFeed {
 public:
  static tl::expected<std::unique_ptr<FrameFeed>, ScanStop> start(const ScanEquipment& equipment,
                                                                  ScanObserver& observer,
                                                                  const Triangulator& triangulator, int laser);
  ~FrameFeed();
  FrameFeed(const FrameFeed&) = delete;
  FrameFeed& operator=(const FrameFeed&) = delete;

  /// Frames and position samples are noted in `log` from now on.
  void record_in(ProfileLogWriter& log) { log_ = &log; }
  /// Frames from now on belong to no turn: they are neither noted nor counted, until record_in().
  void pause_record() {
    log_ = nullptr;
    counts_lost_ = false;
  }

  /// Frames that are given to keep() go there from now on.
  void record_frames_in(RecordingWriter& recording) { recording_ = &recording; }
  /// Keeps a frame that was used; nothing without a recording.
  tl::expected<void, ScanStop> keep(const Frame& frame, const AngleAtInstant& angle, FrameUse use);

  /// Which laser is meant from now on, where the axes beside the table stand, and for which of a scan's turns.
  /// @pre all lasers are off
  void use_laser(int laser, const AxisStop& stop = {}, std::size_t turn_number = 0) {
    laser_ = laser;
    stop_ = stop;
    turn_number_ = turn_number;
    leases_.set_warm_up(0);
  }
  int laser() const { return laser_; }
  const AxisStop& stop() const { return stop_; }
  std::size_t turn_number() const { return turn_number_; }

  /// Exposure of the frames to come; the camera is asked only if it was asked for another one before. Frames from
  /// before have the old one in their FrameInfo, and next_after() drops them; those of which the driver cannot tell are
  /// dropped and counted as stale.
  tl::expected<void, ScanStop> expose_for(std::int64_t exposure_ns);
  /// As the camera answered to expose_for(); as the camera stands where it was not asked.
  std::int64_t exposure_in_force_ns() const {
    return exposure_in_force_ns_ != 0 ? exposure_in_force_ns_ : equipment_.camera.mode().exposure_ns;
  }
  /// Grants the first lease. The laser stays on while next() accepts frames.
  tl::expected<void, ScanStop> laser_on();
  /// After a move without frames: renews the lease, or grants a new one if it ran out.
  tl::expected<void, ScanStop> keep_laser_on() { return renew_lease(false); }
  tl::expected<void, ScanStop> laser_off();
  /// When the present grant began to shine without a gap, host time.
  std::int64_t shining_since_ns() const { return leases_.shining_since_ns(); }
  /// From now on a frame counts only if the laser has been on for so long before it.
  void set_warm_up(std::int64_t warm_up_ns) { leases_.set_warm_up(warm_up_ns); }

  /// The next frame that is whole, not the one before once more and, with the laser on, exposed while the laser's lease
  /// lasted; the lease is renewed for it and the device polled after it. Ends with a stop when cancelled, when the
  /// button was pressed, when no good frame came for two seconds, when the lease runs out before one frame after the
  /// other, when time stamps cannot be, or when the device is not fit to scan.
  tl::expected<Frame, ScanStop> next();
  /// The same, but frames whose exposure began before an instant of the host clock, or while the laser warmed up, or
  /// which have another exposure than expose_for() asked for, are dropped and counted as stale. So are those whose
  /// stamp says so only because they came late: where one may have, the frame after it tells.
  tl::expected<Frame, ScanStop> next_after(std::int64_t instant_ns);

  /// Whether the newest frame may have come late, so that its stamp is not that of its exposure; the frame after it
  /// decides.
  bool may_be_late() const { return arrivals_.may_be_late(); }
  bool came_late(const FrameInfo& frame, const FrameInfo& next) const {
    return arrivals_.is_late(exposure_of(frame), exposure_of(next));
  }

  /// Takes frames until the table, which ends its move by itself, stands; a stop after 30 s.
  tl::expected<void, ScanStop> come_to_rest();

  /// Writes down what became of a frame.
  void verdict(const FrameInfo& frame, FrameVerdict verdict);
  /// The same for one that came late.
  void leave_out_late(const FrameInfo& frame) {
    verdict(frame, FrameVerdict::stale);
    ++counts_.late;
  }

  /// Polls the device: heartbeat, button, interlock, position. With a recording only cancels are looked for.
  tl::expected<void, ScanStop> poll();
  const DeviceStatus& status() const { return status_; }
  const AngleTimeline& timeline() const { return timeline_; }

  /// Frames so far, since record_in().
  struct Counts {
    std::uint64_t frames = 0, lost = 0, stale = 0, corrupt = 0;
    std::int64_t longest_exchange_ns = 0;         ///< of polls, where they say when a position was taken
    std::uint64_t looks_lit = 0, looks_dark = 0;  ///< polls with the laser switched on, and of them without its light
    std::uint64_t unlit = 0;                      ///< frames for which the lease had run out
    std::uint64_t late = 0;                       ///< frames whose stamps were found to be late
  };
  const Counts& counts() const { return counts_; }
  /// Frames that the driver lost count while the table turns continuously; between two steps nobody looks.
  void count_lost_frames() { counts_lost_ = true; }

 private:
  FrameFeed(const ScanEquipment& equipment, ScanObserver& observer, const Triangulator& triangulator, int laser);
  tl::expected<void, ScanStop> renew_lease(bool granting);
  std::optional<ScanStop> unfit() const;
  std::optional<ScanStop> dark_laser();
  tl::expected<Frame, ScanStop> next_whole();
  LeaseHistory::Light light_on(const FrameInfo& frame) const;
  ArrivalWatch::Exposure exposure_of(const FrameInfo& frame) const;
  std::optional<ScanStop> too_slow(int unlit_frames, const FrameInfo& frame) const;
  std::optional<ScanStop> wrong_stamp(const FrameInfo& frame) const;

  const ScanEquipment equipment_;
  ScanObserver& observer_;
  const Triangulator& triangulator_;
  int laser_;
  AxisStop stop_;
  std::size_t turn_number_ = 0;
  std::int64_t exposure_asked_ns_ = 0, exposure_in_force_ns_ = 0;  ///< 0: nobody asked
  ProfileLogWriter* log_ = nullptr;
  RecordingWriter* recording_ = nullptr;
  AngleTimeline timeline_;
  DeviceStatus status_;
  Counts counts_;
  bool lit_ = false, counts_lost_ = false;
  LeaseHistory leases_;
  ArrivalWatch arrivals_;
  std::int64_t granted_ns_ = 0;
  std::int64_t dark_since_ns_ = 0;          ///< the laser does not emit although it should; 0: it does
  std::int64_t last_stamp_ns_ = INT64_MIN;  ///< of the newest good frame
};

/// A device error as the end of a scan.
ScanStop stop_of(const DeviceError& error);
/// A camera error as the end of a scan.
ScanStop stop_of(const CameraError& error);
/// The end of a scan that was asked for.
ScanStop cancelled_by(const std::string& whom);

}  // namespace celadon
