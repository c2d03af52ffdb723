// celadond: configuration, calibration, store, queue, HTTP; then waits for a signal.

#include <pthread.h>

#include <csignal>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <system_error>

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>
#include <CLI/CLI.hpp>

#include "daemon/calibration/calibration_job.h"
#include "daemon/config.h"
#include "daemon/device_news.h"
#include "daemon/http/http_server.h"
#include "daemon/scan_queue.h"
#include "daemon/scan_store.h"
#include "daemon/scanner_connection.h"
#include "daemon/usage_error.h"

namespace celadon {
namespace {

constexpr int kGood = 0, kUsage = 2, kSystem = 4, kInterrupted = 130;

int fail(int code, const std::string& message) {
  std::fprintf(stderr, "celadond: %s\n", message.c_str());
  return code;
}

/// Signals that end the daemon are taken by sigwait in the main thread; all threads inherit the mask.
sigset_t block_signals() {
  sigset_t ending;
  sigemptyset(&ending);
  sigaddset(&ending, SIGINT);
  sigaddset(&ending, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &ending, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);  // a file size limit is then an errno with a sentence
  return ending;
}

struct CommandLine {
  std::string config_file, device, camera, button, calibration, store, record, unix_socket, log_level;
  int port = -1;
};

/// The configuration file first, then what the command line says.
tl::expected<Config, ConfigError> configure(const CommandLine& line) {
  Config config;
  if (!line.config_file.empty()) {
    if (auto read = read_config(line.config_file, config); !read) return tl::make_unexpected(read.error());
  }
  if (!line.device.empty()) config.device = line.device;
  if (!line.camera.empty()) config.camera = line.camera;
  if (!line.button.empty()) config.button = line.button;
  if (!line.calibration.empty()) config.calibration = line.calibration;
  if (!line.store.empty()) config.store = line.store;
  if (!line.record.empty()) config.record = line.record;
  if (!line.unix_socket.empty()) config.unix_socket = line.unix_socket;
  if (!line.log_level.empty()) config.log_level = line.log_level;
  if (line.port >= 0) config.http_port = static_cast<std::uint16_t>(line.port);
  if (auto checked = check_config(config); !checked) return tl::make_unexpected(checked.error());
  return config;
}

/// nullopt: the machine was never calibrated, and there is no such file yet.
tl::expected<std::optional<Calibration>, CalibrationError> read_present_calibration(const std::filesystem::path& file,
                                                                                    bool recording) {
  std::error_code ignored;
  if (!recording && std::filesystem::status(file, ignored).type() == std::filesystem::file_type::not_found)
    return std::nullopt;
  return read_calibration(file);
}

int serve(const Config& config, const sigset_t& ending) {
  const std::filesystem::path calibration_file =
      config.calibration.empty() ? config.store / "calibration.toml" : config.calibration;
  const auto calibration = read_present_calibration(calibration_file, config.device.empty());
  if (!calibration) return fail(kUsage, calibration.error().message);
  auto store = ScanStore::open(config.store);
  if (!store) return fail(kSystem, store.error().message);

  ScanQueueOptions options;
  options.device_url = config.device;
  options.camera_url = config.camera;
  options.recordings = config.record;
  options.button_request = config.scan;
  options.button = config.presses;
  if (!config.button.empty()) options.button.open = [url = config.button] { return open_button(url); };
  options.volume = config.volume;
  options.calibration = config.calibration_limits;
  options.run_calibration = run_calibration;
  options.calibration_file = calibration_file;
  ScanQueue queue(std::move(*store), *calibration, options, [&](const std::optional<Calibration>& present) {
    return present ? connect_scanner(config.device, config.camera, *present, config.drive, config.motion)
                   : open_scanner(config.device, config.camera, config.drive, config.motion);
  });
  if (auto started = queue.start(); !started) return fail(kUsage, started.error().message);
  const DeviceNews news([&queue](const std::string& device) {
    spdlog::debug("the device {} came, changed or went", device);
    queue.devices_changed();
  });
  spdlog::info("devices that come and go are told by {}", news.source() == DeviceNews::Source::udev     ? "udev"
                                                          : news.source() == DeviceNews::Source::kernel ? "the kernel"
                                                                                                        : "nobody");

  HttpServerOptions http;
  http.address = config.http_address;
  http.port = config.http_port;
  http.unix_socket = config.unix_socket;
  auto server = HttpServer::start(queue, http);
  if (!server) return fail(kSystem, server.error());

  for (const std::string& reason : queue.machine().calibration_due) spdlog::warn("{}", reason);
  std::printf("celadond ready: http://%s:%u%s%s\n", http.address.c_str(), unsigned{(*server)->port()},
              http.unix_socket.empty() ? "" : " unix:", http.unix_socket.c_str());
  std::fflush(stdout);

  int signal = 0;
  sigwait(&ending, &signal);
  spdlog::info("ending: {}", signal == SIGINT ? "interrupted" : "terminated");
  queue.stop();  // first the machine, then its viewers
  server->reset();
  return signal == SIGINT ? kInterrupted : kGood;
}

int run(int argc, char** argv) {
  const sigset_t ending = block_signals();
  CommandLine line;
  CLI::App app("Owns the scanner: takes presses of its button and requests over HTTP, scans, and leaves CAD files.",
               "celadond");
  app.add_option("--config", line.config_file, "TOML file; the options below override it");
  app.add_option("--device", line.device,
                 "modbus-tcp://HOST[:PORT], modbus-rtu:/dev/TTY or usb:[VID:PID]; none with replay:");
  app.add_option("--camera", line.camera, "v4l2:/dev/videoN, v4l2:serial=NUMBER (on USB), sim:FOLDER or replay:FOLDER");
  app.add_option("--button", line.button,
                 "a button at this computer, too: evdev:/dev/input/PATH[:KEY] or gpio:CHIP:LINE[?active=high|low]");
  app.add_option(
      "--calibration", line.calibration,
      "calibration file of this machine and camera; one that does not exist yet is made by a calibration (default: "
      "calibration.toml in the store)");
  app.add_option("--store", line.store, "folder of the scans");
  app.add_option("--record", line.record, "folder: keep the frames of each scan in it, for replay:");
  app.add_option("--http", line.port, "port on 127.0.0.1 (default 7450; 0 takes a free one)")
      ->check(CLI::Range(0, 65535));
  app.add_option("--unix-socket", line.unix_socket, "path of a Unix socket to serve, too");
  app.add_option("--log-level", line.log_level, "trace, debug, info (default), warn, error or off");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    if (e.get_exit_code() == 0) return app.exit(e);  // help
    return fail(kUsage, usage_sentence(app, e));
  }
  auto config = configure(line);
  if (!config) return fail(kUsage, config.error().message);

  spdlog::set_default_logger(spdlog::stderr_logger_mt("celadond"));
  spdlog::set_level(spdlog::level::from_str(config->log_level == "warn" ? "warning" : config->log_level));
  spdlog::set_pattern("%Y-%m-%dT%H:%M:%S.%e %l %v");
  return serve(*config, ending);
}

}  // namespace
}  // namespace celadon

int main(int argc, char** argv) {
  try {
    return celadon::run(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "celadond: %s\n", e.what());
    return 4;
  }
}
