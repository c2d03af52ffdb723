#pragma once
// The camera's clock and its driver's buffers: a free-running sensor, frames that are complete only after read-out and
// arrive later still, a ring of slots filled oldest first, frames lost while no slot is free. Pictures are someone
// else's business.

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "acquisition/frame.h"

namespace celadon::sim {

struct CameraConfig {
  int width_px = 1280, height_px = 1024;
  PixelFormat format = PixelFormat::grey8;
  Shutter shutter = Shutter::global;
  std::int64_t period_ns = 16'666'667;
  std::int64_t exposure_ns = 4'000'000;
  std::int64_t readout_ns = 14'000'000;     ///< first to last row; a rolling shutter's rows are that far apart
  std::int64_t stamp_latency_ns = 800'000;  ///< stamp - end of the first row's exposure: its packet reaches the host
  std::int64_t delay_ns = 8'000'000;        ///< frame complete at the sensor to buffer done at the host
  std::uint32_t slots = 4;

  std::size_t stride_bytes() const { return static_cast<std::size_t>(width_px) * bytes_per_pixel(format); }
  std::size_t frame_bytes() const { return stride_bytes() * static_cast<std::size_t>(height_px); }
  /// Between the exposures of two rows.
  std::int64_t line_time_ns() const { return shutter == Shutter::rolling ? readout_ns / height_px : 0; }
};

/// One frame on its way from the sensor to the client.
struct FrameTicket {
  std::uint64_t number = 0;    ///< of the sensor's clock, from the start of the device
  std::uint64_t sequence = 0;  ///< of the stream; counts lost frames too
  std::int64_t first_row_end_ns = 0;
  std::int64_t exposure_ns = 0;
  std::int64_t stamp_ns = 0;
  std::int64_t complete_ns = 0;  ///< read out: it can be rendered
  std::int64_t deliver_ns = 0;
  std::uint32_t slot = 0;
  std::uint32_t bytes_used = 0;
  bool corrupt = false;
  bool rendering = false, rendered = false;
};

class CameraTimeline {
 public:
  /// The sensor's frame 0 ends its first row at begin_ns + one period.
  CameraTimeline(const CameraConfig& config, std::int64_t begin_ns);

  const CameraConfig& config() const { return config_; }
  /// Begins a stream with all slots free and the sequence at 0.
  void start(std::int64_t now_ns);
  void stop();
  bool streaming() const { return streaming_; }
  /// A slot that was handed out is free again; others are ignored.
  void give_back(std::uint32_t slot);
  /// For frames whose exposure has not begun; limited to what the period allows. Returns the value in force from then.
  std::int64_t set_exposure(std::int64_t exposure_ns, std::int64_t now_ns);

  /// When something happens next; INT64_MAX without a stream.
  std::int64_t next_event_ns() const;
  /// The sensor reaches the end of a first row: takes a slot or loses the frame.
  void advance(std::int64_t now_ns);
  /// A frame that is read out and not yet being rendered; marks it.
  FrameTicket* take_to_render(std::int64_t now_ns);
  void mark_rendered(std::uint64_t number);
  /// The oldest frame that is rendered and has arrived.
  std::optional<FrameTicket> take(std::int64_t now_ns);
  /// The oldest frame under way, whatever its state.
  const FrameTicket* oldest() const { return under_way_.empty() ? nullptr : &under_way_.front(); }
  /// The same as take() for a host that is no further away than the bus: as soon as it is rendered.
  std::optional<FrameTicket> take_read_out() { return take(INT64_MAX); }

  /// Faults: the next frames are lost; each frame arrives that much later.
  void lose_next(int frames) { lose_ = frames; }
  void set_extra_delay(std::int64_t delay_ns) { extra_delay_ns_ = delay_ns; }
  /// The clock that stamps is off by this much.
  void set_stamp_step(std::int64_t step_ns) { stamp_step_ns_ = step_ns; }

 private:
  enum class Slot : std::uint8_t { free, filling, taken };
  std::int64_t first_row_end_ns(std::uint64_t number) const {
    return begin_ns_ + static_cast<std::int64_t>(number + 1) * config_.period_ns;
  }

  CameraConfig config_;
  std::int64_t begin_ns_;
  bool streaming_ = false;
  std::uint64_t next_number_ = 0, first_number_ = 0;
  std::int64_t next_exposure_ns_;
  std::int64_t next_exposure_from_ns_ = INT64_MIN;  ///< ends of first rows from here on have it
  std::vector<Slot> slots_;
  std::deque<FrameTicket> under_way_;
  int lose_ = 0;
  std::int64_t extra_delay_ns_ = 0, stamp_step_ns_ = 0;
};

}  // namespace celadon::sim
