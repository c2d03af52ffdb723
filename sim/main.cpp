// celadon-sim: serves a virtual scanner, and talks to one that runs.

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstring>
#include <ctime>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <sstream>

#include "sim/artefact.h"
#include "sim/device_truth.h"
#include "sim/machine_options.h"
#include "sim/picture_file.h"
#include "sim/renderer.h"
#include "sim/server.h"

namespace celadon::sim {
namespace {

constexpr const char* kUsbipAddress = "127.0.0.1:3240";
constexpr int kGood = 0, kNo = 1, kInput = 2, kDevice = 3, kSystem = 4;

int fail(int code, const std::string& sentence) {
  std::cerr << "celadon-sim: " << sentence << "\n";
  return code;
}

Server* running_server = nullptr;
void on_signal(int /*number*/) {
  if (running_server != nullptr) running_server->stop();
}

int serve(const Options& o) {
  ServerOptions options;
  options.device = device_of(o);
  options.lock_step = o.speed == "max";
  options.modbus_tcp = o.modbus_tcp == "none" ? "" : o.modbus_tcp;
  options.modbus_rtu = !o.modbus_rtu.empty();
  options.modbus_rtu_link = o.modbus_rtu == "auto" ? "" : o.modbus_rtu;
  options.usbip = o.usbip;
  options.socket_dir = o.socket_dir;
  options.faults = o.faults;
  for (const std::string& text : o.faults) {
    if (const auto order = parse_fault_option(text, 0); !order) return fail(kInput, order.error());
  }
  if (!o.fault_plan.empty()) {
    std::ifstream in(o.fault_plan, std::ios::binary);
    std::ostringstream text;
    text << in.rdbuf();
    if (!in) return fail(kInput, "reading the fault plan " + o.fault_plan + " failed: " + std::strerror(errno));
    options.fault_plan = text.str();
    if (const auto plan = parse_fault_plan(options.fault_plan, {}); !plan) return fail(kInput, plan.error());
  }
  auto server = Server::open(options);
  if (!server) return fail(kSystem, server.error());
  running_server = server->get();
  struct sigaction action {};
  action.sa_handler = on_signal;
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  std::cout << (*server)->ready_line() << std::endl;
  (*server)->run();
  running_server = nullptr;
  return kGood;
}

/// One question to a running virtual scanner. @returns the answer or nothing after telling why
std::optional<nlohmann::json> ask(const Options& o, const std::string& line, int& code) {
  if (o.socket_dir.empty()) {
    code = fail(kInput, "give the folder of the running virtual scanner with --socket-dir");
    return std::nullopt;
  }
  const std::string path = (std::filesystem::path(o.socket_dir) / "control.sock").string();
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const FileDescriptor fd(socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  if (path.size() < sizeof address.sun_path) std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
  if (!fd || path.size() >= sizeof address.sun_path ||
      connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    code = fail(kDevice, "no virtual scanner answers at " + path + " (" + std::strerror(errno) +
                             "); start one with celadon-sim --socket-dir " + o.socket_dir);
    return std::nullopt;
  }
  const std::string request = line + "\n";
  std::string answer;
  if (send(fd.get(), request.data(), request.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(request.size())) {
    char bytes[4096];
    pollfd p{fd.get(), POLLIN, 0};
    while (answer.find('\n') == std::string::npos && poll(&p, 1, 10'000) > 0) {
      const ssize_t n = recv(fd.get(), bytes, sizeof bytes, 0);
      if (n <= 0) break;
      answer.append(bytes, static_cast<std::size_t>(n));
    }
  }
  nlohmann::json parsed = nlohmann::json::parse(answer, nullptr, false);
  if (!parsed.is_object()) {
    code = fail(kDevice, "the virtual scanner at " + path + " gave no answer; look whether it still runs");
    return std::nullopt;
  }
  if (!parsed.value("ok", false)) {
    code = fail(kInput, parsed.value("error", "the virtual scanner refused"));
    return std::nullopt;
  }
  code = kGood;
  return parsed;
}

int ask_and_print(const Options& o, const std::string& line) {
  int code = kGood;
  if (const auto answer = ask(o, line, code)) std::cout << answer->dump() << "\n";
  return code;
}

/// The true calibration, of the running scanner if a folder is given, else of the one that these options would make.
int write_calibration(const Options& o, const std::string& file) {
  std::string text;
  if (!o.socket_dir.empty()) {
    int code = kGood;
    const auto answer = ask(o, "calibration", code);
    if (!answer) return code;
    text = answer->value("calibration", "");
  } else {
    text = format_calibration(DeviceModel(device_of(o)).calibration());
  }
  if (file == "-") {
    std::cout << text;
    return kGood;
  }
  // Beside the target first: there is never half a calibration under its name.
  const std::string part = file + ".part";
  std::ofstream out(part, std::ios::binary | std::ios::trunc);
  out << text;
  out.close();
  std::error_code error;
  std::string cause = out ? "" : std::strerror(errno);
  if (out) std::filesystem::rename(part, file, error);
  if (error) cause = error.message();
  if (!out || error) {
    std::filesystem::remove(part, error);
    return fail(kSystem, "writing " + file + " failed: " + cause + "; free some space or choose another folder");
  }
  return kGood;
}

int print_truth(const Options& o, double angle_deg, double z_mm) {
  const double theta = angle_deg * std::numbers::pi / 180;
  double r = 0;
  if (!o.socket_dir.empty()) {
    std::array<char, 80> line{};
    std::snprintf(line.data(), line.size(), "truth %.17g %.17g", theta, z_mm);
    int code = kGood;
    const auto answer = ask(o, line.data(), code);
    if (!answer) return code;
    r = answer->value("r_mm", 0.0);
  } else {
    r = DeviceModel(device_of(o)).scene().truth_r_mm(theta, z_mm);
    if (std::isnan(r)) return fail(kNo, "scene " + o.scene + " has no surface at that height");
  }
  std::printf("%.12g\n", r);
  return kGood;
}

/// What the axes of a machine that is asked about say.
struct Readings {
  double angle_deg = 0, elevation_deg = 0, lift_mm = 0;

  void add_options(CLI::App& command) {
    command.add_option("--elevation-angle", elevation_deg, "what the elevation axis says, degrees (with --elevation)")
        ->capture_default_str();
    command.add_option("--lift-height", lift_mm, "what the lift says, mm (with --lift)")->capture_default_str();
  }
  /// One sentence where the machine has no such axis, or not so far.
  std::optional<std::string> impossible(const DeviceConfig& device) const {
    const auto check = [](const char* option, const char* flag, double value, bool there, double low,
                          double high) -> std::optional<std::string> {
      std::array<char, 160> text{};
      if (value != 0 && !there) {
        std::snprintf(text.data(), text.size(), "%s %g needs a machine with such an axis; add %s", option, value, flag);
        return text.data();
      }
      if (!(value >= low && value <= high)) {
        std::snprintf(text.data(), text.size(), "%s %g is beyond the axis's travel; give %g to %g", option, value, low,
                      high);
        return text.data();
      }
      return std::nullopt;
    };
    constexpr double kDeg = 180 / std::numbers::pi;
    const MachineAxes& axes = device.optics.axes;
    auto wrong = check("--elevation-angle", "--elevation", elevation_deg, axes.elevation.has_value(),
                       device.elevation.lowest * kDeg - 1e-9, device.elevation.highest * kDeg + 1e-9);
    if (!wrong) {
      wrong = check("--lift-height", "--lift", lift_mm, axes.lift.has_value(), device.lift.lowest, device.lift.highest);
    }
    return wrong;
  }
  Posture posture(const DeviceConfig& device) const {
    constexpr double kRad = std::numbers::pi / 180;
    return device.optics.axes.at(angle_deg * kRad, elevation_deg * kRad, lift_mm);
  }
};

int write_frame(const Options& o, const Readings& at, double speed_deg_per_s, bool laser, const std::string& file) {
  const DeviceConfig device = device_of(o);
  if (const auto wrong = at.impossible(device)) return fail(kInput, *wrong);
  const Posture posture = at.posture(device);
  const double angle = posture.table_rad, speed = speed_deg_per_s * std::numbers::pi / 180;
  Renderer renderer(DeviceModel(device).scene(), device.optics);
  Exposure e;
  e.seed = o.seed;
  e.exposure_ns = device.camera.exposure_ns;
  e.line_time_ns = device.camera.line_time_ns();
  // The angle asked for is that of the middle of the picture.
  const std::int64_t middle = e.exposure_ns / 2 - e.line_time_ns * device.camera.height_px / 2;
  for (std::int64_t ms = -1000; ms <= 1000; ++ms) {
    e.motion.samples.push_back({angle + speed * 1e-9 * static_cast<double>(ms * 1'000'000 + middle), speed,
                                laser ? 1.0 : 0.0, laser ? 1.0 : 0.0, posture.elevation_rad, 0, posture.lift_mm, 0});
  }
  e.motion.first_ns = -1'000'000'000;
  std::vector<std::uint8_t> bytes(device.camera.frame_bytes());
  renderer.render(e, bytes, device.camera.stride_bytes());
  const auto done = write_picture(file, device.camera.width_px, device.camera.height_px, device.camera.format, bytes);
  return done ? kGood : fail(kSystem, done.error());
}

int run(int argc, char** argv) {
  Options o;
  CLI::App app("Virtual turntable laser-line scanner: serves Modbus, frames and a control socket until it is stopped.",
               "celadon-sim");
  app.fallthrough();
  app.require_subcommand(0, 1);
  add_machine_options(app, o);
  app.add_option("--socket-dir", o.socket_dir,
                 "folder of frames.sock and control.sock; of the running scanner for subcommands");
  app.add_option("--modbus-tcp", o.modbus_tcp, "listen on HOST:PORT (port 0: a free one) or none")
      ->capture_default_str();
  app.add_option("--modbus-rtu", o.modbus_rtu,
                 "serve Modbus RTU on a pseudo terminal: a path for a link to it, or auto");
  auto* usbip =
      app.add_option(
             "--usbip", o.usbip,
             "be a USB device, controller and camera: over USB/IP on HOST:PORT (127.0.0.1:3240 unless given), or "
             "attach: in this machine's kernel (as root, with the module vhci-hcd)")
          ->expected(0, 1);
  app.add_option("--speed", o.speed, "real: real time; max: lock-step, time moves by declared waits")
      ->check(CLI::IsMember({"real", "max"}))
      ->capture_default_str();
  app.add_option("--fault", o.faults,
                 "NAME[,ARGUMENT][@SECONDS]: inject a fault, at once or at that time; may be repeated")
      ->allow_extra_args(false);
  app.add_option("--fault-plan", o.fault_plan, "file of faults by time, angle and frame (CONTROL.md)");
  app.add_flag("--locked", o.locked, "after power-on the button must be pressed before anything moves or shines");

  double press_ms = 100;
  auto* press = app.add_subcommand("press", "push the button of the running scanner");
  press->add_option("--hold", press_ms, "held for, ms")->capture_default_str();
  std::vector<std::string> fault_words;
  auto* fault = app.add_subcommand("fault", "inject a fault into the running scanner; \"list\" names them");
  fault->add_option("fault", fault_words, "NAME [ARGUMENT] [at SECONDS | angle DEG | frame N] [for SECONDS]")
      ->required()
      ->expected(1, 6);
  std::string cleared;
  auto* clear = app.add_subcommand("clear", "take a fault back");
  clear->add_option("name", cleared, "its name")->required();
  std::string scene_name;
  auto* scene =
      app.add_subcommand("scene", "put another object or board on the running scanner's table, or hold it up");
  scene->add_option("scene", scene_name, "as --scene; without: what is there");
  auto* state = app.add_subcommand("state", "how the running scanner really is");
  std::string calibration_file;
  double truth_z = 0;
  Readings truth_readings, frame_readings;
  auto* truth = app.add_subcommand("truth", "the true calibration, or the object's true radius in the scanner frame");
  auto* truth_file =
      truth->add_option("--calibration", calibration_file, "write the true parameters to this file (-: print them)");
  auto* truth_at = truth->add_option("--angle", truth_readings.angle_deg, "angle, degrees");
  truth->add_option("--z", truth_z, "height, mm")->needs(truth_at);
  truth_file->excludes(truth_at);
  bool truth_effects = false, truth_corners = false, truth_artefact = false;
  truth
      ->add_flag("--artefact", truth_artefact,
                 "print the exact certificate of the scene artefact, as celadon accept reads it")
      ->excludes(truth_file)
      ->excludes(truth_at);
  truth->add_flag("--effects", truth_effects, "print what the machine does beyond the calibrated model")
      ->excludes(truth_file)
      ->excludes(truth_at);
  truth
      ->add_flag("--corners", truth_corners,
                 "print the corners of calibration targets, in pixels, at --angle, --elevation-angle and --lift-height")
      ->excludes(truth_file);
  truth_readings.add_options(*truth);
  auto* calibration = app.add_subcommand("calibration", "print the true calibration");
  double frame_speed = 0;
  std::string frame_file;
  bool frame_dark = false;
  auto* frame = app.add_subcommand("frame", "render one picture to a file (.png or .pgm; YUYV: its luma)");
  frame->add_option("--angle", frame_readings.angle_deg, "table angle, degrees")->capture_default_str();
  frame_readings.add_options(*frame);
  frame->add_option("--turning", frame_speed, "table speed, degrees a second")->capture_default_str();
  frame->add_flag("--laser-off", frame_dark, "without the laser");
  frame->add_option("-o,--output", frame_file, "file to write")->required();

  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp& e) {
    app.exit(e);
    return kGood;
  } catch (const CLI::ParseError& e) {
    return fail(kInput, std::string(e.what()) + "; see celadon-sim --help");
  }
  if (press->parsed()) return ask_and_print(o, "press " + std::to_string(std::llround(press_ms)));
  if (fault->parsed()) {
    std::string line = "fault";
    for (const std::string& word : fault_words) line += " " + word;
    return ask_and_print(o, line);
  }
  if (clear->parsed()) return ask_and_print(o, "clear " + cleared);
  if (scene->parsed()) return ask_and_print(o, scene_name.empty() ? "scene" : "scene " + scene_name);
  if (state->parsed()) return ask_and_print(o, "state");
  if (o.socket_dir.empty() || (!calibration->parsed() && !truth->parsed())) {
    if (const auto made = Scene::make(o.scene, device_of(o).print); !made)
      return fail(kInput, made.error() + "; see celadon-sim --help");
  }
  if (calibration->parsed()) return write_calibration(o, "-");
  if (truth->parsed()) {
    if (!calibration_file.empty()) return write_calibration(o, calibration_file);
    if (truth_artefact) {
      std::cout << artefact_certificate();
      return kGood;
    }
    if (truth_effects) {
      if (!o.socket_dir.empty()) return ask_and_print(o, "effects");
      std::cout << effects_of(device_of(o)).dump() << "\n";
      return kGood;
    }
    if (truth_corners) {
      if (!o.socket_dir.empty()) {
        constexpr double kRad = std::numbers::pi / 180;
        std::array<char, 96> line{};
        std::snprintf(line.data(), line.size(), "corners %.17g %.17g %.17g", truth_readings.angle_deg * kRad,
                      truth_readings.elevation_deg * kRad, truth_readings.lift_mm);
        return ask_and_print(o, line.data());
      }
      DeviceModel model(device_of(o));
      if (const auto wrong = truth_readings.impossible(model.config())) return fail(kInput, *wrong);
      std::cout << corners_of(model.config(), model.scene(), truth_readings.posture(model.config())).dump() << "\n";
      return kGood;
    }
    if (truth_at->count() == 0) {
      return fail(kInput, "truth needs --calibration FILE, --effects, --artefact or --angle DEG --z MM");
    }
    return print_truth(o, truth_readings.angle_deg, truth_z);
  }
  if (frame->parsed()) return write_frame(o, frame_readings, frame_speed, !frame_dark, frame_file);
  if (usbip->count() > 0 && o.usbip.empty()) o.usbip = kUsbipAddress;
  if (o.modbus_tcp == "none" && o.modbus_rtu.empty() && o.usbip.empty() && o.socket_dir.empty()) {
    return fail(kInput, "there is nothing to serve; give --socket-dir, --modbus-tcp, --modbus-rtu or --usbip");
  }
  if (!o.usbip.empty() && o.speed == "max") {
    return fail(kInput, "a USB host runs in real time; leave out --speed max or --usbip");
  }
  return serve(o);
}

}  // namespace
}  // namespace celadon::sim

int main(int argc, char** argv) {
  try {
    return celadon::sim::run(argc, argv);
  } catch (const std::exception& e) {
    std::cerr << "celadon-sim: " << e.what() << "\n";
    return 4;
  }
}
