#include "sim/uvc_camera.h"

#include <algorithm>
#include <cmath>

namespace celadon::sim {
namespace {

constexpr std::uint32_t kHeaderBytes = 2;  // of a payload
constexpr double kGreyChroma = 128;
enum HeaderBit : std::uint8_t { kEndOfFrame = 2, kError = 0x40 };
enum Request : std::uint8_t {
  kSetCurrent = 1,
  kGetCurrent = 0x81,
  kGetLeast = 0x82,
  kGetMost = 0x83,
  kGetStep = 0x84,
  kGetLength = 0x85,
  kGetInfo = 0x86,
  kGetDefault = 0x87
};
constexpr std::uint8_t kCanGetAndSet = 3;
constexpr std::int64_t k100us_ns = 100'000;
constexpr std::size_t kProbeBytes = 26;

/// The answers about a control of some bytes; kSetCurrent is the caller's.
struct Range {
  int bytes;
  std::uint32_t current, least, most, step, initial;

  std::optional<Bytes> answer(std::uint8_t request) const {
    switch (request) {
      case kGetCurrent:
        return number(current, bytes);
      case kGetLeast:
        return number(least, bytes);
      case kGetMost:
        return number(most, bytes);
      case kGetStep:
        return number(step, bytes);
      case kGetDefault:
        return number(initial, bytes);
      case kGetLength:
        return number(static_cast<std::uint32_t>(bytes), 2);
      case kGetInfo:
        return Bytes{kCanGetAndSet};
      default:
        return std::nullopt;
    }
  }
};

}  // namespace

UvcCamera::UvcCamera(CameraSensor& sensor, std::int64_t exposure_ns)
    : sensor_(sensor),
      controls_{kAperturePriority, static_cast<std::uint32_t>(exposure_ns / k100us_ns), kUnitGain},
      power_on_(controls_) {
  set_gain(kUnitGain);
}

std::uint32_t UvcCamera::frame_bytes(VideoFormat format) const {
  return static_cast<std::uint32_t>(most_bytes(format, sensor_.width_px(), sensor_.height_px()));
}

std::uint32_t UvcCamera::most_exposure_100us() const {
  return std::max<std::uint32_t>(1, static_cast<std::uint32_t>(sensor_.longest_exposure_ns() / k100us_ns));
}

void UvcCamera::set_gain(std::uint32_t gain) {
  controls_.gain = std::clamp(gain, kUnitGain, kMostGain);
  for (std::uint32_t level = 0; level < gained_.size(); ++level) {
    gained_[level] = static_cast<std::uint8_t>(std::min(255U, (level * controls_.gain + kUnitGain / 2) / kUnitGain));
    const double off = (static_cast<double>(level) - kGreyChroma) * controls_.gain / kUnitGain;
    gained_chroma_[level] = static_cast<std::uint8_t>(std::clamp(std::lround(kGreyChroma + off), 0L, 255L));
  }
}

Bytes UvcCamera::probe() const {
  Bytes out = number(1, 2);  // the frame interval is fixed
  put(out, {static_cast<std::uint8_t>(format_), 1});
  put_number(out, period_100ns(), 4);
  put(out, Bytes(10));
  put_number(out, frame_bytes(format_), 4);
  put_number(out, frame_bytes(format_) + kHeaderBytes, 4);
  return out;
}

std::optional<Bytes> UvcCamera::control(std::uint8_t interface, const UsbSetup& setup,
                                        std::span<const std::uint8_t> data) {
  constexpr std::uint8_t kTypeAndRecipient = 0x7f, kClassToInterface = 0x21;
  const bool in = (setup.request_type & 0x80) != 0;
  if ((setup.request_type & kTypeAndRecipient) != kClassToInterface || in == (setup.request == kSetCurrent))
    return std::nullopt;
  return interface == 0 ? unit_control(setup, data) : stream_control(setup, data);
}

std::optional<Bytes> UvcCamera::stream_control(const UsbSetup& setup, std::span<const std::uint8_t> data) {
  constexpr std::uint8_t kProbe = 1, kCommit = 2;
  const auto selector = static_cast<std::uint8_t>(setup.value >> 8);
  if (selector != kProbe && selector != kCommit) return std::nullopt;
  switch (setup.request) {
    case kSetCurrent: {
      if (data.size() < kProbeBytes) return std::nullopt;
      const auto wanted = std::clamp<std::uint8_t>(data[2], 1, 3);
      if (selector == kCommit) stop();
      if (!streaming_) format_ = static_cast<VideoFormat>(wanted);
      committed_ = committed_ || selector == kCommit;
      return Bytes{};
    }
    case kGetInfo:
      return Bytes{kCanGetAndSet};
    case kGetLength:
      return number(kProbeBytes, 2);
    default:
      return probe();
  }
}

std::optional<Bytes> UvcCamera::unit_control(const UsbSetup& setup, std::span<const std::uint8_t> data) {
  constexpr std::uint8_t kCameraTerminal = 1, kProcessingUnit = 2;
  constexpr std::uint8_t kExposureMode = 2, kExposureTime = 4, kGain = 4;
  const auto unit = static_cast<std::uint8_t>(setup.index >> 8), selector = static_cast<std::uint8_t>(setup.value >> 8);
  const bool set = setup.request == kSetCurrent;
  const std::uint32_t value = get_number(data);
  if (unit == kCameraTerminal && selector == kExposureMode) {
    if (!set)
      return Range{1, controls_.mode, kManual, kAperturePriority, kManual | kAperturePriority, power_on_.mode}.answer(
          setup.request);
    if (data.size() != 1 || (value != kManual && value != kAperturePriority)) return std::nullopt;
    controls_.mode = value;
    if (value == kAperturePriority) sensor_.set_exposure(power_on_.exposure_100us * k100us_ns);
    return Bytes{};
  }
  if (unit == kCameraTerminal && selector == kExposureTime) {
    if (!set)
      return Range{4, controls_.exposure_100us, 1, most_exposure_100us(), 1, power_on_.exposure_100us}.answer(
          setup.request);
    // As cameras do: the time is not taken while the automatic sets it.
    if (data.size() != 4 || controls_.mode != kManual) return std::nullopt;
    controls_.exposure_100us = std::clamp(value, 1U, most_exposure_100us());
    sensor_.set_exposure(controls_.exposure_100us * k100us_ns);
    return Bytes{};
  }
  if (unit == kProcessingUnit && selector == kGain) {
    if (!set) return Range{2, controls_.gain, kUnitGain, kMostGain, 1, kUnitGain}.answer(setup.request);
    if (data.size() != 2) return std::nullopt;
    set_gain(value);
    return Bytes{};
  }
  return std::nullopt;
}

void UvcCamera::stop() {
  if (streaming_) sensor_.stop();
  streaming_ = false;
  phase_ = Phase::idle;
}

// The host ends a stream of a bulk endpoint so.
void UvcCamera::clear_halt(std::uint8_t /*endpoint*/) {
  stop();
}

void UvcCamera::reset() {
  stop();
  committed_ = false;
}

bool UvcCamera::fill_payload() {
  const CameraSensor::Picture picture = sensor_.picture();
  if (picture.luma.empty()) return false;
  luma_.assign(picture.luma.begin(), picture.luma.end());
  for (std::uint8_t& level : luma_) level = gained_[level];
  chroma_.assign(picture.chroma.begin(), picture.chroma.end());
  for (std::uint8_t& level : chroma_) level = gained_chroma_[level];
  payload_.assign(
      {kHeaderBytes, static_cast<std::uint8_t>(kEndOfFrame | frame_toggle_ |
                                               (picture.corrupt ? std::uint8_t{kError} : std::uint8_t{0}))});
  coder_.append(format_, luma_, chroma_, sensor_.width_px(), sensor_.height_px(), payload_);
  sensor_.end_picture();
  sent_ = 0;
  return true;
}

// A payload without pixels goes ahead: the driver notes the time of a frame at its first payload.
UsbIn UvcCamera::read(std::uint8_t /*endpoint*/, std::size_t most) {
  if (most < kHeaderBytes) return {UsbIn::Status::stall, {}};
  if (!committed_) return {};
  if (!streaming_) streaming_ = sensor_.start();
  if (!streaming_) return {};
  if (phase_ == Phase::idle) {
    if (!sensor_.begin_picture()) return {};
    frame_toggle_ ^= 1;
    phase_ = Phase::waiting_for_pixels;
    return {UsbIn::Status::data, {kHeaderBytes, frame_toggle_}};
  }
  if (phase_ == Phase::waiting_for_pixels) {
    if (!fill_payload()) return {};
    phase_ = Phase::sending;
  }
  if (phase_ == Phase::ending) {  // a compressed picture that fills its last transfer: an empty one tells the end
    phase_ = Phase::idle;
    return {UsbIn::Status::data, {}};
  }
  const std::size_t count = std::min(most, payload_.size() - sent_);
  const auto from = payload_.begin() + static_cast<std::ptrdiff_t>(sent_);
  UsbIn in{UsbIn::Status::data, Bytes(from, from + static_cast<std::ptrdiff_t>(count))};
  sent_ += count;
  if (sent_ == payload_.size()) {
    const bool ends_by_itself = count < most || payload_.size() == frame_bytes(format_) + kHeaderBytes;
    phase_ = ends_by_itself ? Phase::idle : Phase::ending;
  }
  return in;
}

}  // namespace celadon::sim
