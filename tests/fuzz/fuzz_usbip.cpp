// libFuzzer target: any bytes from a USB/IP client, or from a kernel that attached the device. Build and run: README.md
// of this folder. The first byte says which of the two, the second how the bytes are cut into pieces.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "sim/usb_controller.h"
#include "sim/usbip_session.h"
#include "sim/uvc_camera.h"
#include "tests/sim/pattern_sensor.h"

using namespace celadon::sim;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  CameraConfig picture;
  picture.width_px = 64;
  picture.height_px = 64;
  static const DeviceConfig kDevice = [&] {
    DeviceConfig config = default_device(picture);
    config.scene = "cylinder";
    config.date = "2026-01-01T00:00:00Z";
    return config;
  }();
  DeviceModel model(kDevice);
  PatternSensor sensor(24, 16);
  UsbController controller(model);
  UvcCamera camera(sensor, 4'000'000);
  UsbDevice device({0x1209, 1, "Celadon", "Virtual Scanner", "S"}, {&controller, &camera});
  UsbipSession session(device, data[0] % 2 == 0 ? UsbipSession::Beginning::attached : UsbipSession::Beginning::request);
  const std::size_t piece = 1 + data[1];
  const auto offer = static_cast<UsbipSession::Offer>(data[0] / 2 % 3);
  for (std::size_t at = 2; at < size && !session.finished(); at += piece) {
    session.receive(std::span(data, size).subspan(at, std::min(piece, size - at)), offer);
    session.advance();
    if (at < 64 * piece) model.advance_to(model.now_ns() + 1'000'000);
    if (session.output().size() > (std::size_t{8} << 20)) std::abort();
    if (data[0] >= 128) session.output().clear();  // a client that reads
  }
  device.reset();
  return 0;
}
