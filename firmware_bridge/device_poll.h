#pragma once
// What is known of the machine, and how a failure is told: polls, restarts, contradictions, the session.

#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include <tl/expected.hpp>

#include "firmware_bridge/controller_link.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon {

inline constexpr std::int64_t kMillisecond_ns = 1'000'000;
inline constexpr std::int64_t kPollPeriod_ns = 20 * kMillisecond_ns;

/// "12.000 deg"; of a lift "12.000 mm".
std::string position_text(AxisKind kind, double position);
const char* state_name(MotionState state);

bool in_motion(MotionState state);
/// Neither in motion nor decelerating from it.
bool is_standing(AxisKind kind, const AxisStatus& axis);
/// No laser emits or has a lease.
bool is_dark(const StatusBlock& block);
/// Every axis stands.
bool all_standing(const StatusBlock& block);
/// Why nothing may start at the moment, whatever the axes do.
Refusal safety_refusal(const DeviceStatus& s);

/// One axis of a poll. @pre the machine has it
AxisStatus axis_status(const DeviceStatus& s, AxisKind kind);

/// The machine as polls show it. Members are read by all who command it; only refresh() changes what it learned.
class DevicePoll {
 public:
  DevicePoll(std::unique_ptr<Transport> transport, Clock& clock) : link(std::move(transport), clock) {}

  ControllerLink link;
  DeviceIdentity identity;
  DeviceCapabilities capabilities;
  std::optional<StatusBlock> last;  ///< newest status; presses and sequences continue from it
  bool link_is_up = false;
  std::uint16_t presses = 0;  ///< seen, not yet taken

  std::int64_t now_ns() { return link.clock().now_ns(); }

  // How things are told.
  std::string state_left() const;
  DeviceError error(DeviceError::Kind kind, const std::string& operation, std::string cause,
                    std::string remedy = {}) const;
  /// A failed exchange of `operation`; reads the controller's own reason where it refused.
  DeviceError failure(const std::string& operation, LinkError cause);
  DeviceError refusal(const std::string& operation, Refusal reason) const;
  DeviceError fault_error(const std::string& operation) const;

  /// One block read into `last`; counts presses, notices a restart and contradictions.
  tl::expected<void, LinkError> refresh();
  /// The same, as the owner sees it: tells, once, of a restart or a contradiction, and keeps the session.
  tl::expected<void, DeviceError> poll(const std::string& operation);
  /// Polls until `done` holds; the deadline is on the clock.
  template <class Predicate>
  tl::expected<void, DeviceError> wait_until(const std::string& operation, std::int64_t limit_ns, Predicate done) {
    const std::int64_t deadline_ns = now_ns() + limit_ns;
    for (;;) {
      if (auto polled = poll(operation); !polled) return polled;
      if (done()) return {};
      if (now_ns() >= deadline_ns)
        return tl::unexpected(
            error(DeviceError::Kind::timed_out, operation,
                  "it was not finished within " + std::to_string(limit_ns / kMillisecond_ns) + " ms"));
      link.wait_until(std::min(now_ns() + kPollPeriod_ns, deadline_ns));
    }
  }
  tl::expected<void, LinkError> write(const protocol::Register& r, std::uint16_t value, int index = 0) {
    return link.write(r, index, std::span(&value, 1));
  }

  /// Takes the machine for this host; one that was killed holds it until its session is over.
  tl::expected<void, DeviceError> take_machine(const std::string& operation);
  /// Restarts, jumps and presses from before do not count.
  void begin_anew();

  /// Number of the next command to an axis, by its block.
  std::uint16_t next_sequence(int block);
  /// A homing begins: the position counts anew.
  void forget_jump(int block) { position_is_lost_[static_cast<std::size_t>(block)] = false; }

 private:
  tl::expected<void, DeviceError> hold_session(const std::string& operation);
  void compare_with_last(const StatusBlock& block);

  std::array<std::uint16_t, protocol::kMaxAxes> sequence_{};  // of the last motion command sent, per axis block
  bool restarted_ = false;                                    // the controller, and the owner has not been told
  std::optional<std::string> jumped_;                         // clock or position, and the owner has not been told
  std::array<bool, protocol::kMaxAxes> position_is_lost_{};   // since such a jump, per axis block
  std::int64_t session_due_ns_ = 0;                           // when the token has to be written again
};

}  // namespace celadon
