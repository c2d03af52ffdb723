#include "tests/vm/uvc_camera.h"

#include <endian.h>
#include <sys/inotify.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <stdexcept>

namespace celadon {
namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr std::uint32_t kHeaderBytes = 2;  // of a payload
constexpr std::uint32_t kPeriod_100ns = 333'333;
constexpr int kPort = 0;  // of vhci_hcd.0, high speed
const std::string kHub = "/sys/devices/platform/vhci_hcd.0/";

Bytes operator+(Bytes a, const Bytes& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}
Bytes u16(std::uint32_t v) {
  return {static_cast<std::uint8_t>(v), static_cast<std::uint8_t>(v >> 8)};
}
Bytes u32(std::uint32_t v) {
  return u16(v) + u16(v >> 16);
}

Bytes device_descriptor() {
  return {18, 1, 0, 2, 0xef, 2, 1, 64, 0x6b, 0x1d, 5, 1, 0, 1, 1, 2, 3, 1};
}

Bytes string_descriptor(unsigned number) {
  if (number == 0) return {4, 3, 9, 4};
  static const std::array<std::string, 3> texts{"Celadon", "Test Camera", "CAM001"};
  const std::string& text = texts.at(number - 1);
  Bytes out{static_cast<std::uint8_t>(2 + 2 * text.size()), 3};
  for (const char c : text) out = out + u16(static_cast<unsigned char>(c));
  return out;
}

/// Waits until a condition on /dev holds; looks again whenever a node comes or goes.
template <class Condition>
void wait_for_dev(int watch, Condition holds) {
  while (!holds()) {
    std::array<char, 4096> events{};
    if (::read(watch, events.data(), events.size()) < 0 && errno != EINTR) throw std::runtime_error("no news of /dev");
  }
}

int watch_dev() {
  const int watch = ::inotify_init1(IN_CLOEXEC);
  if (::inotify_add_watch(watch, "/dev", IN_CREATE | IN_DELETE) < 0) throw std::runtime_error("no news of /dev");
  return watch;
}

/// The capture node; uvcvideo makes another for metadata.
constexpr const char* kNode = "/dev/video0";

}  // namespace

UvcCamera::UvcCamera(int width, int height, Sensor sensor)
    : width_(width), height_(height), sensor_(std::move(sensor)) {
  std::array<int, 2> ends{};
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0) throw std::runtime_error("no sockets");
  socket_ = ends[1];
  server_ = std::thread([this] { serve(); });
  streamer_ = std::thread([this] { stream(); });
  const int watch = watch_dev();
  constexpr int kDevice = (1 << 16) | 2, kHighSpeed = 3;
  std::ofstream(kHub + "attach") << kPort << " " << ends[0] << " " << kDevice << " " << kHighSpeed << std::flush;
  ::close(ends[0]);
  wait_for_dev(watch, [] { return std::filesystem::exists(kNode); });
  ::close(watch);
}

UvcCamera::~UvcCamera() {
  const int watch = watch_dev();
  unplug();
  wait_for_dev(watch, [] { return !std::filesystem::exists(kNode); });
  ::close(watch);
  ::shutdown(socket_, SHUT_RDWR);
  {
    const std::lock_guard lock(mutex_);
    ended_ = true;
  }
  wake_.notify_all();
  server_.join();
  streamer_.join();
  ::close(socket_);
}

std::string UvcCamera::node() const {
  return kNode;
}

void UvcCamera::unplug() {
  std::ofstream(kHub + "detach") << kPort << std::flush;
}

UvcCamera::Exposure UvcCamera::exposure() const {
  const std::lock_guard lock(mutex_);
  return exposure_;
}

