#include "firmware_bridge/usb_controller.h"

#include <array>
#include <vector>

#include "firmware_bridge/clock.h"
#include "firmware_bridge/usb_protocol.h"

namespace celadon {
namespace {

using Kind = DeviceError::Kind;
namespace usb = protocol::usb;

struct FreeList {
  void operator()(libusb_device** list) const { libusb_free_device_list(list, 1); }
};
struct FreeConfiguration {
  void operator()(libusb_config_descriptor* d) const { libusb_free_config_descriptor(d); }
};

/// A device that has the interface; opened as far as rights allow.
struct Candidate {
  UsbController controller;
  std::string name;  ///< "1209:0001 SERIAL"
};

bool find_interface(libusb_device* device, UsbController& found) {
  libusb_config_descriptor* raw = nullptr;
  if (libusb_get_active_config_descriptor(device, &raw) != 0) return false;
  const std::unique_ptr<libusb_config_descriptor, FreeConfiguration> configuration(raw);
  for (int i = 0; i < configuration->bNumInterfaces; ++i) {
    if (configuration->interface[i].num_altsetting < 1) continue;
    const libusb_interface_descriptor& d = configuration->interface[i].altsetting[0];
    if (d.bInterfaceClass != usb::kInterfaceClass || d.bInterfaceSubClass != usb::kInterfaceSubclass ||
        d.bInterfaceProtocol != usb::kInterfaceProtocol)
      continue;
    found.interface = d.bInterfaceNumber;
    for (int k = 0; k < d.bNumEndpoints; ++k) {
      const libusb_endpoint_descriptor& e = d.endpoint[k];
      if ((e.bEndpointAddress & LIBUSB_ENDPOINT_DIR_MASK) != LIBUSB_ENDPOINT_IN) continue;
      const int type = e.bmAttributes & LIBUSB_TRANSFER_TYPE_MASK;
      if (type == LIBUSB_TRANSFER_TYPE_INTERRUPT && found.event_endpoint == 0) {
        found.event_endpoint = e.bEndpointAddress;
        found.event_bytes = e.wMaxPacketSize & 0x7ff;
      }
      if (type == LIBUSB_TRANSFER_TYPE_BULK && found.trace_endpoint == 0) {
        found.trace_endpoint = e.bEndpointAddress;
        found.trace_bytes = 8 * (e.wMaxPacketSize & 0x7ff);
      }
    }
    return true;
  }
  return false;
}

std::string hex4(std::uint16_t value) {
  constexpr const char* kDigits = "0123456789abcdef";
  std::string text;
  for (int shift = 12; shift >= 0; shift -= 4) text += kDigits[(value >> shift) & 15];
  return text;
}

std::string serial_of(libusb_device_handle* handle, std::uint8_t index) {
  std::array<unsigned char, 128> text{};
  const int length = index == 0 ? 0 : libusb_get_string_descriptor_ascii(handle, index, text.data(), text.size());
  return {text.begin(), text.begin() + std::max(length, 0)};
}

// A foreign device's descriptors are read from the kernel; only one with the interface is opened.
tl::expected<std::vector<Candidate>, LinkError> find_controllers(libusb_context* context, const UsbPlace& place) {
  libusb_device** raw = nullptr;
  const auto count = libusb_get_device_list(context, &raw);
  if (count < 0) return tl::unexpected(usb_link_error(static_cast<int>(count)));
  const std::unique_ptr<libusb_device*, FreeList> list(raw);
  std::vector<Candidate> found;
  for (libusb_device** device = raw; *device != nullptr; ++device) {
    libusb_device_descriptor d{};
    if (libusb_get_device_descriptor(*device, &d) != 0) continue;
    if (place.pair && (d.idVendor != place.pair->vendor || d.idProduct != place.pair->product)) continue;
    Candidate candidate;
    if (!find_interface(*device, candidate.controller)) continue;
    libusb_device_handle* handle = nullptr;
    const int opened = libusb_open(*device, &handle);
    // One that left in this moment is none.
    if (opened == LIBUSB_ERROR_NO_DEVICE || opened == LIBUSB_ERROR_NOT_FOUND) continue;
    if (opened != 0) {
      LinkError error = usb_link_error(opened);
      error.cause =
          "the controller " + hex4(d.idVendor) + ":" + hex4(d.idProduct) + " cannot be opened: " + error.cause;
      return tl::unexpected(std::move(error));
    }
    candidate.controller.handle.reset(handle);
    const std::string serial = serial_of(handle, d.iSerialNumber);
    if (!place.serial.empty() && serial != place.serial) continue;
    candidate.name = hex4(d.idVendor) + ":" + hex4(d.idProduct) + "/" + serial;
    found.push_back(std::move(candidate));
  }
  return found;
}

int LIBUSB_CALL on_arrival(libusb_context* /*context*/, libusb_device* /*device*/, libusb_hotplug_event /*event*/,
                           void* arrived) {
  *static_cast<int*>(arrived) = 1;
  return 0;
}

// Any arrival ends the wait.
void wait_for_arrival(libusb_context* context, const UsbPlace& place, std::int64_t until_ns) {
  constexpr std::int64_t kThousand = 1000, kMillion = 1'000'000;
  int arrived = 0;
  libusb_hotplug_callback_handle callback = 0;
  if (libusb_hotplug_register_callback(context, LIBUSB_HOTPLUG_EVENT_DEVICE_ARRIVED, LIBUSB_HOTPLUG_NO_FLAGS,
                                       place.pair ? place.pair->vendor : LIBUSB_HOTPLUG_MATCH_ANY,
                                       place.pair ? place.pair->product : LIBUSB_HOTPLUG_MATCH_ANY,
                                       LIBUSB_HOTPLUG_MATCH_ANY, on_arrival, &arrived, &callback) != 0)
    return;
  MonotonicClock clock;
  for (std::int64_t now_ns = clock.now_ns(); arrived == 0 && now_ns < until_ns; now_ns = clock.now_ns()) {
    const std::int64_t left_us = (until_ns - now_ns) / kThousand + 1;
    timeval left{left_us / kMillion, left_us % kMillion};
    if (libusb_handle_events_timeout_completed(context, &left, &arrived) != 0) break;
  }
  libusb_hotplug_deregister_callback(context, callback);
}

std::string place_text(const UsbPlace& place) {
  std::string text;
  if (place.pair) text += " with VID:PID " + hex4(place.pair->vendor) + ":" + hex4(place.pair->product);
  if (!place.serial.empty()) text += (place.pair ? " and" : " with") + std::string(" serial number ") + place.serial;
  return text;
}

tl::expected<UsbController, LinkError> claim(std::vector<Candidate> found, const UsbPlace& place) {
  if (found.size() > 1) {
    std::string names;
    for (const Candidate& c : found) names += (names.empty() ? "usb:" : ", usb:") + c.name;
    return tl::unexpected(
        LinkError{Kind::refused, 0, "several controllers are on USB: " + names + "; give the URL of one", false});
  }
  if (found.empty())
    return tl::unexpected(
        LinkError{Kind::not_found, LIBUSB_ERROR_NO_DEVICE, "no controller" + place_text(place) + " is on USB", true});
  UsbController controller = std::move(found.front().controller);
  if (const int claimed = libusb_claim_interface(controller.handle.get(), controller.interface); claimed != 0)
    return tl::unexpected(usb_link_error(claimed));
  return controller;
}

}  // namespace

LinkError usb_link_error(int code) {
  const auto error = [code](Kind kind, const std::string& what, bool retry_may_help) {
    return LinkError{kind, code, what + " (" + libusb_error_name(code) + ")", retry_may_help};
  };
  switch (code) {
    case LIBUSB_ERROR_NO_DEVICE:
      return error(Kind::lost, "the controller was unplugged from USB", true);
    case LIBUSB_ERROR_ACCESS:
      return error(Kind::system,
                   "this user has no right to the USB device; install 60-celadon.rules and plug it in anew", false);
    case LIBUSB_ERROR_BUSY:
      return error(Kind::system, "another program or driver uses the controller's USB interface", false);
    case LIBUSB_ERROR_TIMEOUT:
      return error(Kind::timed_out, "no complete reply on USB in time", true);
    case LIBUSB_ERROR_OVERFLOW:
      return error(Kind::broken_reply, "the controller sent more than was asked for", true);
    case LIBUSB_ERROR_IO:
      return error(Kind::broken_reply, "the USB transfer failed on the bus", true);
    default:
      return error(Kind::system, "libusb failed", true);
  }
}

tl::expected<UsbController, LinkError> open_usb_controller(const UsbPlace& place, int arrival_ms) {
  MonotonicClock clock;
  const std::int64_t until_ns = clock.now_ns() + std::int64_t{arrival_ms} * 1'000'000;
  // libusb hears of arrivals from udevd. A new context looks for itself, so that it works where none runs.
  for (bool last = false;; last = clock.now_ns() >= until_ns) {
    libusb_context* context = nullptr;
    if (const int code = libusb_init(&context); code != 0) return tl::unexpected(usb_link_error(code));
    std::unique_ptr<libusb_context, UsbExit> owned(context);
    auto found = find_controllers(context, place);
    if (!found) return tl::unexpected(std::move(found.error()));
    if (!found->empty() || last || arrival_ms == 0) {
      auto controller = claim(std::move(*found), place);
      if (controller) controller->context = std::move(owned);
      return controller;
    }
    wait_for_arrival(context, place, until_ns);
  }
}

}  // namespace celadon
