#pragma once
// A USB camera for the kernel's own uvcvideo driver: one end of a socket pair, given to vhci-hcd, speaks USB/IP (kernel
// documentation, usb/usbip_protocol) and answers as a UVC 1.0 device with a bulk endpoint: 320 x 240 GREY, and the
// exposure controls of a webcam. It runs in the test, which sees what the driver really sent.

#include <array>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <mutex>
#include <span>
#include <string>
#include <thread>
#include <vector>

namespace celadon {

class UvcCamera {
 public:
  static constexpr int kWidth = 320, kHeight = 240;
  static constexpr std::uint32_t kManual = 1, kAperturePriority = 8;  ///< bits of the auto exposure mode

  /// Plugs it in and waits until the driver has made its node.
  UvcCamera();
  /// Unplugs it and waits until the node is gone.
  ~UvcCamera();
  UvcCamera(const UvcCamera&) = delete;
  UvcCamera& operator=(const UvcCamera&) = delete;

  std::string node() const;
  void unplug();

  struct Exposure {
    std::uint32_t mode = kAperturePriority, time_100us = 156;
    bool operator==(const Exposure&) const = default;
  };
  Exposure exposure() const;

  /// Byte of a pixel in the frame that begins with `first`.
  static std::uint8_t pixel(std::uint8_t first, int x, int y) {
    return static_cast<std::uint8_t>(first + 3 * x + 5 * y);
  }

 private:
  struct Request {  ///< of the bulk endpoint, waiting for pixels
    std::uint32_t number = 0, length = 0;
  };

  void serve();
  void stream();
  bool receive(void* bytes, std::size_t count) const;
  void reply(std::uint32_t number, int status, std::span<const std::uint8_t> data, std::uint32_t length) const;
  /// @returns 0 or -EPIPE (a stall), and what is to be sent
  int control(std::span<const std::uint8_t, 8> setup, std::span<const std::uint8_t> data,
              std::vector<std::uint8_t>& answer);

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Request> waiting_;  // by mutex_
  Exposure exposure_;            // by mutex_
  bool ended_ = false;           // by mutex_
  int socket_ = -1;
  std::thread server_, streamer_;
};

}  // namespace celadon
