#include "sim/usbip_session.h"

#include <algorithm>
#include <array>
#include <cerrno>

namespace celadon::sim {
namespace {

constexpr std::size_t kRequestBytes = 8, kBusIdBytes = 32, kPathBytes = 256, kHeadBytes = 48;
constexpr std::uint16_t kVersion = 0x0111, kListRequest = 0x8005, kListReply = 0x0005, kImportRequest = 0x8003,
                        kImportReply = 0x0003;
constexpr std::uint32_t kSubmit = 1, kUnlink = 2, kReturnSubmit = 3, kReturnUnlink = 4, kOut = 0;
enum Refusal : std::uint32_t { kGood = 0, kNotAvailable = 1, kBusy = 2, kNoDevice = 4 };
// Beyond what any driver here asks for: whoever does, is none.
constexpr std::uint32_t kMostTransfer = 1U << 20;
constexpr std::size_t kMostWaiting = 256;
constexpr std::size_t kMostOutput = std::size_t{4} << 20;  // of a client that does not read
constexpr std::uint32_t kNoPackets = 0xffffffff;           // no isochronous transfer

std::uint32_t get_big(std::span<const std::uint8_t> b, std::size_t at, int count) {
  std::uint32_t value = 0;
  for (int i = 0; i < count; ++i) value = (value << 8) | b[at + static_cast<std::size_t>(i)];
  return value;
}
void put_big(Bytes& out, std::uint32_t value, int count) {
  for (int i = count - 1; i >= 0; --i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}
void put_text(Bytes& out, const std::string& text, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) out.push_back(i < text.size() ? static_cast<std::uint8_t>(text[i]) : 0);
}

}  // namespace

void UsbipSession::receive(std::span<const std::uint8_t> bytes, Offer offer) {
  input_.insert(input_.end(), bytes.begin(), bytes.end());
  while (!finished_ && (imported_ ? take_message() : take_request(offer))) {
  }
  input_.erase(input_.begin(), input_.begin() + static_cast<std::ptrdiff_t>(read_));
  read_ = 0;
  if (output_.size() > kMostOutput) finished_ = true;
  if (finished_) input_.clear();
}

void UsbipSession::put_device_record() {
  const Bytes d = device_.device_descriptor();
  put_text(output_, "/sys/devices/celadon-sim/" + std::string(kBusId), kPathBytes);
  put_text(output_, kBusId, kBusIdBytes);
  put_big(output_, kDeviceId >> 16, 4);
  put_big(output_, kDeviceId & 0xffff, 4);
  put_big(output_, kHighSpeed, 4);
  put_big(output_, device_.identity().vendor, 2);
  put_big(output_, device_.identity().product, 2);
  put_big(output_, 0x0100, 2);
  const auto interfaces = static_cast<std::uint8_t>(device_.interface_classes().size());
  put(output_, {d[4], d[5], d[6], 1, 1, interfaces});
}

bool UsbipSession::take_request(Offer offer) {
  const auto in = unread();
  if (in.size() < kRequestBytes) return false;
  const std::uint32_t code = get_big(in, 2, 2);
  if (get_big(in, 0, 2) != kVersion || (code != kListRequest && code != kImportRequest)) {
    finished_ = true;
    return false;
  }
  if (code == kListRequest) {
    read_ += kRequestBytes;
    put_big(output_, kVersion, 2);
    put_big(output_, kListReply, 2);
    put_big(output_, kGood, 4);
    const bool listed = offer == Offer::free;
    put_big(output_, listed ? 1 : 0, 4);
    if (listed) {
      put_device_record();
      for (const auto& [type, subclass, protocol] : device_.interface_classes())
        put(output_, {type, subclass, protocol, 0});
    }
    finished_ = true;
    return false;
  }
  if (in.size() < kRequestBytes + kBusIdBytes) return false;
  const auto name = in.subspan(kRequestBytes, kBusIdBytes);
  read_ += kRequestBytes + kBusIdBytes;
  std::string wanted(name.begin(), std::find(name.begin(), name.end(), std::uint8_t{0}));
  std::uint32_t refusal = kGood;
  if (offer == Offer::taken) refusal = kBusy;
  if (offer == Offer::absent) refusal = kNoDevice;
  if (wanted != kBusId) refusal = kNotAvailable;
  put_big(output_, kVersion, 2);
  put_big(output_, kImportReply, 2);
  put_big(output_, refusal, 4);
  if (refusal == kGood) put_device_record();
  imported_ = refusal == kGood;
  finished_ = !imported_;
  return imported_;
}

bool UsbipSession::take_message() {
  const auto in = unread();
  if (in.size() < kHeadBytes) return false;
  const std::uint32_t command = get_big(in, 0, 4), length = get_big(in, 24, 4), packets = get_big(in, 32, 4);
  if (command == kUnlink) {
    read_ += kHeadBytes;
    unlink(get_big(in, 4, 4), get_big(in, 20, 4));
    return true;
  }
  if (command != kSubmit || length > kMostTransfer || (packets != 0 && packets != kNoPackets) ||
      waiting_.size() >= kMostWaiting) {
    finished_ = true;
    return false;
  }
  const std::size_t data = get_big(in, 12, 4) == kOut ? length : 0;
  if (in.size() < kHeadBytes + data) return false;
  read_ += kHeadBytes + data;
  submit(in.first(kHeadBytes), in.subspan(kHeadBytes, data));
  return true;
}

void UsbipSession::submit(std::span<const std::uint8_t> head, std::span<const std::uint8_t> data) {
  const std::uint32_t number = get_big(head, 4, 4), direction = get_big(head, 12, 4), endpoint = get_big(head, 16, 4),
                      length = get_big(head, 24, 4);
  if (endpoint == 0) {
    const UsbSetup setup = UsbSetup::from_bytes(head.data() + 40);
    auto reply = device_.control(setup, data);
    if (!reply) return answer(number, -EPIPE, 0, {});
    if (direction == kOut) return answer(number, 0, length, {});
    reply->resize(std::min<std::size_t>(reply->size(), length));
    return answer(number, 0, static_cast<std::uint32_t>(reply->size()), *reply);
  }
  // There are only IN endpoints.
  if (direction == kOut || endpoint > 15) return answer(number, -EPIPE, 0, {});
  waiting_.push_back({number, length, static_cast<std::uint8_t>(0x80 | endpoint)});
}

void UsbipSession::unlink(std::uint32_t number, std::uint32_t unlinked) {
  const auto found =
      std::find_if(waiting_.begin(), waiting_.end(), [&](const Urb& urb) { return urb.number == unlinked; });
  const int status = found != waiting_.end() ? -ECONNRESET : 0;
  if (found != waiting_.end()) waiting_.erase(found);
  put_big(output_, kReturnUnlink, 4);
  put_big(output_, number, 4);
  output_.resize(output_.size() + 12);  // device, direction, endpoint: zero in answers
  put_big(output_, static_cast<std::uint32_t>(status), 4);
  output_.resize(output_.size() + 24);
}

void UsbipSession::answer(std::uint32_t number, int status, std::uint32_t moved, std::span<const std::uint8_t> data) {
  put_big(output_, kReturnSubmit, 4);
  put_big(output_, number, 4);
  output_.resize(output_.size() + 12);  // device, direction, endpoint: zero in answers
  put_big(output_, static_cast<std::uint32_t>(status), 4);
  put_big(output_, moved, 4);
  output_.resize(output_.size() + 20);  // no packets, no errors, padding
  output_.insert(output_.end(), data.begin(), data.end());
}

void UsbipSession::advance() {
  std::array<bool, 256> nothing_yet{};
  for (auto urb = waiting_.begin(); urb != waiting_.end() && output_.size() < kMostOutput / 2;) {
    if (nothing_yet[urb->endpoint]) {
      ++urb;
      continue;
    }
    const UsbIn in = device_.read(urb->endpoint, urb->length);
    if (in.status == UsbIn::Status::nothing_yet) {
      nothing_yet[urb->endpoint] = true;
      ++urb;
      continue;
    }
    answer(urb->number, in.status == UsbIn::Status::stall ? -EPIPE : 0, static_cast<std::uint32_t>(in.data.size()),
           in.data);
    urb = waiting_.erase(urb);
  }
}

}  // namespace celadon::sim
