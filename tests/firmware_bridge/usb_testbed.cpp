#include "tests/firmware_bridge/usb_testbed.h"

#include <linux/usbdevice_fs.h>
#include <sys/ioctl.h>

#include <cerrno>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "firmware_bridge/usb_protocol.h"
#include "sim/machine_axes.h"

namespace celadon::test {
namespace {

sim::DeviceConfig small_device(const std::string& serial, bool with_axes) {
  sim::CameraConfig camera;
  camera.width_px = 64;
  camera.height_px = 64;
  sim::DeviceConfig config = sim::default_device(camera);
  config.serial = serial;
  config.optics.axes = sim::draw_axes(1, config.optics.X_CW, with_axes, with_axes);
  return config;
}

constexpr std::size_t kSetupBytes = 8;

}  // namespace

UsbMachine::UsbMachine(const std::string& serial, bool with_axes)
    : model_(small_device(serial, with_axes)),
      device_({protocol::usb::kVendorId, protocol::usb::kProductId, "Celadon", "Virtual Scanner", serial},
              {&controller_}) {}

void UsbMachine::press() {
  with([](sim::DeviceModel& m) { m.press(100'000'000); });
  advance_ms(200);
}

std::optional<sim::Bytes> UsbMachine::control(const UsbSetup& setup, std::span<const std::uint8_t> data) {
  const std::lock_guard lock(mutex_);
  model_.advance_to(model_.now_ns() + 500'000);
  if (setup.request_type == protocol::usb::kTypeOut) ++writes;
  return device_.control(setup, data);
}

sim::UsbIn UsbMachine::read(std::uint8_t address, std::size_t most) {
  const std::lock_guard lock(mutex_);
  return device_.read(address, most);
}

UsbPort::UsbPort(UMockdevTestbed* testbed, int number) : testbed_(testbed), number_(number) {}

UsbPort::~UsbPort() {
  if (handler_ != nullptr) unplug();
}

void UsbPort::plug(UsbMachine& machine) {
  const std::lock_guard lock(mutex_);
  machine_ = &machine;
  static int last_device_number = 100;  // each plugging makes a new node, of three digits
  const int device_number = ++last_device_number;
  std::string hex;
  for (const sim::Bytes& part : {machine.device().device_descriptor(), machine.device().configuration()}) {
    for (const std::uint8_t byte : part) {
      char text[3];
      std::snprintf(text, sizeof text, "%02X", byte);
      hex += text;
    }
  }
  const std::string bus = "00" + std::to_string(number_), device = std::to_string(device_number);
  const std::string name = "bus/usb/" + bus + "/" + device;
  path_ = "/devices/pci0/usb" + std::to_string(number_) + "/" + std::to_string(number_) + "-1";
  node_ = "/dev/" + name;
  const std::string description =
      "P: " + path_ + "\nN: " + name + "=" + hex + "\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\nE: DEVNAME=/dev/" +
      name + "\nE: BUSNUM=" + bus + "\nE: DEVNUM=" + device + "\nA: busnum=" + std::to_string(number_) +
      "\\n\nA: devnum=" + std::to_string(device_number) +
      "\\n\nA: speed=480\\n\nA: bConfigurationValue=1\\n\nA: bNumConfigurations=1\\n\nH: descriptors=" + hex + "\n";
  GError* error = nullptr;
  handler_ = umockdev_ioctl_base_new();
  g_signal_connect(handler_, "handle-ioctl", G_CALLBACK(on_ioctl), this);
  // It answers before it is there: who looks for it may open it at once.
  if (!umockdev_testbed_attach_ioctl(testbed_, node_.c_str(), handler_, &error))
    throw std::runtime_error(error->message);
  if (!umockdev_testbed_add_from_string(testbed_, description.c_str(), &error))
    throw std::runtime_error(error->message);
  umockdev_testbed_uevent(testbed_, ("/sys" + path_).c_str(), "add");
}

void UsbPort::unplug() {
  {
    const std::lock_guard lock(mutex_);
    if (machine_ != nullptr) machine_->device().reset();
    machine_ = nullptr;
    mishaps_ = 0;
  }
  umockdev_testbed_uevent(testbed_, ("/sys" + path_).c_str(), "remove");
  umockdev_testbed_remove_device(testbed_, ("/sys" + path_).c_str());
}

void UsbPort::mishap(UsbMishap m, int times) {
  const std::lock_guard lock(mutex_);
  mishap_ = m;
  mishaps_ = times;
}

gboolean UsbPort::on_ioctl(UMockdevIoctlBase* /*base*/, UMockdevIoctlClient* client, gpointer self) {
  static_cast<UsbPort*>(self)->ioctl(client);
  return TRUE;
}

void UsbPort::ioctl(UMockdevIoctlClient* client) {
  const std::lock_guard lock(mutex_);
  UMockdevIoctlData* argument = umockdev_ioctl_client_get_arg(client);
  const auto request = umockdev_ioctl_client_get_request(client);
  if (machine_ == nullptr && request != USBDEVFS_REAPURBNDELAY && request != USBDEVFS_DISCARDURB)
    return umockdev_ioctl_client_complete(client, -1, ENODEV);
  switch (request) {
    case USBDEVFS_GET_CAPABILITIES: {
      __u32 capabilities =
          USBDEVFS_CAP_BULK_CONTINUATION | USBDEVFS_CAP_NO_PACKET_SIZE_LIM | USBDEVFS_CAP_REAP_AFTER_DISCONNECT;
      UMockdevIoctlData* data = umockdev_ioctl_data_resolve(argument, 0, sizeof capabilities, nullptr);
      umockdev_ioctl_data_update(data, 0, reinterpret_cast<guint8*>(&capabilities), sizeof capabilities);
      umockdev_ioctl_data_unref(data);
      return umockdev_ioctl_client_complete(client, 0, 0);
    }
    case USBDEVFS_CLEAR_HALT: {
      UMockdevIoctlData* data = umockdev_ioctl_data_resolve(argument, 0, sizeof(unsigned), nullptr);
      unsigned endpoint = 0;
      std::memcpy(&endpoint, data->data, sizeof endpoint);
      umockdev_ioctl_data_unref(data);
      (void)machine_->control({0x02, 1, 0, static_cast<std::uint16_t>(endpoint), 0}, {});
      return umockdev_ioctl_client_complete(client, 0, 0);
    }
    case USBDEVFS_SUBMITURB:
      return submit(client, argument);
    case USBDEVFS_DISCARDURB:
      return discard(client, argument);
    case USBDEVFS_REAPURBNDELAY:
      return reap(client, argument);
    case USBDEVFS_GETDRIVER:
      return umockdev_ioctl_client_complete(client, -1, ENODATA);
    default:  // claiming, releasing
      return umockdev_ioctl_client_complete(client, 0, 0);
  }
}

void UsbPort::submit(UMockdevIoctlClient* client, UMockdevIoctlData* argument) {
  Request request;
  request.urb = umockdev_ioctl_data_resolve(argument, 0, sizeof(usbdevfs_urb), nullptr);
  const auto* urb = reinterpret_cast<const usbdevfs_urb*>(request.urb->data);
  request.buffer = umockdev_ioctl_data_resolve(request.urb, offsetof(usbdevfs_urb, buffer),
                                               static_cast<gsize>(urb->buffer_length), nullptr);
  requests_.push_back(request);
  umockdev_ioctl_client_complete(client, 0, 0);
}

void UsbPort::discard(UMockdevIoctlClient* client, UMockdevIoctlData* argument) {
  gulong address = 0;
  std::memcpy(&address, argument->data, sizeof address);
  for (Request& request : requests_) {
    if (request.urb->client_addr != address || request.ended) continue;
    request.ended = true;
    request.status = -ENOENT;
    const auto* urb = reinterpret_cast<const usbdevfs_urb*>(request.urb->data);
    if (urb->type == USBDEVFS_URB_TYPE_CONTROL && mishaps_ > 0) --mishaps_;  // it was given up
    return umockdev_ioctl_client_complete(client, 0, 0);
  }
  umockdev_ioctl_client_complete(client, -1, EINVAL);
}

void UsbPort::reap(UMockdevIoctlClient* client, UMockdevIoctlData* argument) {
  for (auto request = requests_.begin(); request != requests_.end(); ++request) {
    if (!complete(*request)) continue;
    auto urb = *reinterpret_cast<usbdevfs_urb*>(request->urb->data);
    urb.status = request->status;
    umockdev_ioctl_data_update(request->urb, 0, reinterpret_cast<guint8*>(&urb), offsetof(usbdevfs_urb, usercontext));
    UMockdevIoctlData* to = umockdev_ioctl_data_resolve(argument, 0, sizeof(gpointer), nullptr);
    umockdev_ioctl_data_set_ptr(to, 0, request->urb);
    umockdev_ioctl_data_unref(to);
    umockdev_ioctl_data_unref(request->buffer);
    umockdev_ioctl_data_unref(request->urb);
    requests_.erase(request);
    return umockdev_ioctl_client_complete(client, 0, 0);
  }
  umockdev_ioctl_client_complete(client, -1, machine_ == nullptr ? ENODEV : EAGAIN);
}

bool UsbPort::complete(Request& request) {
  auto* urb = reinterpret_cast<usbdevfs_urb*>(request.urb->data);
  if (request.ended) return true;
  urb->actual_length = 0;
  if (machine_ == nullptr) {
    request.status = -ESHUTDOWN;
    return request.ended = true;
  }
  if (urb->type == USBDEVFS_URB_TYPE_CONTROL) return complete_control(request);
  sim::UsbIn in = machine_->read(urb->endpoint, static_cast<std::size_t>(urb->buffer_length));
  if (in.status == sim::UsbIn::Status::nothing_yet) return false;
  if (in.status == sim::UsbIn::Status::stall) request.status = -EPIPE;
  umockdev_ioctl_data_update(request.buffer, 0, in.data.data(), static_cast<gint>(in.data.size()));
  urb->actual_length = static_cast<int>(in.data.size());
  return request.ended = true;
}

bool UsbPort::complete_control(Request& request) {
  auto* urb = reinterpret_cast<usbdevfs_urb*>(request.urb->data);
  const std::uint8_t* bytes = request.buffer->data;
  const UsbSetup setup = UsbSetup::from_bytes(bytes);
  UsbMishap mishap = UsbMishap::none;
  if ((setup.request_type & 0x60) == 0x40 && mishaps_ > 0) mishap = mishap_;
  if (mishap == UsbMishap::ignore) return false;
  if (mishap != UsbMishap::none) --mishaps_;
  if (mishap == UsbMishap::break_off) {
    request.status = -EPROTO;
    return request.ended = true;
  }
  const bool is_in = (setup.request_type & 0x80) != 0;
  auto answer =
      machine_->control(setup, std::span(bytes + kSetupBytes, is_in ? std::size_t{0} : std::size_t{setup.length}));
  if (!answer) {
    request.status = -EPIPE;
  } else {
    std::size_t moved = is_in ? answer->size() : setup.length;
    if (mishap == UsbMishap::shorten) moved /= 2;
    if (is_in) umockdev_ioctl_data_update(request.buffer, kSetupBytes, answer->data(), static_cast<gint>(moved));
    urb->actual_length = static_cast<int>(moved);
  }
  return request.ended = true;
}

}  // namespace celadon::test
