// celadon setup: from a machine out of its box to its first scan, question by question. What it does is what other
// commands do; it shows them.

#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cctype>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "acquisition/calibration.h"
#include "acquisition/v4l2_devices.h"
#include "daemon/calibration/first_look.h"
#include "daemon/cli/commands.h"
#include "daemon/cli/virtual_scanner.h"
#include "daemon/files/atomic_file.h"

namespace celadon::cli {
namespace {

namespace fs = std::filesystem;

/// Exit codes.
enum SetupEnding { kNotFit = 1, kNoAnswer = 2, kNotKept = 4, kInterrupted = 130 };

constexpr double kTurn_rad = 30 * std::numbers::pi / 180;

struct SetupArguments {
  std::string device, camera, folder = "celadon-machine";
};

constexpr int kLook_ms = 50;  // how often a signal is looked for: one that comes just before a call would not end it

std::atomic<int> g_stopped = 0;  ///< the signal that asked for it

/// Nobody answers any more, or asked to stop.
struct Ended {
  int exit_code;
};

void say(const std::string& text) {
  std::printf("%s\n", text.c_str());
  std::fflush(stdout);
}

/// One line from the operator, without its blanks. Byte by byte: the next ones may be meant for another program.
std::string answer_to(const std::string& question) {
  std::printf("? %s ", question.c_str());
  std::fflush(stdout);
  std::string line;
  while (true) {
    if (g_stopped) throw Ended{kInterrupted};
    pollfd input{STDIN_FILENO, POLLIN, 0};
    if (::poll(&input, 1, kLook_ms) <= 0) continue;
    char c = 0;
    const ssize_t count = ::read(STDIN_FILENO, &c, 1);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) throw Ended{fail(kNoAnswer, "the answers have ended before the questions; run it in a terminal")};
    if (c == '\n') break;
    if (std::isspace(static_cast<unsigned char>(c)) == 0 || !line.empty()) line += c;
  }
  while (!line.empty() && std::isspace(static_cast<unsigned char>(line.back())) != 0) line.pop_back();
  return line;
}

bool yes(const std::string& question) {
  while (true) {
    const std::string given = answer_to(question + " [y/n]");
    if (given == "y" || given == "yes") return true;
    if (given == "n" || given == "no") return false;
    say("  Answer y or n.");
  }
}

std::string answer_or(const std::string& question, const std::string& otherwise) {
  const std::string given = answer_to(question + " [" + otherwise + "]");
  return given.empty() ? otherwise : given;
}

/// Runs another command of this program at the same terminal, and shows it. @returns its exit code
int run_celadon(const std::vector<std::string>& words) {
  std::string shown;
  for (const std::string& word : words) shown += " " + word;
  say("$ celadon" + shown);
  std::vector<std::string> command{program_beside("celadon")};
  command.insert(command.end(), words.begin(), words.end());
  std::vector<char*> arguments;
  for (std::string& word : command) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  const pid_t child = ::fork();
  if (child == 0) {
    ::execvp(arguments[0], arguments.data());
    ::dprintf(STDERR_FILENO, "celadon: %s cannot be run: %s\n", arguments[0], std::strerror(errno));
    ::_exit(127);
  }
  int status = -1;
  bool told = false;
  while (child > 0 && ::waitpid(child, &status, WNOHANG) == 0) {
    ::poll(nullptr, 0, kLook_ms);
    if (told || g_stopped != SIGTERM) continue;  // a terminal's Ctrl-C reaches it by itself
    ::kill(child, SIGTERM);
    told = true;
  }
  if (g_stopped) throw Ended{kInterrupted};
  return child > 0 && WIFEXITED(status) ? WEXITSTATUS(status) : kNotKept;
}

class Observer final : public ScanObserver {
 public:
  void on_state(ScanState) override {}
  void on_progress(const ScanProgress&) override {}
  void on_status(const DeviceStatus&) override {}
  std::optional<std::string> cancelled() override {
    if (g_stopped) return "by a signal";
    return std::nullopt;
  }
};

/// Tries until it works or the operator has enough of it.
template <class Try>
auto until_it_works(Try attempt) {
  while (true) {
    auto result = attempt();
    if (result) return std::move(*result);
    if (g_stopped) throw Ended{kInterrupted};
    say("  " + result.error());
    if (!yes("Try again?")) throw Ended{kNotFit};
  }
}

std::string ask_for_camera() {
  std::vector<V4l2Device> usable;
  for (V4l2Device& device : list_v4l2_devices()) {
    if (device.problem.empty() && preferred_format(device) != nullptr)
      usable.push_back(std::move(device));
    else if (!device.problem.empty())
      say("  " + device.path + ": " + device.problem);
  }
  for (std::size_t k = 0; k < usable.size(); ++k)
    say("  " + std::to_string(k + 1) + "  " + usable[k].path + "  " + usable[k].name + " " + usable[k].serial);
  if (usable.empty()) say("  This computer has no camera that could be used; plug it in, or name one by its address.");
  while (true) {
    const std::string given = answer_to("Which camera? Its number, or v4l2:/dev/videoN or v4l2:serial=NUMBER:");
    const auto number = static_cast<std::size_t>(std::strtoul(given.c_str(), nullptr, 10));
    if (number >= 1 && number <= usable.size()) return address_of(usable[number - 1], usable);
    if (given.find(':') != std::string::npos) return given;
    say("  '" + given + "' is neither a number from above nor an address.");
  }
}

struct Machine {
  std::string device, camera;
  ScannerConnection connection;
};

Machine connect(const SetupArguments& a) {
  say("1. Camera");
  std::string camera = a.camera.empty() ? ask_for_camera() : a.camera;
  say("2. Controller");
  std::string device = a.device;
  Machine machine;
  machine.connection = until_it_works([&]() -> tl::expected<ScannerConnection, std::string> {
    if (device.empty()) device = answer_to("Its address? modbus-tcp://HOST[:PORT], modbus-rtu:/dev/TTY or usb: :");
    auto opened = open_scanner(device, camera);
    if (opened) return std::move(*opened);
    // A wrong address is asked for again.
    if (a.device.empty()) device.clear();
    if (a.camera.empty() && opened.error().message.find(camera) != std::string::npos) camera = ask_for_camera();
    return tl::unexpected(opened.error().message);
  });
  machine.device = device;
  machine.camera = camera;
  const DeviceCapabilities& can = machine.connection.device->capabilities();
  say("  " + machine.connection.device->identity().machine + ", " + std::to_string(can.lasers) + " laser" +
      (can.lasers == 1 ? "" : "s") + (can.elevation ? ", elevation axis" : "") + (can.lift ? ", lift" : "") + "; " +
      machine.connection.camera->mode().identity);
  return machine;
}

void test(ScannerConnection& machine, Observer& observer) {
  say("3. Safety and home");
  answer_to("Take everything off the table, close the cover, and press Enter. Lasers and table are tried now.");
  say("  " + until_it_works([&]() -> tl::expected<std::string, std::string> {
        auto tested = test_unmeasured(machine, observer);
        if (!tested) return tl::unexpected(tested.error().reason);
        return *tested;
      }));
}

void look(ScannerConnection& machine, Observer& observer) {
  say("4. Lasers");
  answer_to("Stand something bright and not shiny on the middle of the table, and press Enter.");
  until_it_works([&]() -> tl::expected<bool, std::string> {
    auto looks = look_at_lasers(machine, observer);
    if (!looks) return tl::unexpected(looks.error().reason);
    std::string trouble;
    for (const LaserLook& laser : *looks) {
      char text[160];
      std::snprintf(text, sizeof text, "  laser %d: a line in %d of %d rows, %.0f grey levels, %d rows saturated",
                    laser.laser, laser.lines, laser.of, laser.amplitude, laser.saturated);
      say(text);
      if (5 * laser.lines < laser.of)
        trouble += "The line of laser " + std::to_string(laser.laser) +
                   " is seen in less than a fifth of the picture: see that it shines on the object, that the camera "
                   "looks there and is sharp, and that the room is not too bright. ";
      else if (5 * laser.saturated > laser.lines)
        trouble += "The line of laser " + std::to_string(laser.laser) +
                   " is too bright: shorten the camera's exposure, or close its iris a little. ";
    }
    if (!trouble.empty()) return tl::unexpected(trouble);
    return true;
  });
}

/// +1: counter-clockwise for rising angles.
int ask_direction(ScannerConnection& machine, Observer& observer) {
  say("5. Direction of rotation");
  answer_to("Watch the table from above, and press Enter: it turns by 30 degrees.");
  while (true) {
    until_it_works([&]() -> tl::expected<bool, std::string> {
      auto turned = turn_by(kTurn_rad, machine, observer);
      if (!turned) return tl::unexpected(turned.error().reason);
      return true;
    });
    const std::string seen =
        answer_to("Did it turn counter-clockwise (ccw), clockwise (cw), or shall it again (again)?");
    if (seen == "ccw") return 1;
    if (seen == "cw") return -1;
  }
}

/// @returns whether there is one that shall stay
bool keeps_calibration(const fs::path& file) {
  if (!fs::exists(file)) return false;
  if (yes("There is a calibration: " + file.string() + ". Keep it?")) return true;
  const fs::path before = file.string() + ".before";
  std::error_code error;
  fs::rename(file, before, error);
  if (error) throw Ended{fail(kNotKept, file.string() + " cannot be renamed: " + error.message())};
  say("  The old one is now " + before.string() + ".");
  return false;
}

void calibrate(const Machine& machine, const fs::path& file, int direction) {
  say("6. Calibration");
  bool calibrated = keeps_calibration(file);
  while (!calibrated) {
    const std::string board = answer_or("Which board? As `celadon board` printed it:", "tags:10x7x12");
    const std::string width = answer_or("Its width over all squares, measured, in mm (0: not measured)?", "0");
    const std::string height = answer_or("Its height?", "0");
    calibrated = run_celadon({"calibrate", "--device", machine.device, "--camera", machine.camera, "--board", board,
                              "--width", width, "--height", height, "-o", file.string()}) == 0;
    if (!calibrated && !yes("Try again?")) throw Ended{kNotFit};
  }
  const auto calibration = read_calibration(file);
  if (!calibration) throw Ended{fail(kNotFit, calibration.error().message)};
  if (calibration->encoder.direction * direction > 0) return;
  throw Ended{
      fail(kNotFit,
           "by the calibration the table turns the other way than was seen: the camera's picture is mirrored (a "
           "mirror, or a flip that is set in the camera); undo that, delete " +
               file.string() + ", and set up again")};
}

std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) out += c == '"' || c == '\\' ? std::string("\\") + c : std::string(1, c);
  return out + "\"";
}