std::vector<std::uint8_t> UvcCamera::configuration() const {
  // Camera terminal 1 with auto exposure mode and exposure time; processing unit 2 without controls; output terminal 3.
  const Bytes camera{18, 0x24, 2, 1, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0a, 0, 0};
  const Bytes processing{11, 0x24, 5, 2, 1, 0, 0, 2, 0, 0, 0};
  const Bytes output{9, 0x24, 3, 3, 1, 1, 0, 2, 0};
  const Bytes units = camera + processing + output;
  const Bytes control = Bytes{13, 0x24, 1, 0, 1} + u16(13 + static_cast<std::uint32_t>(units.size())) +
                        u32(48'000'000) + Bytes{1, 1} + units;
  const Bytes format = Bytes{27, 0x24, 4, 1, 1} +
                       Bytes{'Y', '8', '0', '0', 0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71} +
                       Bytes{8, 1, 0, 0, 0, 0};
  const Bytes frame = Bytes{30, 0x24, 5, 1, 0} + u16(static_cast<std::uint32_t>(width_)) +
                      u16(static_cast<std::uint32_t>(height_)) + u32(frame_bytes() * 80) + u32(frame_bytes() * 240) +
                      u32(frame_bytes()) + u32(kPeriod_100ns) + Bytes{1} + u32(kPeriod_100ns);
  const Bytes streaming = Bytes{14, 0x24, 1, 1} + u16(14 + static_cast<std::uint32_t>(format.size() + frame.size())) +
                          Bytes{0x81, 0, 3, 0, 0, 0, 1, 0} + format + frame;
  const Bytes body = Bytes{8, 0x0b, 0, 2, 0x0e, 3, 0, 0} + Bytes{9, 4, 0, 0, 0, 0x0e, 1, 0, 0} + control +
                     Bytes{9, 4, 1, 0, 1, 0x0e, 2, 0, 0} + streaming + Bytes{7, 5, 0x81, 2, 0, 2, 0};
  return Bytes{9, 2} + u16(9 + static_cast<std::uint32_t>(body.size())) + Bytes{2, 1, 0, 0x80, 50} + body;
}

std::vector<std::uint8_t> UvcCamera::probe() const {
  return u16(1) + Bytes{1, 1} + u32(kPeriod_100ns) + Bytes(10) + u32(frame_bytes()) + u32(frame_bytes() + kHeaderBytes);
}

bool UvcCamera::receive(void* bytes, std::size_t count) const {
  auto* at = static_cast<char*>(bytes);
  while (count > 0) {
    const ssize_t got = ::recv(socket_, at, count, 0);
    if (got <= 0) return false;
    at += got;
    count -= static_cast<std::size_t>(got);
  }
  return true;
}

// Answer to a submitted request; under mutex_, so that two never mix.
void UvcCamera::reply(std::uint32_t number, int status, std::span<const std::uint8_t> data,
                      std::uint32_t length) const {
  constexpr std::uint32_t kReturnSubmit = 3;
  std::array<std::uint32_t, 12> head{};
  head[0] = htobe32(kReturnSubmit);
  head[1] = htobe32(number);
  head[5] = htobe32(static_cast<std::uint32_t>(status));
  head[6] = htobe32(length);
  Bytes packet(sizeof head);
  std::memcpy(packet.data(), head.data(), sizeof head);
  packet.insert(packet.end(), data.begin(), data.end());
  for (std::size_t at = 0; at < packet.size();) {
    const ssize_t sent = ::send(socket_, packet.data() + at, packet.size() - at, MSG_NOSIGNAL);
    if (sent <= 0) return;
    at += static_cast<std::size_t>(sent);
  }
}

int UvcCamera::control(std::span<const std::uint8_t, 8> setup, std::span<const std::uint8_t> data, Bytes& answer) {
  const std::uint8_t type = setup[0], request = setup[1], low = setup[2], high = setup[3], interface = setup[4],
                     unit = setup[5];
  constexpr std::uint8_t kSetCurrent = 1, kCurrent = 0x81, kLeast = 0x82, kMost = 0x83, kStep = 0x84, kLength = 0x85,
                         kInfo = 0x86, kDefault = 0x87;
  if (type == 0x80 && request == 6) {  // get descriptor
    if (high == 1) answer = device_descriptor();
    if (high == 2) answer = configuration();
    if (high == 3) answer = string_descriptor(low);
    return answer.empty() ? -EPIPE : 0;
  }
  if ((type & 0x60) == 0) {  // other standard requests: configuration, interface, status, halt
    if ((type & 0x80) != 0) answer = {0, 0};
    return 0;
  }
  if (interface == 1 && (high == 1 || high == 2)) {  // probe and commit
    if (request == kInfo) answer = {3};
    if (request == kLength) answer = u16(static_cast<std::uint32_t>(probe().size()));
    if (request != kSetCurrent && answer.empty()) answer = probe();
    return 0;
  }
  constexpr std::uint8_t kCameraTerminal = 1, kExposureMode = 2, kExposureTime = 4;
  if (unit != kCameraTerminal || (high != kExposureMode && high != kExposureTime)) return -EPIPE;
  const bool mode = high == kExposureMode;
  std::uint32_t& value = mode ? exposure_.mode : exposure_.time_100us;
  const auto number = [&](std::uint32_t v) { return mode ? Bytes{static_cast<std::uint8_t>(v)} : u32(v); };
  switch (request) {
    case kSetCurrent:
      // As cameras do: the time is not taken while the automatic sets it.
      if (!mode && exposure_.mode != kManual) return -EPIPE;
      value = 0;
      for (std::size_t i = 0; i < data.size(); ++i) value |= std::uint32_t{data[i]} << (8 * i);
      return 0;
    case kCurrent:
      answer = number(value);
      return 0;
    case kLeast:
      answer = number(mode ? kManual : 3);
      return 0;
    case kMost:
      answer = number(mode ? kAperturePriority : 2047);
      return 0;
    case kStep:  // of the mode: those that it has
      answer = number(mode ? kManual | kAperturePriority : 1);
      return 0;
    case kDefault:
      answer = number(mode ? kAperturePriority : 156);
      return 0;
    case kInfo:
      answer = {3};
      return 0;
    case kLength:
      answer = u16(mode ? 1 : 4);
      return 0;
    default:
      return -EPIPE;
  }
}

