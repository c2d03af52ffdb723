// celadon calibrate: asks for board and platter on the terminal, by a daemon or on a machine that has none.

#include <atomic>
#include <csignal>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include <CLI/CLI.hpp>

#include "acquisition/calibrate/target_board.h"
#include "daemon/calibration/calibration_job.h"
#include "daemon/calibration/calibration_narrator.h"
#include "daemon/cli/commands.h"
#include "daemon/cli/confirm_key.h"
#include "daemon/cli/order_calibration.h"
#include "daemon/cli/order_scan.h"
#include "daemon/config.h"
#include "daemon/files/atomic_file.h"

namespace celadon::cli {
namespace {

/// Exit codes.
enum Ending { kRefused = 1, kWrongInput = 2, kNoMachine = 3, kNotWritten = 4, kStopped = 130 };

constexpr int kGlance_ms = 50;

struct Arguments {
  std::string server, config_file, device, camera, output;
  CalibrationRequest request;
  double width_mm = 0, height_mm = 0;
  /// Otherwise the daemon's machine is meant.
  bool names_machine() const { return !(config_file.empty() && device.empty() && camera.empty()); }
};

std::atomic<bool> g_interrupted = false;

/// The operator at the terminal: one line for whatever is new, Enter for what is done.
class Terminal final : public CalibrationNarrator {
 public:
  void ask(const std::string& instruction) override { tell_instruction(instruction); }
  bool done() override { return key_.pressed_within(kGlance_ms); }
  void on_state(ScanState state) override {
    if (state == ScanState::solving) tell_operator("solving ...");
  }
  std::optional<std::string> cancelled() override {
    if (g_interrupted) return "by a signal";
    return std::nullopt;
  }

 protected:
  void say(const std::string& sentence) override { tell_operator(sentence); }

 private:
  ConfirmKey key_;
};

/// On a machine that no daemon holds.
int calibrate_directly(const Arguments& a) {
  Config config;
  if (!a.config_file.empty()) {
    if (auto read = read_config(a.config_file, config); !read) return fail(kWrongInput, read.error().message);
  }
  if (!a.device.empty()) config.device = a.device;
  if (!a.camera.empty()) config.camera = a.camera;
  if (config.device.empty() || config.camera.empty()) {
    return fail(kWrongInput, "a calibration needs a machine and its camera: give --device and --camera, or --config");
  }
  if (a.output.empty()) return fail(kWrongInput, "no file for the calibration is named; give --output FILE");
  auto machine = open_scanner(config.device, config.camera, config.drive, config.motion);
  if (!machine) return fail(machine.error().wrong_configuration ? kWrongInput : kNoMachine, machine.error().message);

  Terminal terminal;
  const auto interrupt = [](int) { g_interrupted = true; };
  std::signal(SIGINT, interrupt);
  std::signal(SIGTERM, interrupt);
  auto outcome = run_calibration(*machine, a.request, false, terminal);
  if (!outcome) {
    const ScanStop& stop = outcome.error();
    const bool refused = stop.state == ScanState::cancelled || stop.failure == ScanFailure::data;
    return fail(g_interrupted ? kStopped : refused ? kRefused : kNoMachine, stop.reason);
  }
  tell_steps(outcome->steps);
  if (!outcome->calibration) {
    return fail(kRefused,
                "the calibration is refused, and nothing was written: follow what stands beside the steps above");
  }
  if (auto written = write_file_atomically(a.output, format_calibration(*outcome->calibration)); !written) {
    return fail(kNotWritten, written.error().message);
  }
  tell_operator("calibration: " + a.output + " (" + outcome->verdict + ")");
  return 0;
}

int calibrate(Arguments a) {
  if (!a.output.empty() && std::filesystem::exists(a.output)) {
    return fail(kWrongInput, a.output + " exists; name another file, or move it away");
  }
  if (!a.server.empty() && a.names_machine()) {
    return fail(kWrongInput,
                "--server names a daemon, which owns its machine; leave out --config, --device and --camera");
  }
  const auto board = TargetBoard::parse(a.request.board);
  if (!board) return fail(kWrongInput, "--board " + a.request.board + ": " + board.error());
  if (a.width_mm != 0) a.request.width_mm = a.width_mm;
  if (a.height_mm != 0) a.request.height_mm = a.height_mm;
  if (const auto wrong = implausible_size(a.request, *board)) return fail(kWrongInput, *wrong);
  if (a.names_machine()) return calibrate_directly(a);
  return order_calibration(a.server.empty() ? kServer : a.server, a.request, a.output);
}

}  // namespace

void add_calibrate_command(CLI::App& program, Run& run) {
  auto a = std::make_shared<Arguments>();
  auto* c = program.add_subcommand(
      "calibrate",
      "Calibrates camera, lasers, axis and encoder, and elevation and lift where there are such, of "
      "a machine with a printed board, and asks for what has to be done by hand. A daemon that owns the machine uses "
      "the calibration at once; a machine without one is named by --device and --camera, or --config, and "
      "the calibration is written to a file.");
  c->add_option("--server", a->server, std::string(kServerHelp) + "; default: " + kServer);
  c->add_option("--config", a->config_file, "configuration of a daemon that does not run: its machine and camera");
  c->add_option("--device", a->device, "modbus-tcp://HOST[:PORT], modbus-rtu:/dev/TTY or usb:[VID:PID]");
  c->add_option("--camera", a->camera, "v4l2:/dev/videoN, v4l2:serial=NUMBER (on USB) or sim:FOLDER");
  c->add_option("--board", a->request.board, "the printed board, as `celadon board` printed it")->capture_default_str();
  c->add_option("--width", a->width_mm, "measured over all its squares from left to right, mm; without: 0.3 % unsure");
  c->add_option("--height", a->height_mm, "the same from top to bottom, mm");
  c->add_option("--measured-u", a->request.measured_u_mm, "standard uncertainty of both, mm")
      ->check(CLI::Range(1e-4, 10.))
      ->capture_default_str();
  c->add_option("--views", a->request.views, "views of the board held by hand")
      ->check(CLI::Range(5, 200))
      ->capture_default_str();
  c->add_option("--placements", a->request.placements, "of the board on the platter")
      ->check(CLI::Range(1, 12))
      ->capture_default_str();
  c->add_option("--angles", a->request.angles, "of the table, a turn")
      ->check(CLI::Range(8, 360))
      ->capture_default_str();
  c->add_option("--stops", a->request.stops,
                "of the head's elevation and of the lift, where there are such, for each placement; 0: they are not "
                "calibrated")
      ->check(CLI::Range(0, 100))
      ->capture_default_str();
  c->add_option("--exposure", a->request.exposure_ms, "of each frame, ms; without: as the camera stands");
  c->add_option("-o,--output", a->output, "calibration file; of a daemon's calibration a copy");
  c->callback([a, &run] { run = [a] { return calibrate(*a); }; });
}

}  // namespace celadon::cli