fs::path write_config(const Machine& machine, const fs::path& folder) {
  const fs::path file = folder / "celadond.toml";
  const std::string text = "device = " + quoted(machine.device) + "\ncamera = " + quoted(machine.camera) +
                           "\ncalibration = " + quoted((folder / "scanner.toml").string()) +
                           "\nstore = " + quoted((folder / "store").string()) + "\n";
  if (auto written = write_file_atomically(file, text); !written) throw Ended{fail(kNotKept, written.error().message)};
  return file;
}

void scan(const fs::path& config, const fs::path& folder) {
  say("7. Check and first scan");
  const std::string socket = (folder / "setup.sock").string();
  ChildProcess daemon;
  const auto serving =
      daemon.start({program_beside("celadond"), "--config", config.string(), "--http", "0", "--unix-socket", socket},
                   folder / "setup.log");
  if (!serving) throw Ended{fail(kNotFit, serving.error())};
  const std::string server = "unix:" + socket;
  const std::string reference =
      answer_to("A cylinder or sphere of known size (cylinder:D=60,u=0.002)? Put it on the table; Enter alone: none.");
  if (!reference.empty()) {
    run_celadon({"check", "--server", server, "--reference", reference, "-o", (folder / "check").string()});
  }
  while (true) {
    answer_to("Stand an object on the table for the first scan, and press Enter.");
    if (run_celadon({"scan", "--server", server, "-o", (folder / "first-scan").string()}) == 0) break;
    if (!yes("Try again?")) throw Ended{kNotFit};
  }
}

