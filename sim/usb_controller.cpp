#include "sim/usb_controller.h"

#include <algorithm>

namespace celadon::sim {

namespace usb = protocol::usb;

UsbController::UsbController(DeviceModel& model) : model_(model) {
  model_.set_sampled([this] { usb_.sample(); });
}

UsbController::~UsbController() {
  model_.set_sampled({});
}

Bytes UsbController::descriptors(const UsbPlacement& at) const {
  const auto in = [&](std::uint8_t endpoint) { return static_cast<std::uint8_t>(0x80 | (at.endpoint + endpoint)); };
  Bytes out{9, 4, at.interface, 0, 2, usb::kInterfaceClass, usb::kInterfaceSubclass, usb::kInterfaceProtocol, 0};
  put(out, {7, 5, in(kEventEndpoint), 3, 64, 0, 4});  // interrupt, every millisecond
  put(out, {7, 5, in(kTraceEndpoint), 2, 0, 2, 0});   // bulk, 512 bytes
  return out;
}

std::optional<Bytes> UsbController::control(std::uint8_t /*interface*/, const UsbSetup& setup,
                                            std::span<const std::uint8_t> data) {
  if ((setup.request_type & 0x80) == 0) {
    if (usb_.control_out(setup, data.data(), static_cast<int>(data.size())) == ControllerUsb::kStall)
      return std::nullopt;
    return Bytes{};
  }
  Bytes answer(2 * usb::kMaxRegisters);
  const int bytes = usb_.control_in(setup, answer.data());
  if (bytes == ControllerUsb::kStall) return std::nullopt;
  answer.resize(static_cast<std::size_t>(bytes));
  return answer;
}

UsbIn UsbController::read(std::uint8_t endpoint, std::size_t most) {
  UsbIn in;
  if (endpoint == kEventEndpoint) {
    if (most < usb::kEventBytes) return {UsbIn::Status::stall, {}};
    in.data.resize(usb::kEventBytes);
    in.data.resize(static_cast<std::size_t>(usb_.take_event(in.data.data())));
  } else {
    // Whole records only; a reader with less room would wait for ever.
    if (most < usb::kTraceBytes) return {UsbIn::Status::stall, {}};
    in.data.resize(std::min<std::size_t>(most, ControllerUsb::kTraceSamples * usb::kTraceBytes));
    in.data.resize(static_cast<std::size_t>(usb_.take_trace(in.data.data(), static_cast<int>(in.data.size()))));
  }
  if (!in.data.empty()) in.status = UsbIn::Status::data;
  return in;
}

protocol::Exception UsbController::read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  return model_.read_input(address, count, words);
}
protocol::Exception UsbController::read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  return model_.read_holding(address, count, words);
}
protocol::Exception UsbController::write_holding(std::uint16_t address, std::uint16_t count,
                                                 const std::uint16_t* words) {
  return model_.write_holding(address, count, words);
}

}  // namespace celadon::sim
