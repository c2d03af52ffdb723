#pragma once
// Frames over a Unix socket, as acquisition/frame_ring.h says. One client streams at a time; others are told that the
// camera is busy.

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/frame_ring.h"
#include "sim/file_descriptor.h"
#include "sim/pacer.h"
#include "sim/render_worker.h"

namespace celadon::sim {

class FrameServer final : public Service {
 public:
  /// Renders in lock-step within the clock's advance, else in a thread of its own.
  static tl::expected<std::unique_ptr<FrameServer>, std::string> open(const std::filesystem::path& socket_path,
                                                                      DeviceModel& model, Pacer& pacer);
  ~FrameServer() override;
  FrameServer(const FrameServer&) = delete;
  FrameServer& operator=(const FrameServer&) = delete;

  void collect(std::vector<pollfd>& polls) override;
  void serve(const pollfd* polls, std::size_t count) override;

 private:
  struct Client {
    FileDescriptor fd;
    std::uint64_t number = 0;
    bool waiting = false;
    bool unplugged = false;
    std::int64_t deadline_ns = 0;
    bool closed = false;
  };

  FrameServer(DeviceModel& model, Pacer& pacer) : model_(model), pacer_(pacer) {}
  void accept_client();
  void receive(Client& client);
  void handle(Client& client, const frame_ring::Request& request);
  void next_frame(Client& client, std::int64_t timeout_ns);
  void serve_waiting(Client& client);
  void reply(Client& client, const frame_ring::Reply& reply);
  void reply_frame(Client& client, const FrameTicket& ticket);
  void reply_fault(Client& client, int errno_value);
  void close_client(Client& client);

  DeviceModel& model_;
  Pacer& pacer_;
  std::filesystem::path path_;
  FileDescriptor listener_, memory_;
  std::span<std::uint8_t> slots_;
  std::size_t slot_bytes_ = 0;
  std::unique_ptr<SlotPainter> painter_;
  std::unique_ptr<RenderWorker> worker_;
  std::vector<std::unique_ptr<Client>> clients_;
  std::uint64_t streaming_client_ = 0;
};

/// A listening Unix socket at a path; an old socket there that nobody serves is replaced.
tl::expected<FileDescriptor, std::string> listen_unix(const std::filesystem::path& path, int type);

}  // namespace celadon::sim
