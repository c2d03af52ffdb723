#pragma once
// USB/IP (kernel documentation, usb/usbip_protocol) as bytes: what one client says, and the answers. No sockets here.

#include <deque>
#include <string>

#include "sim/usb_device.h"

namespace celadon::sim {

class UsbipSession {
 public:
  enum class Beginning : std::uint8_t {
    request,  ///< a client that asks for the list or the device
    attached  ///< the kernel's host controller: the device is its own
  };
  /// Whether a client that asks for the device gets it.
  enum class Offer : std::uint8_t { free, taken, absent };

  /// @pre the device outlives it
  UsbipSession(UsbDevice& device, Beginning beginning) : device_(device), imported_(beginning == Beginning::attached) {}

  /// Takes bytes and answers what can be answered at once.
  void receive(std::span<const std::uint8_t> bytes, Offer offer);
  /// Answers transfers that wait for the device, as far as it has something for them.
  void advance();
  /// To be sent; the caller takes away what it sent.
  Bytes& output() { return output_; }
  /// The device belongs to this client.
  bool imported() const { return imported_; }
  /// Nothing more will come of it: close the connection when the output is sent.
  bool finished() const { return finished_; }

  static constexpr const char* kBusId = "1-1";
  static constexpr std::uint32_t kDeviceId = (1U << 16) | 2;
  static constexpr std::uint32_t kHighSpeed = 3;

 private:
  struct Urb {
    std::uint32_t number, length;
    std::uint8_t endpoint;
  };
  /// @returns whether a whole message was there
  bool take_request(Offer offer);
  bool take_message();
  void submit(std::span<const std::uint8_t> head, std::span<const std::uint8_t> data);
  void unlink(std::uint32_t number, std::uint32_t unlinked);
  void put_device_record();
  void answer(std::uint32_t number, int status, std::uint32_t moved, std::span<const std::uint8_t> data);
  std::span<const std::uint8_t> unread() const { return std::span<const std::uint8_t>(input_).subspan(read_); }

  UsbDevice& device_;
  bool imported_, finished_ = false;
  Bytes input_, output_;
  std::size_t read_ = 0;  ///< of input_
  std::deque<Urb> waiting_;
};

}  // namespace celadon::sim
