#pragma once
// The controller's registers over Modbus TCP and over RTU on a pseudo terminal.

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "sim/file_descriptor.h"
#include "sim/modbus_port.h"
#include "sim/pacer.h"

namespace celadon::sim {

class ModbusServer final : public Service, private Registers {
 public:
  ModbusServer(DeviceModel& model, Pacer& pacer) : model_(model), pacer_(pacer) {}
  ~ModbusServer() override;
  ModbusServer(const ModbusServer&) = delete;
  ModbusServer& operator=(const ModbusServer&) = delete;

  /// Listens on HOST:PORT (port 0: a free one). @returns the URL that clients use
  tl::expected<std::string, std::string> listen_tcp(const std::string& host_and_port);
  /// Opens a pseudo terminal; `link`, if not empty, becomes a symbolic link to it. @returns the URL that clients use
  tl::expected<std::string, std::string> open_rtu(const std::filesystem::path& link);

  void collect(std::vector<pollfd>& polls) override;
  void serve(const pollfd* polls, std::size_t count) override;

 private:
  struct Link {
    FileDescriptor fd;
    ModbusFraming framing;
    ModbusReader reader;
    struct Answer {
      std::int64_t due_ns;
      std::vector<std::uint8_t> bytes;
    };
    std::vector<Answer> answers;
    std::int64_t last_byte_ns = 0;
    bool closed = false;
  };

  protocol::Exception read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override;
  protocol::Exception read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override;
  protocol::Exception write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override;

  void follow_plug();
  void accept_client();
  void receive(Link& link);
  void answer(Link& link, const ModbusRequest& request);
  bool noise_hits();
  void give_no_answer();
  void send_due(Link& link);

  DeviceModel& model_;
  Pacer& pacer_;
  FileDescriptor listener_;
  FileDescriptor terminal_;  ///< the slave's end, kept open so that a client may come and go
  std::filesystem::path link_path_;
  bool serves_rtu_ = false, unplugged_ = false;
  std::uint32_t noisy_bytes_ = 0;  ///< drawn so far
  std::vector<std::unique_ptr<Link>> links_;
};

}  // namespace celadon::sim
