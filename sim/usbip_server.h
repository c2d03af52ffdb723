#pragma once
// The virtual scanner as a USB device of other machines (USB/IP over TCP) or of this one's kernel (vhci-hcd):
// controller and camera in one composite device. One host has it at a time.

#include <memory>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "sim/file_descriptor.h"
#include "sim/model_sensor.h"
#include "sim/pacer.h"
#include "sim/usb_controller.h"
#include "sim/usbip_session.h"
#include "sim/uvc_camera.h"

namespace celadon::sim {

class UsbipServer final : public Service {
 public:
  /// @pre all outlive it
  UsbipServer(DeviceModel& model, Pacer& pacer, FrameStore& store);
  UsbipServer(const UsbipServer&) = delete;
  UsbipServer& operator=(const UsbipServer&) = delete;

  /// Listens on HOST:PORT. @returns the address
  tl::expected<std::string, std::string> listen(const std::string& host_and_port);
  /// Plugs it into this machine's kernel, now and whenever it is plugged in again. Needs root and the module vhci-hcd.
  tl::expected<void, std::string> attach();

  void collect(std::vector<pollfd>& polls) override;
  void serve(const pollfd* polls, std::size_t count) override;

  const UvcCamera& camera() const { return camera_; }

 private:
  struct Client {
    FileDescriptor fd;
    UsbipSession session;
    bool closed = false;
  };
  void accept_client();
  void receive(Client& client);
  void send(Client& client);
  void follow_the_plug();
  UsbipSession::Offer offer() const;

  DeviceModel& model_;
  Pacer& pacer_;
  ModelSensor sensor_;
  UsbController controller_;
  UvcCamera camera_;
  UsbDevice device_;
  FileDescriptor listener_;
  bool attaches_ = false, plugged_ = true;
  std::vector<std::unique_ptr<Client>> clients_;
};

}  // namespace celadon::sim
