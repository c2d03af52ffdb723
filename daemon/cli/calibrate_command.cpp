// celadon calibrate: asks for board and platter on the terminal, takes the views, writes the calibration file.

#include <poll.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>

#include "acquisition/calibrate/calibration_solver.h"
#include "acquisition/datum/rim_survey.h"
#include "daemon/calibration/calibration_session.h"
#include "daemon/cli/commands.h"
#include "daemon/config.h"
#include "daemon/files/atomic_file.h"
#include "daemon/scan_stops.h"

namespace celadon::cli {
namespace {

/// Exit codes.
enum Ending { kRefused = 1, kWrongInput = 2, kNoMachine = 3, kNotWritten = 4, kStopped = 130 };

struct Arguments {
  std::string config_file, device, camera, board = "tags:10x7x12", output;
  int views = 25, placements = 3, angles = 36, stops = 8;
  double exposure_ms = 0, width_mm = 0, height_mm = 0, measured_u_mm = 0.1;
};

std::atomic<bool> g_interrupted = false;

/// The operator at the terminal: one line for whatever is new, Enter for what is done.
class Terminal final : public CalibrationGuide {
 public:
  void ask(const std::string& instruction) override {
    say("> " + instruction + " Then press Enter, or the button on the machine.");
  }
  bool done() override {
    pollfd input{closed_ ? -1 : STDIN_FILENO, POLLIN, 0};  // without a terminal the button is left
    if (::poll(&input, 1, 50) <= 0) return false;
    char line[256];
    const ssize_t count = ::read(STDIN_FILENO, line, sizeof line);
    closed_ = count <= 0;
    return !closed_;
  }
  void on_look(const BoardLook& look) override {
    std::string text = !look.found  ? "no board: " + look.problem
                       : look.known ? "board seen, a view like this was taken already"
                       : look.still ? "view taken"
                                    : "board seen, hold it still";
    text += " (" + std::to_string(look.views) + " of " + std::to_string(look.wanted) + " views)";
    if (!look.advice.empty()) text += ". " + look.advice;
    if (text != last_) say(text);
    last_ = text;
  }
  void on_turn(int placement, int angle, int angles, bool found) override {
    seen_ += found ? 1 : 0;
    if (angle < angles) return;
    say("placement " + std::to_string(placement + 1) + ": the board was seen at " + std::to_string(seen_) + " of " +
        std::to_string(angles) + " angles");
    seen_ = 0;
  }
  void on_passes(int placement, int frames) override {
    say("placement " + std::to_string(placement + 1) + ": the board was seen in " + std::to_string(frames) +
        " frames while the table turned");
  }
  void on_stop(int, const AxisStop& stop, bool found) override {
    say(text_of(stop) + (found ? ": the board was seen" : ": the board was not seen"));
  }
  std::optional<std::string> cancelled() override {
    if (g_interrupted) return "by a signal";
    return std::nullopt;
  }

