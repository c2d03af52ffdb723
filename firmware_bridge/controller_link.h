#pragma once
// Exchanges with one controller in the protocol's terms: whole blocks in, decoded values out, bounded retries.

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
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
  int axes = 1;
  std::array<MotionState, protocol::kMaxAxes> motion{};              ///< by axis block
  std::array<std::uint16_t, protocol::kMaxAxes> command_sequence{};  ///< of each axis's last accepted command
  std::uint16_t fault_axis = 0;
  Refusal refusal = Refusal::none;
};

/// The kind that each axis block holds, as the controller's capabilities say; 0: there is no such block.
using AxisKinds = std::array<std::uint16_t, protocol::kMaxAxes>;

/// How many of the protocol's units make one rad, or one mm of a lift: microdegrees, micrometres.
double microunits(AxisKind kind);

/// @pre words holds protocol::status_words(n) registers, n the axes that `kinds` names. Axes of unknown kinds show in
/// `motion` only.
StatusBlock decode_status(std::span<const std::uint16_t> words, const AxisKinds& kinds);

/// What goes into one axis_command block, in the protocol's units.
struct AxisOrder {
  std::uint16_t command = protocol::kNoCommand;
  std::int64_t target = 0;
  std::uint32_t speed = 0, jerk = 0;
};

class ControllerLink {
 public:
  ControllerLink(std::unique_ptr<Transport> transport, Clock& clock)
      : transport_(std::move(transport)), clock_(clock) {}

  // Each tries up to three times where that may help, with short waits on the clock; over a lost link, which is opened
  // again, six times with waits that double, 0.6 s in all. Repeats are harmless: reads have no effect, grants and
  // make_safe may be repeated, commands carry a sequence number.
  /// Status and every axis that read_capabilities() found, in one block; before that, the table alone.
  tl::expected<StatusBlock, LinkError> read_status();
  /// The same without heartbeat_left: no sign of life, for onlookers.
  tl::expected<StatusBlock, LinkError> watch_status();
  /// @return wrong_protocol if something else answers, or another major version.
  tl::expected<DeviceIdentity, LinkError> read_identity();
  /// From then on polls read every axis of the machine.
  tl::expected<DeviceCapabilities, LinkError> read_capabilities();
  /// The axis block that holds an axis of this kind; the table is block 0.
  std::optional<int> block_of(AxisKind kind) const;
  tl::expected<void, LinkError> write(const protocol::Register& r, int index, std::span<const std::uint16_t> values);
  /// A lease that ends lease_ms from now at the latest, whichever attempt gets through.
  tl::expected<void, LinkError> write_lease(int laser, std::int64_t lease_ms);
  /// Commands the axis in that block.
  tl::expected<void, LinkError> write_axis_command(int block, std::uint16_t sequence, const AxisOrder& order);

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
  tl::expected<StatusBlock, LinkError> read_status_from(std::uint16_t first);
  void count(const tl::expected<void, LinkError>& result);

  std::unique_ptr<Transport> transport_;
  Clock& clock_;
  std::uint16_t token_ = 0;
  AxisKinds kinds_{protocol::kTurntable};
  int axes_ = 1;
  LinkQuality quality_;
};

}  // namespace celadon
