#include "firmware_bridge/usb_trace.h"

#include <algorithm>
#include <array>

#include "firmware_bridge/usb_protocol.h"

namespace celadon {
namespace {

namespace usb = protocol::usb;
namespace reg = protocol::reg;

TraceSample decode_trace(const std::uint8_t* bytes) {
  std::array<std::uint16_t, usb::kTraceWords> words{};
  for (std::size_t i = 0; i < words.size(); ++i) words[i] = usb::get_word(bytes + 2 * i);
  const auto at = [&](const protocol::Register& r) { return &words[usb::offset_of(usb::kTraceRegisters, r)]; };
  TraceSample sample;
  sample.time_us = protocol::get_u64(at(reg::axis_status::position_time));
  sample.counter = protocol::get_u32(at(reg::axis_status::position_counter));
  sample.position_udeg = protocol::join_turns(protocol::get_s32(at(reg::axis_status::angle)),
                                              protocol::get_s32(at(reg::axis_status::turns)));
  sample.speed_udeg_per_s = protocol::get_s32(at(reg::axis_status::speed));
  return sample;
}

}  // namespace

void UsbTrace::receive(std::span<const std::uint8_t> bytes) {
  for (std::size_t at = 0; at + usb::kTraceBytes <= bytes.size(); at += usb::kTraceBytes) {
    samples_[(first_ + count_) % kKept] = decode_trace(bytes.data() + at);
    if (count_ < kKept) {
      ++count_;
    } else {
      first_ = (first_ + 1) % kKept;
    }
  }
}

std::size_t UsbTrace::take(std::span<TraceSample> to) {
  const std::size_t taken = std::min(count_, to.size());
  for (std::size_t i = 0; i < taken; ++i) to[i] = samples_[(first_ + i) % kKept];
  first_ = (first_ + taken) % kKept;
  count_ -= taken;
  return taken;
}

}  // namespace celadon