void UvcCamera::serve() {
  constexpr std::uint32_t kSubmit = 1, kUnlink = 2, kReturnUnlink = 4, kOut = 0;
  std::array<std::uint8_t, 48> head{};
  const auto word = [&](std::size_t k) {
    std::uint32_t v = 0;
    std::memcpy(&v, head.data() + 4 * k, sizeof v);
    return be32toh(v);
  };
  while (receive(head.data(), head.size())) {
    const std::uint32_t number = word(1), direction = word(3), endpoint = word(4);
    if (word(0) == kUnlink) {
      const std::uint32_t unlinked = word(5);
      const std::lock_guard lock(mutex_);
      const auto found =
          std::find_if(waiting_.begin(), waiting_.end(), [&](const Request& r) { return r.number == unlinked; });
      std::array<std::uint32_t, 12> answer{};
      answer[0] = htobe32(kReturnUnlink);
      answer[1] = htobe32(number);
      answer[5] = htobe32(static_cast<std::uint32_t>(found != waiting_.end() ? -ECONNRESET : 0));
      if (found != waiting_.end()) waiting_.erase(found);
      ::send(socket_, answer.data(), sizeof answer, MSG_NOSIGNAL);
      continue;
    }
    if (word(0) != kSubmit) return;
    const std::uint32_t length = word(6);
    if (endpoint != 0) {
      const std::lock_guard lock(mutex_);
      waiting_.push_back({number, length});
      wake_.notify_all();
      continue;
    }
    Bytes data(direction == kOut ? length : 0), answer;
    if (!data.empty() && !receive(data.data(), data.size())) return;
    const std::lock_guard lock(mutex_);
    const int status = control(std::span(head).last<8>(), data, answer);
    if (answer.size() > length) answer.resize(length);
    const auto moved = static_cast<std::uint32_t>(direction == kOut ? data.size() : answer.size());
    reply(number, status, answer, status == 0 ? moved : 0);
  }
}

bool UvcCamera::send_payload(std::span<const std::uint8_t> payload) {
  for (std::size_t at = 0; at < payload.size();) {
    std::unique_lock lock(mutex_);
    wake_.wait(lock, [&] { return ended_ || !waiting_.empty(); });
    if (ended_) return false;
    const Request request = waiting_.front();
    waiting_.pop_front();
    const std::size_t count = std::min<std::size_t>(request.length, payload.size() - at);
    reply(request.number, 0, payload.subspan(at, count), static_cast<std::uint32_t>(count));
    at += count;
  }
  return true;
}

// Frame after frame, as fast as the driver asks. A payload without pixels goes ahead: the driver notes the time of a
// frame at its first payload.
void UvcCamera::stream() {
  constexpr std::uint8_t kEndOfFrame = 2;
  std::uint8_t toggle = 0;
  Bytes payload(kHeaderBytes + frame_bytes());
  payload[0] = kHeaderBytes;
  while (true) {
    payload[1] = toggle;
    if (!send_payload(std::span(payload).first(kHeaderBytes))) return;
    sensor_(exposure(), std::span(payload).subspan(kHeaderBytes));
    payload[1] = static_cast<std::uint8_t>(kEndOfFrame | toggle);
    if (!send_payload(payload)) return;
    toggle ^= 1;
  }
}

}  // namespace celadon