int set_up(const SetupArguments& a) {
  std::error_code error;
  fs::create_directories(a.folder, error);
  if (error) return fail(kNotKept, "the folder " + a.folder + " cannot be made: " + error.message());
  const fs::path folder = fs::absolute(a.folder, error);
  struct sigaction stop {};
  stop.sa_handler = [](int number) { g_stopped = number; };
  ::sigaction(SIGINT, &stop, nullptr);
  ::sigaction(SIGTERM, &stop, nullptr);
  try {
    Observer observer;
    Machine machine = connect(a);
    test(machine.connection, observer);
    look(machine.connection, observer);
    const int direction = ask_direction(machine.connection, observer);
    // Other programs own it from here on.
    machine.connection.device.reset();
    machine.connection.camera.reset();
    calibrate(machine, folder / "scanner.toml", direction);
    const fs::path config = write_config(machine, folder);
    scan(config, folder);
    say("Done. From now on: celadond --config " + config.string());
    return 0;
  } catch (const Ended& ended) {
    return ended.exit_code;
  }
}

}  // namespace

void add_setup_command(CLI::App& program, Run& run) {
  auto a = std::make_shared<SetupArguments>();
  auto* c = program.add_subcommand(
      "setup",
      "Sets a machine up, question by question: camera, controller, lasers, direction of rotation, calibration, check, "
      "first scan. Leaves the daemon's configuration and the calibration in a folder. No daemon may hold the machine.");
  c->option_defaults()->always_capture_default();
  c->add_option("--device", a->device,
                "modbus-tcp://HOST[:PORT], modbus-rtu:/dev/TTY or usb:[VID:PID]; else it is asked");
  c->add_option("--camera", a->camera, "v4l2:/dev/videoN, v4l2:serial=NUMBER or sim:FOLDER; else it is asked");
  c->add_option("-o,--output", a->folder, "folder of the machine's files");
  c->callback([a, &run] { run = [a] { return set_up(*a); }; });
}

}  // namespace celadon::cli
