#pragma once
// The control socket of CONTROL.md: lines in, JSON lines out.

#include <filesystem>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "sim/file_descriptor.h"
#include "sim/pacer.h"

namespace celadon::sim {

class ControlSocket final : public Service {
 public:
  /// modbus_url: what `hello` tells.
  static tl::expected<std::unique_ptr<ControlSocket>, std::string> open(const std::filesystem::path& socket_path,
                                                                        DeviceModel& model, Pacer& pacer,
                                                                        const std::string& modbus_url);
  ~ControlSocket() override;
  ControlSocket(const ControlSocket&) = delete;
  ControlSocket& operator=(const ControlSocket&) = delete;

  void collect(std::vector<pollfd>& polls) override;
  void serve(const pollfd* polls, std::size_t count) override;

  /// Answers one line (without its end) of a client; the grammar, without sockets.
  nlohmann::json answer(const std::string& line, std::uint64_t client);

 private:
  struct Client {
    FileDescriptor fd;
    std::uint64_t number = 0;
    std::string input;
    bool closed = false;
  };

  ControlSocket(DeviceModel& model, Pacer& pacer, std::string modbus_url)
      : model_(model), pacer_(pacer), modbus_url_(std::move(modbus_url)) {}
  void receive(Client& client);
  void send_line(Client& client, const nlohmann::json& answer);

  DeviceModel& model_;
  Pacer& pacer_;
  std::string modbus_url_;
  std::filesystem::path path_;
  FileDescriptor listener_;
  std::vector<std::unique_ptr<Client>> clients_;
};

}  // namespace celadon::sim
