#pragma once
// One IN endpoint that is always being read: transfers that wait at the host controller and are sent anew when done.
// Handled inside libusb's event handling of the owner's own calls.

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include <libusb.h>

namespace celadon {

class UsbStream {
 public:
  using Sink = std::function<void(std::span<const std::uint8_t>)>;

  /// `sink` gets the bytes of each transfer; it must not throw.
  /// @pre the handle outlives the stream
  UsbStream(libusb_device_handle* handle, std::uint8_t endpoint, bool interrupt, int bytes, int transfers, Sink sink);
  /// @pre idle()
  ~UsbStream() = default;
  UsbStream(const UsbStream&) = delete;
  UsbStream& operator=(const UsbStream&) = delete;

  /// Submits what is not under way, after clearing a halt; gives up after several failures in a row.
  /// @returns 0 or libusb's code; NO_DEVICE stays
  int keep_reading();
  /// Asks the transfers under way to end; event handling makes them.
  void cancel();
  bool idle() const;

 private:
  struct FreeTransfer {
    void operator()(libusb_transfer* t) const { libusb_free_transfer(t); }
  };
  struct Slot {
    UsbStream* stream = nullptr;
    std::unique_ptr<libusb_transfer, FreeTransfer> transfer;
    std::vector<std::uint8_t> buffer;
    bool under_way = false;
  };
  static void LIBUSB_CALL on_done(libusb_transfer* transfer);

  libusb_device_handle* handle_;
  std::uint8_t endpoint_;
  Sink sink_;
  std::vector<Slot> slots_;  ///< never resized: libusb points to them
  bool halted_ = false, gone_ = false;
  int failures_ = 0;  ///< in a row
};

}  // namespace celadon
