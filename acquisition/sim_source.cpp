// Client of the virtual scanner's frame ring. Byte format: frame_ring.h.
#include <fcntl.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <optional>

#include "acquisition/camera_fault.h"
#include "acquisition/file_descriptor.h"
#include "acquisition/frame_ring.h"
#include "acquisition/frame_sources.h"
#include "acquisition/lease_book.h"
#include "acquisition/monotonic_clock.h"

namespace celadon {
namespace {

using frame_ring::Hello;
using frame_ring::Reply;
using frame_ring::ReplyKind;
using frame_ring::Request;
using frame_ring::RequestKind;
using Kind = CameraError::Kind;

constexpr const char* kRemedy = "start celadon-sim with --socket-dir on this folder and open the camera again";
constexpr const char* kSameBuild = "use celadon-sim and Celadon of the same build";

/// The slots of all frames, mapped to be read.
class Mapping {
 public:
  Mapping() = default;
  Mapping(void* address, std::size_t size) : address_(address), size_(size) {}
  Mapping(Mapping&& other) noexcept
      : address_(std::exchange(other.address_, nullptr)), size_(std::exchange(other.size_, 0)) {}
  Mapping& operator=(Mapping&& other) noexcept {
    std::swap(address_, other.address_);
    std::swap(size_, other.size_);
    return *this;
  }
  ~Mapping() {
    if (address_ != nullptr) ::munmap(address_, size_);
  }
  const std::uint8_t* at(std::size_t offset) const { return static_cast<const std::uint8_t*>(address_) + offset; }

 private:
  void* address_ = nullptr;
  std::size_t size_ = 0;
};

/// What is wrong with a hello, if anything.
std::optional<std::string> fault_of(const Hello& hello) {
  const auto number = [](std::uint64_t v) { return std::to_string(v); };
  if (hello.magic != frame_ring::kMagic) return "the greeting begins with " + number(hello.magic) + ", not with CLFR";
  if (hello.version != frame_ring::kVersion) {
    return "the server speaks version " + number(hello.version) + " of the frame ring and this program version " +
           number(frame_ring::kVersion);
  }
  if (hello.format != static_cast<std::uint32_t>(PixelFormat::grey8) &&
      hello.format != static_cast<std::uint32_t>(PixelFormat::yuyv)) {
    return "pixel format " + number(hello.format) + " is unknown";
  }
  if (hello.shutter > static_cast<std::uint32_t>(Shutter::rolling)) {
    return "shutter " + number(hello.shutter) + " is unknown";
  }
  if (hello.width_px < 1 || hello.width_px > 65535 || hello.height_px < 1 || hello.height_px > 65535) {
    return "the image size is " + number(hello.width_px) + " x " + number(hello.height_px) + " px";
  }
  const std::uint64_t row_bytes = hello.width_px * bytes_per_pixel(static_cast<PixelFormat>(hello.format));
  if (hello.stride_bytes < row_bytes) {
    return "rows of " + number(row_bytes) + " bytes lie only " + number(hello.stride_bytes) + " bytes apart";
  }
  if (std::uint64_t{hello.stride_bytes} * hello.height_px > hello.slot_bytes) {
    return "a frame of " + number(std::uint64_t{hello.stride_bytes} * hello.height_px) +
           " bytes does not fit into a slot of " + number(hello.slot_bytes);
  }
  if (hello.slot_count < 1 || hello.slot_count > 4096) return "there are " + number(hello.slot_count) + " slots";
  if (hello.frame_period_ns <= 0 || hello.exposure_ns < 0) {
    return "the frame period is " + std::to_string(hello.frame_period_ns) + " ns and the exposure " +
           std::to_string(hello.exposure_ns) + " ns";
  }
  if (std::find(std::begin(hello.identity), std::end(hello.identity), '\0') == std::end(hello.identity)) {
    return "the camera's identity has no end";
  }
  return std::nullopt;
}

class SimSource final : public FrameSource, public FrameReturn {
 public:
  SimSource(std::string device, std::int64_t answer_limit_ns)
      : device_(std::move(device)), answer_limit_ns_(answer_limit_ns), leases_(device_) {}
  SimSource(const SimSource&) = delete;
  SimSource& operator=(const SimSource&) = delete;
  ~SimSource() override {
    stop();
    SimSource::restore_exposure();
  }

  tl::expected<void, CameraError> connect(const std::string& folder);

  const CameraMode& mode() const override { return mode_; }

  tl::expected<void, CameraError> start() override {
    if (started_) return {};
    auto reply = ask({.kind = RequestKind::start}, ReplyKind::started, "starting the stream", 0);
    if (!reply) return tl::unexpected(std::move(reply.error()));
    started_ = true;
    has_sequence_ = false;
    return {};
  }

