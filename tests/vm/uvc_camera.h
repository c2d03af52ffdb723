#pragma once
// A USB camera for the kernel's own uvcvideo driver: one end of a socket pair, given to vhci-hcd, speaks USB/IP (kernel
// documentation, usb/usbip_protocol) and answers as a UVC 1.0 device with a bulk endpoint: GREY, and the exposure
// controls of a webcam. It runs in the test, which sees what the driver really sent and gives what the camera sees.

#include <array>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <span>
#include <string>
#include <thread>
#include <vector>

namespace celadon {

class UvcCamera {
 public:
  static constexpr std::uint32_t kManual = 1, kAperturePriority = 8;  ///< bits of the auto exposure mode

  struct Exposure {
    std::uint32_t mode = kAperturePriority, time_100us = 156;
    bool operator==(const Exposure&) const = default;
  };
  /// Fills a picture, row by row. Called on a thread of the camera when the driver has noted the time of the frame:
  /// what it shows must be exposed from now on.
  using Sensor = std::function<void(const Exposure&, std::span<std::uint8_t> pixels)>;

  /// Plugs it in and waits until the driver has made its node.
  UvcCamera(int width, int height, Sensor sensor);
  /// Unplugs it and waits until the node is gone.
  ~UvcCamera();
  UvcCamera(const UvcCamera&) = delete;
  UvcCamera& operator=(const UvcCamera&) = delete;

  std::string node() const;
  void unplug();

  Exposure exposure() const;

 private:
  struct Request {  ///< of the bulk endpoint, waiting for pixels
    std::uint32_t number = 0, length = 0;
  };

  void serve();
  void stream();
  /// Sends a payload in as many requests as it takes; false at the end.
  bool send_payload(std::span<const std::uint8_t> payload);
  std::uint32_t frame_bytes() const { return static_cast<std::uint32_t>(width_ * height_); }
  std::vector<std::uint8_t> configuration() const;
  std::vector<std::uint8_t> probe() const;
  bool receive(void* bytes, std::size_t count) const;
  void reply(std::uint32_t number, int status, std::span<const std::uint8_t> data, std::uint32_t length) const;
  /// @returns 0 or -EPIPE (a stall), and what is to be sent
  int control(std::span<const std::uint8_t, 8> setup, std::span<const std::uint8_t> data,
              std::vector<std::uint8_t>& answer);

  const int width_, height_;
  const Sensor sensor_;
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Request> waiting_;  // by mutex_
  Exposure exposure_;            // by mutex_
  bool ended_ = false;           // by mutex_
  int socket_ = -1;
  std::thread server_, streamer_;
};

}  // namespace celadon
