#pragma once
// The virtual scanner as a process: one device model, its sockets, one poll loop.

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "sim/control_socket.h"
#include "sim/frame_server.h"
#include "sim/modbus_server.h"

namespace celadon::sim {

struct ServerOptions {
  DeviceConfig device;
  bool lock_step = false;
  std::string modbus_tcp = "127.0.0.1:0";  ///< HOST:PORT, empty: none
  bool modbus_rtu = false;
  std::filesystem::path modbus_rtu_link;  ///< empty: none
  std::string usbip;                      ///< HOST:PORT; "attach": into this machine's kernel; empty: none
  std::filesystem::path socket_dir;       ///< made if it does not exist
  std::vector<std::string> faults;        ///< NAME[,ARGUMENT][@SECONDS]
  std::string fault_plan;                 ///< text of a plan, CONTROL.md
};

class Server {
 public:
  /// @returns one sentence when something can not be opened
  static tl::expected<std::unique_ptr<Server>, std::string> open(const ServerOptions& options);

  const std::string& modbus_url() const { return modbus_url_; }
  const std::string& modbus_rtu_url() const { return modbus_rtu_url_; }
  /// One JSON line for whoever started the process.
  std::string ready_line() const;
  /// Serves until stop().
  void run();
  /// Ends run(); from any thread or signal handler.
  void stop() noexcept;

 private:
  explicit Server(const ServerOptions& options);
  std::int64_t poll_timeout_ns() const;

  ServerOptions options_;
  DeviceModel model_;
  Pacer pacer_;
  FileDescriptor stop_;
  std::string modbus_url_, modbus_rtu_url_, usbip_address_;
  std::vector<std::unique_ptr<Service>> services_;
};

}  // namespace celadon::sim
