#include "firmware_bridge/controller_usb.h"

namespace celadon {

using protocol::Exception;
using protocol::Register;
namespace usb = protocol::usb;
namespace reg = protocol::reg;

namespace {

// The blocks of status and axes, without heartbeat_left: reading that would be a sign of life of the host.
constexpr std::uint16_t kStateFrom = reg::status::boot_id.address();
constexpr std::uint16_t state_words(int axes) {
  return static_cast<std::uint16_t>(protocol::status_words(axes) - kStateFrom);
}

template <std::size_t N>
void compose(const Register (&record)[N], const std::uint16_t* state, std::uint16_t* words) {
  for (const Register& r : record) {
    for (int i = 0; i < r.words(); ++i) *words++ = state[r.address() - kStateFrom + i];
  }
}

void put_words(const std::uint16_t* words, int count, std::uint8_t* bytes) {
  for (int i = 0; i < count; ++i) usb::put_word(bytes + 2 * i, words[i]);
}

}  // namespace

int ControllerUsb::control_in(const UsbSetup& setup, std::uint8_t* data) {
  std::uint16_t words[usb::kMaxRegisters] = {};
  if (setup.request_type != usb::kTypeIn) return kStall;
  if (setup.request == static_cast<std::uint8_t>(usb::Request::exception)) {
    if (setup.length < 2) return kStall;
    usb::put_word(data, static_cast<std::uint16_t>(exception_));
    return 2;
  }
  const auto count = static_cast<std::uint16_t>(setup.length / 2);
  if (setup.length % 2 != 0 || count == 0 || count > usb::kMaxRegisters) {
    exception_ = Exception::illegal_value;
  } else if (setup.request == static_cast<std::uint8_t>(usb::Request::read_input)) {
    exception_ = registers_.read_input(setup.value, count, words);
  } else if (setup.request == static_cast<std::uint8_t>(usb::Request::read_holding)) {
    exception_ = registers_.read_holding(setup.value, count, words);
  } else {
    exception_ = Exception::illegal_function;
  }
  if (exception_ != Exception::none) return kStall;
  put_words(words, count, data);
  return setup.length;
}

int ControllerUsb::control_out(const UsbSetup& setup, const std::uint8_t* data, int count) {
  std::uint16_t words[usb::kMaxRegisters];
  if (setup.request_type != usb::kTypeOut) return kStall;
  if (setup.request != static_cast<std::uint8_t>(usb::Request::write_holding)) {
    exception_ = Exception::illegal_function;
  } else if (count != setup.length || count % 2 != 0 || count == 0 || count > 2 * usb::kMaxRegisters) {
    exception_ = Exception::illegal_value;
  } else {
    for (int i = 0; i < count / 2; ++i) words[i] = usb::get_word(data + 2 * i);
    exception_ = registers_.write_holding(setup.value, static_cast<std::uint16_t>(count / 2), words);
  }
  return exception_ == Exception::none ? 0 : kStall;
}

bool ControllerUsb::read_state(int axes, std::uint16_t* words) {
  return registers_.read_input(kStateFrom, state_words(axes), words) == Exception::none;
}

int ControllerUsb::axes() {
  std::uint16_t count = 0;
  if (axes_ == 0 && registers_.read_input(reg::capabilities::axes.address(), 1, &count) == Exception::none)
    axes_ = count > protocol::kMaxAxes ? protocol::kMaxAxes : count;
  return axes_ == 0 ? 1 : axes_;
}

void ControllerUsb::sample() {
  std::uint16_t state[state_words(1)];
  if (!read_state(1, state)) return;
  const std::uint32_t counter = protocol::get_u32(state + reg::axis_status::position_counter.address() - kStateFrom);
  if (counter == newest_counter_) return;
  newest_counter_ = counter;
  if (trace_count_ == kTraceSamples) {
    trace_first_ = (trace_first_ + 1) % kTraceSamples;
    --trace_count_;
  }
  compose(usb::kTraceRegisters, state, trace_[(trace_first_ + trace_count_) % kTraceSamples]);
  ++trace_count_;
}

int ControllerUsb::take_event(std::uint8_t* data) {
  std::uint16_t state[state_words(protocol::kMaxAxes)], now[usb::kEventWords];
  const int count = axes();
  if (!read_state(count, state)) return 0;
  compose(usb::kEventRegisters, state, now);
  bool changed = !event_sent_;
  for (int i = reg::status::uptime.words(); i < usb::kEventWords; ++i) changed = changed || now[i] != event_[i];
  for (int axis = 1; axis < count; ++axis) {
    const std::uint16_t motion = state[reg::axis_status::motion_state.address(axis) - kStateFrom];
    changed = changed || motion != other_motion_[axis - 1];
    other_motion_[axis - 1] = motion;
  }
  if (!changed) return 0;
  for (int i = 0; i < usb::kEventWords; ++i) event_[i] = now[i];
  event_sent_ = true;
  put_words(event_, usb::kEventWords, data);
  return usb::kEventBytes;
}

int ControllerUsb::take_trace(std::uint8_t* data, int capacity) {
  int bytes = 0;
  for (; trace_count_ > 0 && bytes + usb::kTraceBytes <= capacity; bytes += usb::kTraceBytes) {
    put_words(trace_[trace_first_], usb::kTraceWords, data + bytes);
    trace_first_ = (trace_first_ + 1) % kTraceSamples;
    --trace_count_;
  }
  return bytes;
}

void ControllerUsb::reset() {
  event_sent_ = false;
  trace_count_ = 0;
  exception_ = Exception::none;
}

}  // namespace celadon
