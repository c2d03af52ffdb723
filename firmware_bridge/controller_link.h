#pragma once
// Exchanges with one controller in the protocol's terms: whole blocks in, decoded values out, bounded retries.

#include <cstdint>
#include <memory>
#include <span>

#include <tl/expected.hpp>

#include "firmware_bridge/clock.h"
#include "firmware_bridge/protocol.h"
#include "firmware_bridge/scanner_device.h"
#include "firmware_bridge/transport.h"

namespace celadon {

/// One poll: what the owner sees, and what only the bridge needs.
struct StatusBlock {
  DeviceStatus status;
  std::uint16_t lasers_enabled = 0;
  std::uint16_t command_sequence = 0;  ///< of axis 0's last accepted command
  Refusal refusal = Refusal::none;
};

/// @pre words holds protocol::status_words(1) registers.
StatusBlock decode_status(std::span<const std::uint16_t> words);

class ControllerLink {
 public:
  ControllerLink(std::unique_ptr<Transport> transport, Clock& clock)
      : transport_(std::move(transport)), clock_(clock) {}

  // Each tries up to three times where that may help, with short waits on the clock; over a lost link, which is opened
  // again, six times with waits that double, 0.6 s in all. Repeats are harmless: reads have no effect, grants and
  // make_safe may be repeated, commands carry a sequence number.
  tl::expected<StatusBlock, LinkError> read_status();
  /// @return wrong_protocol if something else answers, or another major version.
  tl::expected<DeviceIdentity, LinkError> read_identity();
  tl::expected<DeviceCapabilities, LinkError> read_capabilities();
  tl::expected<void, LinkError> write(const protocol::Register& r, int index, std::span<const std::uint16_t> values);
  /// A lease that ends lease_ms from now at the latest, whichever attempt gets through.
  tl::expected<void, LinkError> write_lease(int laser, std::int64_t lease_ms);
  tl::expected<void, LinkError> write_axis_command(std::uint16_t command, std::uint16_t sequence,
                                                   std::int64_t target_udeg, std::uint32_t speed_udeg_per_s,
                                                   std::uint32_t jerk_mdeg_per_s3);

  /// From now on leases and commands carry this token; 0: none.
  void use_token(std::uint16_t token) { token_ = token; }
  std::uint16_t token() const { return token_; }
  const LinkQuality& quality() const { return quality_; }

  /// Until that time, or until the controller told of a change by itself.
  void wait_until(std::int64_t time_ns);
  bool tells_changes() const { return transport_->has_events(); }
  bool changed() { return transport_->wait_for_event(0); }
  std::size_t take_trace(std::span<TraceSample> samples) { return transport_->take_trace(samples); }

  const std::string& url() const { return transport_->url(); }
  Clock& clock() { return clock_; }

 private:
  template <class Exchange>
  tl::expected<void, LinkError> with_retries(Exchange exchange);
  void count(const tl::expected<void, LinkError>& result);

  std::unique_ptr<Transport> transport_;
  Clock& clock_;
  std::uint16_t token_ = 0;
  LinkQuality quality_;
};

}  // namespace celadon
