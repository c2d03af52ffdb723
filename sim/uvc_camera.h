#pragma once
// A USB video camera (USB Video Class 1.0) with a bulk endpoint: GREY, YUYV and MJPEG of one size, exposure and gain.

#include <array>

#include "sim/camera_sensor.h"
#include "sim/picture_coding.h"
#include "sim/usb_device.h"

namespace celadon::sim {

class UvcCamera final : public UsbFunction {
 public:
  static constexpr std::uint32_t kManual = 1, kAperturePriority = 8;  ///< bits of the auto exposure mode
  static constexpr std::uint32_t kUnitGain = 16, kMostGain = 128;     ///< in sixteenths

  struct Controls {
    std::uint32_t mode = kAperturePriority, exposure_100us = 0, gain = kUnitGain;
    bool operator==(const Controls&) const = default;
  };

  /// @pre the sensor outlives it @param exposure_ns at the start
  UvcCamera(CameraSensor& sensor, std::int64_t exposure_ns);

  std::uint8_t interfaces() const override { return 2; }
  std::uint8_t endpoints() const override { return 1; }
  Bytes descriptors(const UsbPlacement& at) const override;
  std::optional<Bytes> control(std::uint8_t interface, const UsbSetup& setup,
                               std::span<const std::uint8_t> data) override;
  UsbIn read(std::uint8_t endpoint, std::size_t most) override;
  void clear_halt(std::uint8_t endpoint) override;
  void reset() override;

  /// As the host set them.
  const Controls& controls() const { return controls_; }

 private:
  enum class Phase : std::uint8_t { idle, waiting_for_pixels, sending, ending };
  std::optional<Bytes> stream_control(const UsbSetup& setup, std::span<const std::uint8_t> data);
  std::optional<Bytes> unit_control(const UsbSetup& setup, std::span<const std::uint8_t> data);
  Bytes probe() const;
  std::uint32_t frame_bytes(VideoFormat format) const;
  std::uint32_t period_100ns() const { return static_cast<std::uint32_t>(sensor_.period_ns() / 100); }
  std::uint32_t most_exposure_100us() const;
  void set_gain(std::uint32_t gain);
  void stop();
  bool fill_payload();

  CameraSensor& sensor_;
  PictureCoder coder_;
  Controls controls_;
  const Controls power_on_;
  VideoFormat format_ = VideoFormat::grey;
  std::array<std::uint8_t, 256> gained_{}, gained_chroma_{};  ///< after the gain
  bool committed_ = false, streaming_ = false;
  Phase phase_ = Phase::idle;
  std::uint8_t frame_toggle_ = 0;
  Bytes luma_, chroma_, payload_;
  std::size_t sent_ = 0;
};

}  // namespace celadon::sim