 private:
  static void say(const std::string& text) {
    std::printf("%s\n", text.c_str());
    std::fflush(stdout);
  }
  std::string last_;
  int seen_ = 0;
  bool closed_ = false;
};

const char* word(Verdict verdict) {
  return verdict == Verdict::good ? "good" : verdict == Verdict::usable ? "usable" : "refused";
}

std::string now_utc() {
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  ::gmtime_r(&now, &utc);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &utc);
  return text;
}

Measured pitch(double measured_mm, double nominal_mm, double u_mm) {
  if (measured_mm == 0) return {1, 0.003};
  return {measured_mm / nominal_mm, u_mm / nominal_mm};
}

std::string rim_text(const std::vector<RimTag>& tags) {
  if (tags.size() < 3) {
    return "of the platter's fiducials " + std::to_string(tags.size()) +
           " were seen well at three angles or more: scans will not watch them; light the platter and free its rim.";
  }
  double u = 0;
  for (const RimTag& tag : tags) u = std::max(u, tag.u_mm);
  char text[120];
  std::snprintf(text, sizeof text, "%zu fiducials on the platter, each known to %.3f mm.", tags.size(), u);
  return text;
}

int calibrate(const Arguments& a) {
  if (std::filesystem::exists(a.output)) {
    return fail(kWrongInput, a.output + " exists; name another file, or move it away");
  }
  const auto board = TargetBoard::parse(a.board);
  if (!board) return fail(kWrongInput, "--board " + a.board + ": " + board.error());
  Config config;
  if (!a.config_file.empty()) {
    if (auto read = read_config(a.config_file, config); !read) return fail(kWrongInput, read.error().message);
  }
  if (!a.device.empty()) config.device = a.device;
  if (!a.camera.empty()) config.camera = a.camera;
  if (config.device.empty() || config.camera.empty()) {
    return fail(kWrongInput, "a calibration needs a machine and its camera: give --device and --camera, or --config");
  }
  const double width_mm = board->columns() * board->square_mm(), height_mm = board->rows() * board->square_mm();
  const auto plausible = [](double measured, double nominal) {
    return measured == 0 || std::abs(measured / nominal - 1) < 0.05;
  };
  if (!plausible(a.width_mm, width_mm) || !plausible(a.height_mm, height_mm)) {
    char text[160];
    std::snprintf(text, sizeof text, "the print measures %g x %g mm, but %s should be %g x %g mm; name the right board",
                  a.width_mm, a.height_mm, a.board.c_str(), width_mm, height_mm);
    return fail(kWrongInput, text);
  }
  auto machine = open_scanner(config.device, config.camera, config.drive, config.motion);
  if (!machine) return fail(machine.error().wrong_configuration ? kWrongInput : kNoMachine, machine.error().message);

  const CalibrationPlan plan{*board,
                             a.views,
                             a.placements,
                             a.angles,
                             a.exposure_ms,
                             pitch(a.width_mm, width_mm, a.measured_u_mm),
                             pitch(a.height_mm, height_mm, a.measured_u_mm),
                             a.stops};
  Terminal terminal;
  const auto interrupt = [](int) { g_interrupted = true; };
  std::signal(SIGINT, interrupt);
  std::signal(SIGTERM, interrupt);
  auto input = take_calibration_views(*machine, plan, terminal);
  if (!input) {
    return fail(g_interrupted                                 ? kStopped
                : input.error().state == ScanState::cancelled ? kRefused
                                                              : kNoMachine,
                input.error().reason);
  }
  std::printf("%zu views taken; solving ...\n", input->views.size());
  std::fflush(stdout);
  auto solved = solve_calibration(*input);
  if (!solved) return fail(kRefused, "no calibration: " + solved.error());
  for (const CalibrationStep& step : solved->steps) {
    std::printf("%-10s %-8s %s%s%s\n", step.name.c_str(), word(step.verdict), step.finding.c_str(),
                step.remedy.empty() ? "" : " ", step.remedy.c_str());
  }
  if (solved->verdict == Verdict::refused) {
    return fail(kRefused,
                "the calibration is refused, and nothing was written: follow what stands beside the steps above");
  }
  Calibration& c = solved->calibration;
  c.machine = machine->device->identity().machine;
  c.camera = machine->camera->mode().identity;
  c.date = now_utc();
  c.simulated = is_simulated(*machine);
  c.rim_tags = survey_rim(c, input->rim);
  if (!input->rim.empty()) {
    std::printf("%-10s %-8s %s\n", "datum", word(c.rim_tags.size() < 3 ? Verdict::refused : Verdict::good),
                rim_text(c.rim_tags).c_str());
  }
  if (auto written = write_file_atomically(a.output, format_calibration(c)); !written) {
    return fail(kNotWritten, written.error().message);
  }
  std::printf("calibration: %s (%s)\n", a.output.c_str(), word(solved->verdict));
  return 0;
}

}  // namespace

void add_calibrate_command(CLI::App& program, Run& run) {
  auto a = std::make_shared<Arguments>();
  auto* c = program.add_subcommand(
      "calibrate",
      "Calibrates camera, lasers, axis and encoder, and elevation and lift where there are such, of "
      "a machine with a printed board: asks for what has to be done by hand, and writes one "
      "file. No daemon may hold the machine.");
  c->add_option("--config", a->config_file, "configuration of the daemon: its machine and camera");
  c->add_option("--device", a->device, "modbus-tcp://HOST[:PORT], modbus-rtu:/dev/TTY or usb:[VID:PID]");
  c->add_option("--camera", a->camera, "v4l2:/dev/videoN or sim:FOLDER");
  c->add_option("--board", a->board, "the printed board, as `celadon board` printed it")->capture_default_str();
  c->add_option("--width", a->width_mm, "measured over all its squares from left to right, mm; without: 0.3 % unsure");
  c->add_option("--height", a->height_mm, "the same from top to bottom, mm");
  c->add_option("--measured-u", a->measured_u_mm, "standard uncertainty of both, mm")
      ->check(CLI::Range(1e-4, 10.))
      ->capture_default_str();
  c->add_option("--views", a->views, "views of the board held by hand")
      ->check(CLI::Range(5, 200))
      ->capture_default_str();
  c->add_option("--placements", a->placements, "of the board on the platter")
      ->check(CLI::Range(1, 12))
      ->capture_default_str();
  c->add_option("--angles", a->angles, "of the table, a turn")->check(CLI::Range(8, 360))->capture_default_str();
  c->add_option("--stops", a->stops,
                "of the head's elevation and of the lift, where there are such, for each placement; 0: they are not "
                "calibrated")
      ->check(CLI::Range(0, 100))
      ->capture_default_str();
  c->add_option("--exposure", a->exposure_ms, "of each frame, ms; without: as the camera stands");
  c->add_option("-o,--output", a->output, "calibration file")->required();
  c->callback([a, &run] { run = [a] { return calibrate(*a); }; });
}

}  // namespace celadon::cli
