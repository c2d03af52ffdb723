#pragma once
// A USB 2.0 device at high speed as its host sees it: descriptors, standard requests, and functions behind interfaces
// and endpoints. Whoever plays the host (USB/IP, a test) asks it; nothing here waits.

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "firmware_bridge/controller_usb.h"
#include "sim/usb_bytes.h"

namespace celadon::sim {

/// Answer of an IN endpoint.
struct UsbIn {
  enum class Status : std::uint8_t { nothing_yet, data, stall } status = Status::nothing_yet;
  Bytes data;
};

/// Where a function begins in the device's configuration.
struct UsbPlacement {
  std::uint8_t interface = 0;  ///< number of its first one
  std::uint8_t endpoint = 1;   ///< number of its first one; all are IN
};

/// One function of a device.
class UsbFunction {
 public:
  virtual ~UsbFunction() = default;
  virtual std::uint8_t interfaces() const = 0;
  virtual std::uint8_t endpoints() const = 0;
  /// From its interface association, if any, to its last endpoint.
  virtual Bytes descriptors(const UsbPlacement& at) const = 0;
  /// A class or vendor request to one of its interfaces (counted from 0) and its data. @returns the answer; nothing:
  /// STALL
  virtual std::optional<Bytes> control(std::uint8_t interface, const UsbSetup& setup,
                                       std::span<const std::uint8_t> data) = 0;
  /// What one of its endpoints (counted from 0) has, at most `most` bytes.
  virtual UsbIn read(std::uint8_t endpoint, std::size_t most) = 0;
  /// The host cleared a halt of an endpoint, whether there was one or not.
  virtual void clear_halt(std::uint8_t /*endpoint*/) {}
  /// The host chose the configuration, or left.
  virtual void reset() = 0;
};

class UsbDevice {
 public:
  struct Identity {
    std::uint16_t vendor = 0, product = 0;
    std::string manufacturer, name, serial;
  };

  /// @pre the functions outlive it
  UsbDevice(Identity identity, const std::vector<UsbFunction*>& functions);

  /// @returns the answer to an IN request, at most as long as asked for; nothing: STALL
  std::optional<Bytes> control(const UsbSetup& setup, std::span<const std::uint8_t> data);
  /// @param address of an IN endpoint, as in its descriptor
  UsbIn read(std::uint8_t address, std::size_t most);
  /// The next reads of an endpoint are answered with STALL, until the host clears the halt.
  void halt(std::uint8_t address);
  /// The host is gone.
  void reset();

  Bytes device_descriptor() const;
  Bytes configuration() const;
  const Identity& identity() const { return identity_; }
  /// Class, subclass and protocol of each interface.
  std::vector<std::array<std::uint8_t, 3>> interface_classes() const;

 private:
  struct Part {
    UsbFunction* function;
    UsbPlacement at;
  };
  std::optional<Bytes> standard(const UsbSetup& setup);
  std::optional<Bytes> descriptor(std::uint8_t type, std::uint8_t number) const;
  const Part* part_of_interface(unsigned number) const;
  const Part* part_of_endpoint(unsigned address) const;

  Identity identity_;
  std::vector<Part> parts_;
  std::uint8_t interfaces_ = 0, configured_ = 0;
  std::array<bool, 16> halted_{};
};

}  // namespace celadon::sim
