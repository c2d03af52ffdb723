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
#include "sim/frame_store.h"
#include "sim/pacer.h"

namespace celadon::sim {

class FrameServer final : public Service {
 public:
  /// @pre all outlive it
  static tl::expected<std::unique_ptr<FrameServer>, std::string> open(const std::filesystem::path& socket_path,
                                                                      DeviceModel& model, Pacer& pacer,
                                                                      FrameStore& store);
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

  FrameServer(DeviceModel& model, Pacer& pacer, FrameStore& store) : model_(model), pacer_(pacer), store_(store) {}
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
  FrameStore& store_;
  std::filesystem::path path_;
  FileDescriptor listener_;
  std::vector<std::unique_ptr<Client>> clients_;
};

/// A listening Unix socket at a path; an old socket there that nobody serves is replaced.
tl::expected<FileDescriptor, std::string> listen_unix(const std::filesystem::path& path, int type);

}  // namespace celadon::sim
