#include "sim/frame_server.h"

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "sim/system_text.h"

namespace celadon::sim {
namespace {

constexpr std::size_t kMaxReaders = 8;

bool send_hello(int fd, const frame_ring::Hello& hello, int memory) {
  iovec data{const_cast<frame_ring::Hello*>(&hello), sizeof hello};
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  cmsghdr* header = CMSG_FIRSTHDR(&message);
  header->cmsg_level = SOL_SOCKET;
  header->cmsg_type = SCM_RIGHTS;
  header->cmsg_len = CMSG_LEN(sizeof memory);
  std::memcpy(CMSG_DATA(header), &memory, sizeof memory);
  return sendmsg(fd, &message, MSG_NOSIGNAL | MSG_DONTWAIT) == static_cast<ssize_t>(sizeof hello);
}

}  // namespace

tl::expected<FileDescriptor, std::string> listen_unix(const std::filesystem::path& path, int type) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string text = path.string();
  if (text.size() >= sizeof address.sun_path) {
    return tl::unexpected("socket path " + text + " has " + std::to_string(text.size()) + " characters; at most " +
                          std::to_string(sizeof address.sun_path - 1) + " fit, choose a shorter folder");
  }
  std::memcpy(address.sun_path, text.c_str(), text.size() + 1);
  const auto* generic = reinterpret_cast<const sockaddr*>(&address);
  std::error_code error;
  if (std::filesystem::is_socket(path, error)) {
    const FileDescriptor probe(socket(AF_UNIX, type | SOCK_CLOEXEC, 0));
    if (connect(probe.get(), generic, sizeof address) == 0) {
      return tl::unexpected("another virtual scanner serves " + text + "; stop it or choose another folder");
    }
    std::filesystem::remove(path, error);
  }
  FileDescriptor fd(socket(AF_UNIX, type | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (!fd || bind(fd.get(), generic, sizeof address) != 0 || listen(fd.get(), 16) != 0) {
    return tl::unexpected(system_text("listening on " + text));
  }
  return fd;
}

tl::expected<std::unique_ptr<FrameServer>, std::string> FrameServer::open(const std::filesystem::path& socket_path,
                                                                          DeviceModel& model, Pacer& pacer,
                                                                          FrameStore& store) {
  std::unique_ptr<FrameServer> server(new FrameServer(model, pacer, store));
  auto listener = listen_unix(socket_path, SOCK_SEQPACKET);
  if (!listener) return tl::unexpected(listener.error());
  server->listener_ = *std::move(listener);
  server->path_ = socket_path;
  return server;
}

FrameServer::~FrameServer() {
  if (!path_.empty()) {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
}

void FrameServer::collect(std::vector<pollfd>& polls) {
  polls.push_back({listener_.get(), POLLIN, 0});
  for (const auto& client : clients_) polls.push_back({client->fd.get(), POLLIN, 0});
}

void FrameServer::serve(const pollfd* polls, std::size_t count) {
  for (std::size_t i = 0; i < clients_.size() && i + 1 < count; ++i) {
    if (polls[i + 1].revents != 0) receive(*clients_[i]);
  }
  if (model_.camera_unplugged()) {
    // As with a real device: an open camera stays dead when it comes back; it must be opened anew.
    for (const auto& client : clients_) client->unplugged = true;
    store_.forget();
  }
  for (const auto& client : clients_) serve_waiting(*client);
  std::erase_if(clients_, [](const auto& client) { return client->closed; });
  if (count > 0 && (polls[0].revents & POLLIN) != 0) accept_client();
}

void FrameServer::accept_client() {
  FileDescriptor fd(accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
  if (!fd || clients_.size() >= kMaxReaders || model_.camera_unplugged()) return;
  const CameraConfig& camera = model_.camera().config();
  frame_ring::Hello hello;
  hello.slot_count = camera.slots;
  hello.slot_bytes = static_cast<std::uint32_t>(store_.slot_bytes());
  hello.width_px = static_cast<std::uint32_t>(camera.width_px);
  hello.height_px = static_cast<std::uint32_t>(camera.height_px);
  hello.stride_bytes = static_cast<std::uint32_t>(camera.stride_bytes());
  hello.format = static_cast<std::uint32_t>(camera.format);
  hello.shutter = static_cast<std::uint32_t>(camera.shutter);
  hello.lock_step = pacer_.lock_step() ? 1 : 0;
  hello.frame_period_ns = camera.period_ns;
  hello.exposure_ns = camera.exposure_ns;
  const std::string identity = model_.camera_identity().substr(0, sizeof hello.identity - 1);
  std::memcpy(hello.identity, identity.c_str(), identity.size());
  if (!send_hello(fd.get(), hello, store_.memory())) return;
  auto client = std::make_unique<Client>();
  client->fd = std::move(fd);
  client->number = pacer_.new_client();
  clients_.push_back(std::move(client));
}

void FrameServer::close_client(Client& client) {
  if (client.closed) return;
  client.closed = true;
  store_.stop(client.number);
  pacer_.forget(client.number);
}

void FrameServer::receive(Client& client) {
  while (!client.closed) {
    frame_ring::Request request;
    const ssize_t n = recv(client.fd.get(), &request, sizeof request, MSG_DONTWAIT | MSG_TRUNC);
    if (n < 0 && (errno == EAGAIN || errno == EINTR)) return;
    if (n != static_cast<ssize_t>(sizeof request)) return close_client(client);  // gone, or not this protocol
    handle(client, request);
  }
}

void FrameServer::handle(Client& client, const frame_ring::Request& request) {
  using frame_ring::RequestKind;
  pacer_.catch_up();
  if (model_.camera_unplugged()) client.unplugged = true;
  CameraTimeline& camera = model_.camera();
  const bool streams = store_.streams(client.number);
  switch (request.kind) {
    case RequestKind::start:
      if (client.unplugged) return reply_fault(client, ENODEV);
      if (!store_.start(client.number)) return reply_fault(client, EBUSY);
      return reply(client, {.kind = frame_ring::ReplyKind::started});
    case RequestKind::stop:
      store_.stop(client.number);
      return reply(client, {.kind = frame_ring::ReplyKind::stopped});
    case RequestKind::next:
      return next_frame(client, request.value);
    case RequestKind::give_back:
      if (streams && request.value >= 0 && request.value < camera.config().slots) {
        camera.give_back(static_cast<std::uint32_t>(request.value));
      }
      return;
    case RequestKind::set_exposure: {
      if (client.unplugged) return reply_fault(client, ENODEV);
      frame_ring::Reply answer{.kind = frame_ring::ReplyKind::exposure};
      answer.value = camera.set_exposure(request.value, model_.now_ns());
      return reply(client, answer);
    }
  }
  close_client(client);  // a kind that version 1 does not have
}

void FrameServer::next_frame(Client& client, std::int64_t timeout_ns) {
  if (client.unplugged) return reply_fault(client, ENODEV);
  if (!store_.streams(client.number)) return reply_fault(client, EINVAL);
  constexpr std::int64_t kLongest_ns = 3'600'000'000'000;
  const std::int64_t deadline = model_.now_ns() + std::clamp<std::int64_t>(timeout_ns, 0, kLongest_ns);
  if (pacer_.lock_step()) {
    pacer_.declare(client.number);
    if (const auto ticket = model_.advance_to_frame(deadline)) return reply_frame(client, *ticket);
    if (model_.camera_unplugged()) return reply_fault(client, ENODEV);
    return reply(client, {.kind = frame_ring::ReplyKind::timed_out});
  }
  client.waiting = true;
  client.deadline_ns = deadline;
  serve_waiting(client);
}

void FrameServer::serve_waiting(Client& client) {
  if (!client.waiting || client.closed) return;
  if (const auto ticket = model_.camera().take(model_.now_ns())) {
    client.waiting = false;
    return reply_frame(client, *ticket);
  }
  if (client.unplugged) {
    client.waiting = false;
    return reply_fault(client, ENODEV);
  }
  if (model_.now_ns() >= client.deadline_ns) {
    client.waiting = false;
    reply(client, {.kind = frame_ring::ReplyKind::timed_out});
  }
}

void FrameServer::reply_frame(Client& client, const FrameTicket& ticket) {
  frame_ring::Reply answer{.kind = frame_ring::ReplyKind::frame};
  answer.slot = ticket.slot;
  answer.sequence = ticket.sequence;
  answer.stamp_ns = ticket.stamp_ns;
  answer.exposure_ns = ticket.exposure_ns;
  answer.bytes_used = ticket.bytes_used;
  answer.corrupt = ticket.corrupt ? 1 : 0;
  reply(client, answer);
}

void FrameServer::reply_fault(Client& client, int errno_value) {
  frame_ring::Reply answer{.kind = frame_ring::ReplyKind::fault};
  answer.value = errno_value;
  reply(client, answer);
}

void FrameServer::reply(Client& client, const frame_ring::Reply& answer) {
  if (send(client.fd.get(), &answer, sizeof answer, MSG_NOSIGNAL | MSG_DONTWAIT) !=
      static_cast<ssize_t>(sizeof answer)) {
    close_client(client);
  }
}

}  // namespace celadon::sim