  void stop() noexcept override {
    leases_.require_none("the camera was stopped");
    if (!std::exchange(started_, false)) return;
    // A server that is gone has stopped as well.
    static_cast<void>(ask({.kind = RequestKind::stop}, ReplyKind::stopped, "stopping the stream", 0));
  }

  tl::expected<Frame, CameraError> next(std::int64_t timeout_ns) override;

  tl::expected<std::int64_t, CameraError> set_exposure(std::int64_t exposure_ns) override {
    auto reply = ask({.kind = RequestKind::set_exposure, .value = exposure_ns}, ReplyKind::exposure,
                     "setting the exposure to " + std::to_string(exposure_ns) + " ns", 0);
    if (!reply) return tl::unexpected(std::move(reply.error()));
    if (!found_exposure_ns_) found_exposure_ns_ = mode_.exposure_ns;
    mode_.exposure_ns = reply->value;
    return reply->value;
  }
  void restore_exposure() noexcept override {
    // A server that is gone has none to put back.
    if (const auto found = std::exchange(found_exposure_ns_, std::nullopt); found && !lost_) {
      static_cast<void>(set_exposure(*found));
      found_exposure_ns_.reset();
    }
  }

  void give_back(std::uint32_t slot) noexcept override {
    leases_.take_back(slot);
    // A broken connection shows at the next request.
    const Request request{.kind = RequestKind::give_back, .value = slot};
    static_cast<void>(::send(socket_.get(), &request, sizeof request, MSG_NOSIGNAL));
  }

 private:
  CameraError fault(Kind kind, const std::string& operation, const std::string& cause, const std::string& remedy,
                    int errno_value = 0) const {
    return camera_fault(kind, device_, operation, cause, remedy, errno_value);
  }
  /// After this every request fails at once: an answer that comes late would be taken for that of another request.
  CameraError lose(CameraError error) {
    lost_ = true;
    return error;
  }
  tl::expected<void, CameraError> wait_readable(std::int64_t limit_ns, const std::string& operation);
  tl::expected<Reply, CameraError> ask(const Request& request, ReplyKind expected, const std::string& operation,
                                       std::int64_t declared_wait_ns);

