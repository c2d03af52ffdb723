#include "sim/usb_device.h"

#include <utility>

namespace celadon::sim {
namespace {

constexpr std::uint8_t kIn = 0x80, kTypeMask = 0x60, kRecipientMask = 0x1f;
constexpr std::uint8_t kToInterface = 1, kToEndpoint = 2;
enum StandardRequest : std::uint8_t {
  kGetStatus = 0,
  kClearFeature = 1,
  kSetFeature = 3,
  kSetAddress = 5,
  kGetDescriptor = 6,
  kGetConfiguration = 8,
  kSetConfiguration = 9,
  kGetInterface = 10,
  kSetInterface = 11
};
enum DescriptorType : std::uint8_t { kDevice = 1, kConfiguration = 2, kString = 3, kInterface = 4 };

Bytes string_descriptor(const std::string& text) {
  Bytes out{static_cast<std::uint8_t>(2 + 2 * text.size()), kString};
  for (const char c : text) put_number(out, static_cast<unsigned char>(c), 2);
  return out;
}

}  // namespace

UsbDevice::UsbDevice(Identity identity, const std::vector<UsbFunction*>& functions) : identity_(std::move(identity)) {
  UsbPlacement at;
  for (UsbFunction* function : functions) {
    parts_.push_back({function, at});
    at.interface = static_cast<std::uint8_t>(at.interface + function->interfaces());
    at.endpoint = static_cast<std::uint8_t>(at.endpoint + function->endpoints());
  }
  interfaces_ = at.interface;
}

Bytes UsbDevice::device_descriptor() const {
  // Class "miscellaneous, interface association": the functions say what they are.
  Bytes out{18, kDevice, 0x00, 0x02, 0xef, 2, 1, 64};
  put_number(out, identity_.vendor, 2);
  put_number(out, identity_.product, 2);
  put(out, {0x00, 0x01, 1, 2, 3, 1});
  return out;
}

Bytes UsbDevice::configuration() const {
  Bytes body;
  for (const Part& part : parts_) put(body, part.function->descriptors(part.at));
  Bytes out{9, kConfiguration};
  put_number(out, static_cast<std::uint32_t>(9 + body.size()), 2);
  put(out, {interfaces_, 1, 0, 0x80, 50});
  put(out, body);
  return out;
}

std::vector<std::array<std::uint8_t, 3>> UsbDevice::interface_classes() const {
  std::vector<std::array<std::uint8_t, 3>> out;
  const Bytes all = configuration();
  for (std::size_t at = 0; at + 9 <= all.size() && all[at] != 0; at += all[at]) {
    if (all[at + 1] == kInterface) out.push_back({all[at + 5], all[at + 6], all[at + 7]});
  }
  return out;
}

const UsbDevice::Part* UsbDevice::part_of_interface(unsigned number) const {
  for (const Part& part : parts_) {
    if (number >= part.at.interface && number < unsigned{part.at.interface} + part.function->interfaces()) return &part;
  }
  return nullptr;
}

const UsbDevice::Part* UsbDevice::part_of_endpoint(unsigned address) const {
  const unsigned number = address & 0x0f;
  for (const Part& part : parts_) {
    if ((address & kIn) != 0 && number >= part.at.endpoint &&
        number < unsigned{part.at.endpoint} + part.function->endpoints())
      return &part;
  }
  return nullptr;
}

std::optional<Bytes> UsbDevice::descriptor(std::uint8_t type, std::uint8_t number) const {
  if (type == kDevice) return device_descriptor();
  if (type == kConfiguration && number == 0) return configuration();
  if (type != kString) return std::nullopt;
  switch (number) {
    case 0:
      return Bytes{4, kString, 0x09, 0x04};  // English
    case 1:
      return string_descriptor(identity_.manufacturer);
    case 2:
      return string_descriptor(identity_.name);
    case 3:
      return string_descriptor(identity_.serial);
    default:
      return std::nullopt;
  }
}

std::optional<Bytes> UsbDevice::standard(const UsbSetup& setup) {
  const std::uint8_t recipient = setup.request_type & kRecipientMask;
  const Part* part = recipient == kToInterface  ? part_of_interface(setup.index)
                     : recipient == kToEndpoint ? part_of_endpoint(setup.index)
                                                : nullptr;
  if (recipient != 0 && part == nullptr && !(recipient == kToEndpoint && (setup.index & 0x0f) == 0))
    return std::nullopt;
  switch (setup.request) {
    case kGetStatus:
      return Bytes{static_cast<std::uint8_t>(recipient == kToEndpoint && halted_[setup.index & 0x0f]), 0};
    case kClearFeature:
      if (recipient == kToEndpoint && part != nullptr) {
        halted_[setup.index & 0x0f] = false;
        part->function->clear_halt(static_cast<std::uint8_t>((setup.index & 0x0f) - part->at.endpoint));
      }
      return Bytes{};
    case kSetFeature:
      if (recipient == kToEndpoint && part != nullptr) halted_[setup.index & 0x0f] = true;
      return Bytes{};
    case kSetAddress:
      return Bytes{};
    case kGetDescriptor:
      return recipient == 0
                 ? descriptor(static_cast<std::uint8_t>(setup.value >> 8), static_cast<std::uint8_t>(setup.value))
                 : std::nullopt;
    case kGetConfiguration:
      return Bytes{configured_};
    case kSetConfiguration:
      if (setup.value > 1) return std::nullopt;
      reset();
      configured_ = static_cast<std::uint8_t>(setup.value);
      return Bytes{};
    case kGetInterface:
      return Bytes{0};
    case kSetInterface:
      return setup.value == 0 ? std::optional(Bytes{}) : std::nullopt;  // none has alternate settings
    default:
      return std::nullopt;
  }
}

std::optional<Bytes> UsbDevice::control(const UsbSetup& setup, std::span<const std::uint8_t> data) {
  std::optional<Bytes> answer;
  if ((setup.request_type & kTypeMask) == 0) {
    answer = standard(setup);
  } else if (const Part* part = part_of_interface(setup.index & 0xff);
             part != nullptr && (setup.request_type & kRecipientMask) == kToInterface) {
    answer = part->function->control(static_cast<std::uint8_t>((setup.index & 0xff) - part->at.interface), setup, data);
  }
  if (answer && answer->size() > setup.length) answer->resize(setup.length);
  return answer;
}

UsbIn UsbDevice::read(std::uint8_t address, std::size_t most) {
  const Part* part = part_of_endpoint(address);
  if (part == nullptr || halted_[address & 0x0f]) return {UsbIn::Status::stall, {}};
  return part->function->read(static_cast<std::uint8_t>((address & 0x0f) - part->at.endpoint), most);
}

void UsbDevice::halt(std::uint8_t address) {
  halted_[address & 0x0f] = true;
}

void UsbDevice::reset() {
  halted_ = {};
  configured_ = 0;
  for (const Part& part : parts_) part.function->reset();
}

}  // namespace celadon::sim
