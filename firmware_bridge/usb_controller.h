#pragma once
// A controller on USB, found, opened and claimed: handle, interface and endpoints out of its descriptors.

#include <cstdint>
#include <memory>
#include <string>

#include <libusb.h>

#include "firmware_bridge/transport.h"
#include "firmware_bridge/usb_url.h"

namespace celadon {

struct UsbExit {
  void operator()(libusb_context* context) const { libusb_exit(context); }
};
struct UsbClose {
  void operator()(libusb_device_handle* handle) const { libusb_close(handle); }
};

/// Closing it releases the interface. All transfers must have ended before.
struct UsbController {
  std::unique_ptr<libusb_context, UsbExit> context;
  std::unique_ptr<libusb_device_handle, UsbClose> handle;
  std::uint16_t interface = 0;
  std::uint8_t event_endpoint = 0;  ///< interrupt IN; 0: none
  std::uint8_t trace_endpoint = 0;  ///< bulk IN; 0: none
  int event_bytes = 0;              ///< of one packet
  int trace_bytes = 0;
};

/// Opens the one controller that the place names. An absent one is waited for, `arrival_ms` at most.
/// @returns not_found when there is none, refused when several match, system without rights or when it is in use
tl::expected<UsbController, LinkError> open_usb_controller(const UsbPlace& place, int arrival_ms);

/// What libusb returned for an exchange, as the owner of the link sees it.
LinkError usb_link_error(int libusb_code);

}  // namespace celadon