  std::string device_;
  std::int64_t answer_limit_ns_;
  FileDescriptor socket_;
  Mapping frames_;
  std::size_t slot_bytes_ = 0, slot_count_ = 0;
  CameraMode mode_;
  std::optional<std::int64_t> found_exposure_ns_;  ///< before the first set_exposure()
  LeaseBook leases_;
  bool started_ = false, lost_ = false, has_sequence_ = false;
  std::uint64_t last_sequence_ = 0;
};

tl::expected<void, CameraError> SimSource::wait_readable(std::int64_t limit_ns, const std::string& operation) {
  const std::int64_t deadline = monotonic_ns() + limit_ns;
  for (;;) {
    const std::int64_t left = std::max<std::int64_t>(deadline - monotonic_ns(), 0);
    const timespec wait{left / 1'000'000'000, left % 1'000'000'000};
    pollfd poll{.fd = socket_.get(), .events = POLLIN, .revents = 0};
    const int ready = ::ppoll(&poll, 1, &wait, nullptr);
    if (ready > 0) return {};
    if (ready == 0) {
      return tl::unexpected(
          lose(fault(Kind::timed_out, operation,
                     "the virtual scanner gave no answer within " + std::to_string(limit_ns / 1'000'000) + " ms",
                     kRemedy, ETIMEDOUT)));
    }
    if (errno != EINTR) return tl::unexpected(lose(camera_fault(Kind::system, device_, operation, errno, kRemedy)));
  }
}

tl::expected<Reply, CameraError> SimSource::ask(const Request& request, ReplyKind expected,
                                                const std::string& operation, std::int64_t declared_wait_ns) {
  if (lost_) {
    return tl::unexpected(
        fault(Kind::unplugged, operation, "the connection to the virtual scanner was lost before", kRemedy, ENODEV));
  }
  if (::send(socket_.get(), &request, sizeof request, MSG_NOSIGNAL) < 0) {
    const Kind kind = errno == EPIPE || errno == ECONNRESET ? Kind::unplugged : Kind::system;
    return tl::unexpected(lose(camera_fault(kind, device_, operation, errno, kRemedy)));
  }
  const std::int64_t limit_ns =
      declared_wait_ns > INT64_MAX - answer_limit_ns_ ? INT64_MAX / 2 : declared_wait_ns + answer_limit_ns_;
  if (auto ready = wait_readable(limit_ns, operation); !ready) return tl::unexpected(std::move(ready.error()));
  Reply reply;
  // With MSG_TRUNC the true length of a packet that is too long is returned.
  const ssize_t size = ::recv(socket_.get(), &reply, sizeof reply, MSG_TRUNC);
  if (size == 0 || (size < 0 && errno == ECONNRESET)) {
    return tl::unexpected(
        lose(fault(Kind::unplugged, operation, "the virtual scanner closed the connection", kRemedy, ENODEV)));
  }
  if (size < 0) return tl::unexpected(lose(camera_fault(Kind::system, device_, operation, errno, kRemedy)));
  if (size != sizeof reply) {
    return tl::unexpected(lose(fault(
        Kind::protocol, operation,
        "the answer has " + std::to_string(size) + " bytes instead of " + std::to_string(sizeof reply), kSameBuild)));
  }
  if (reply.kind == ReplyKind::fault) {
    const int code = static_cast<int>(std::clamp<std::int64_t>(reply.value, 0, 4095));
    if (code == ENODEV) {
      return tl::unexpected(camera_fault(Kind::unplugged, device_, operation, ENODEV,
                                         "the camera was unplugged: connect it and open the camera again"));
    }
    return tl::unexpected(
        camera_fault(code == EBUSY ? Kind::busy : Kind::system, device_, operation, code, "see celadon-sim's log"));
  }
  if (reply.kind == ReplyKind::timed_out && expected == ReplyKind::frame) {
    return tl::unexpected(fault(Kind::timed_out, operation,
                                "no frame came within " + std::to_string(declared_wait_ns / 1'000'000) + " ms",
                                "the stream has stalled: stop and start it, or clear the simulated fault", ETIMEDOUT));
  }
  if (reply.kind != expected) {
    return tl::unexpected(lose(fault(Kind::protocol, operation,
                                     "the answer is of kind " + std::to_string(static_cast<std::uint32_t>(reply.kind)) +
                                         " instead of " + std::to_string(static_cast<std::uint32_t>(expected)),
                                     kSameBuild)));
  }
  return reply;
}

tl::expected<Frame, CameraError> SimSource::next(std::int64_t timeout_ns) {
  const std::string operation = "waiting for a frame";
  if (!started_) {
    return tl::unexpected(
        fault(Kind::unsupported, operation, "the stream is not started", "call start() before next()"));
  }
  auto answer = ask({.kind = RequestKind::next, .value = timeout_ns}, ReplyKind::frame, operation,
                    std::max<std::int64_t>(timeout_ns, 0));
  if (!answer) return tl::unexpected(std::move(answer.error()));
  const Reply& reply = *answer;
  const auto broken = [&](const std::string& cause) {
    return tl::unexpected(lose(fault(Kind::protocol, operation, cause, kSameBuild)));
  };
  if (reply.slot >= slot_count_) {
    return broken("slot " + std::to_string(reply.slot) + " was named and there are " + std::to_string(slot_count_));
  }
  if (leases_.is_lent(reply.slot)) return broken("slot " + std::to_string(reply.slot) + " is lent already");
  if (reply.bytes_used > slot_bytes_) {
    return broken("a frame of " + std::to_string(reply.bytes_used) + " bytes in a slot of " +
                  std::to_string(slot_bytes_));
  }
  if (has_sequence_ && reply.sequence <= last_sequence_) {
    return broken("frame " + std::to_string(reply.sequence) + " came after frame " + std::to_string(last_sequence_));
  }
  const std::size_t frame_bytes = mode_.stride_bytes * static_cast<std::size_t>(mode_.height_px);
  FrameInfo info;
  info.sequence = reply.sequence;
  info.stamp_ns = reply.stamp_ns;
  info.exposure_ns = reply.exposure_ns;
  info.lost_before =
      has_sequence_
          ? static_cast<std::uint32_t>(std::min<std::uint64_t>(reply.sequence - last_sequence_ - 1, UINT32_MAX))
          : 0;
  info.corrupt = reply.corrupt != 0 || reply.bytes_used < frame_bytes;
  last_sequence_ = reply.sequence;
  has_sequence_ = true;
  leases_.lend(reply.slot);
  return Frame(this, reply.slot, {frames_.at(reply.slot * slot_bytes_), frame_bytes}, info);
}

tl::expected<void, CameraError> SimSource::connect(const std::string& folder) {
  const std::string operation = "connecting", path = folder + "/frames.sock";
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof address.sun_path) {
    return tl::unexpected(camera_fault(Kind::unsupported, device_, operation, ENAMETOOLONG,
                                       "a socket's path has at most 107 characters: use a folder nearer the root"));
  }
  std::copy(path.begin(), path.end(), std::begin(address.sun_path));
  socket_ = FileDescriptor(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  if (!socket_) return tl::unexpected(camera_fault(Kind::system, device_, operation, errno, "close other programs"));
  // A server that does not accept must not hold the caller for ever.
  const timeval limit{.tv_sec = static_cast<time_t>(answer_limit_ns_ / 1'000'000'000),
                      .tv_usec = static_cast<suseconds_t>(answer_limit_ns_ / 1000 % 1'000'000)};
  ::setsockopt(socket_.get(), SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof limit);
  if (::connect(socket_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    const Kind kind = errno == ENOENT || errno == ECONNREFUSED ? Kind::not_found
                      : errno == EACCES                        ? Kind::permission
                      : errno == EAGAIN                        ? Kind::busy
                                                               : Kind::system;
    return tl::unexpected(camera_fault(kind, device_, operation + " to " + path, errno, kRemedy));
  }
  if (auto ready = wait_readable(answer_limit_ns_, operation); !ready) return tl::unexpected(std::move(ready.error()));

  Hello hello;
  iovec bytes{.iov_base = &hello, .iov_len = sizeof hello};
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
  msghdr message{};
  message.msg_iov = &bytes;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  const ssize_t size = ::recvmsg(socket_.get(), &message, MSG_CMSG_CLOEXEC);
  FileDescriptor memory;
  for (cmsghdr* header = CMSG_FIRSTHDR(&message); size >= 0 && header != nullptr;
       header = CMSG_NXTHDR(&message, header)) {
    if (header->cmsg_level == SOL_SOCKET && header->cmsg_type == SCM_RIGHTS &&
        header->cmsg_len >= CMSG_LEN(sizeof(int))) {
      int fd = -1;
      std::memcpy(&fd, CMSG_DATA(header), sizeof fd);
      memory = FileDescriptor(fd);
    }
  }
  const auto broken = [&](const std::string& cause) {
    return tl::unexpected(fault(Kind::protocol, operation, cause, kSameBuild));
  };
  if (size < 0) return tl::unexpected(camera_fault(Kind::system, device_, operation, errno, kRemedy));
  if (size == 0) {
    return tl::unexpected(
        fault(Kind::busy, operation, "the server closed the connection without a greeting", kRemedy, EBUSY));
  }
  if (size < static_cast<ssize_t>(sizeof(std::uint32_t) * 2)) {
    return broken("the greeting has only " + std::to_string(size) + " bytes");
  }
  // Magic and version first: they explain a greeting of another length.
  const bool known = hello.magic == frame_ring::kMagic && hello.version == frame_ring::kVersion;
  if (known && (size != sizeof hello || (message.msg_flags & MSG_TRUNC) != 0)) {
    return broken("the greeting has " + std::to_string(size) + " bytes instead of " + std::to_string(sizeof hello));
  }
  if (const auto cause = fault_of(hello)) return broken(*cause);
  if (!memory) return broken("the greeting came without the frames' memory");

  const std::size_t needed = std::size_t{hello.slot_count} * hello.slot_bytes;
  struct stat status {};
  if (::fstat(memory.get(), &status) != 0 || static_cast<std::uint64_t>(status.st_size) < needed) {
    return broken("the frames' memory has " + std::to_string(status.st_size) + " bytes and the slots need " +
                  std::to_string(needed));
  }
  // Without the seal a server that shrinks the memory would kill the reader by SIGBUS.
  const int seals = ::fcntl(memory.get(), F_GET_SEALS);
  if (seals < 0 || (seals & F_SEAL_SHRINK) == 0) return broken("the frames' memory is not sealed against shrinking");
  void* mapped = ::mmap(nullptr, needed, PROT_READ, MAP_SHARED, memory.get(), 0);
  if (mapped == MAP_FAILED) {
    return tl::unexpected(camera_fault(Kind::system, device_, "mapping the frames", errno, "free some memory"));
  }
  frames_ = Mapping(mapped, needed);
  slot_bytes_ = hello.slot_bytes;
  slot_count_ = hello.slot_count;
  leases_.resize(slot_count_);
  mode_ = {.width_px = static_cast<int>(hello.width_px),
           .height_px = static_cast<int>(hello.height_px),
           .stride_bytes = hello.stride_bytes,
           .format = static_cast<PixelFormat>(hello.format),
           .shutter = static_cast<Shutter>(hello.shutter),
           .frame_period_ns = hello.frame_period_ns,
           .exposure_ns = hello.exposure_ns,
           .identity = static_cast<const char*>(hello.identity),
           .simulated = true};
  if (mode_.format == PixelFormat::yuyv) mode_.colour.layout = ColourLayout::yuyv;
  return {};
}

}  // namespace

tl::expected<std::unique_ptr<FrameSource>, CameraError> open_sim_source(const std::string& folder,
                                                                        std::int64_t answer_limit_ns) {
  auto source = std::make_unique<SimSource>("sim:" + folder, answer_limit_ns);
  if (auto connected = source->connect(folder); !connected) return tl::unexpected(std::move(connected.error()));
  return source;
}

}  // namespace celadon
