#pragma once
// The controller as a function of a USB device: PROTOCOL.md, USB, over the device model.

#include "sim/device_model.h"
#include "sim/usb_device.h"

namespace celadon::sim {

class UsbController final : public UsbFunction, private UsbRegisters {
 public:
  static constexpr std::uint8_t kEventEndpoint = 0, kTraceEndpoint = 1;

  /// @pre the model outlives it; it has one of them
  explicit UsbController(DeviceModel& model);
  ~UsbController() override;
  UsbController(const UsbController&) = delete;
  UsbController& operator=(const UsbController&) = delete;

  std::uint8_t interfaces() const override { return 1; }
  std::uint8_t endpoints() const override { return 2; }
  Bytes descriptors(const UsbPlacement& at) const override;
  std::optional<Bytes> control(std::uint8_t interface, const UsbSetup& setup,
                               std::span<const std::uint8_t> data) override;
  UsbIn read(std::uint8_t endpoint, std::size_t most) override;
  void reset() override { usb_.reset(); }

 private:
  protocol::Exception read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override;
  protocol::Exception read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override;
  protocol::Exception write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override;

  DeviceModel& model_;
  ControllerUsb usb_{*this};
};

}  // namespace celadon::sim
