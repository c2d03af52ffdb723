// celadon device status, home and move: the axes of a machine that is looked at or set up by hand.

#include <array>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <utility>

#include <CLI/CLI.hpp>

#include "daemon/cli/commands.h"
#include "firmware_bridge/device_motion.h"
#include "firmware_bridge/device_poll.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon::cli {
namespace {

constexpr int kInputError = 2, kDeviceError = 3, kInterruptedExit = 130;
constexpr std::array kAllKinds = {AxisKind::turntable, AxisKind::elevation, AxisKind::lift};
constexpr double kDegree = std::numbers::pi / 180;

volatile std::sig_atomic_t g_signal = 0;
void note_signal(int number) {
  g_signal = number;
}

struct AxesArguments {
  std::string url, axis = "all";
  std::optional<double> table_deg, elevation_deg, lift_mm;
};

int failed(const DeviceError& error) {
  const bool usage = error.kind == DeviceError::Kind::refused && error.operation == "connect";
  const int code = error.kind == DeviceError::Kind::interrupted ? kInterruptedExit : usage ? kInputError : kDeviceError;
  return fail(code, error.message());
}

std::string travel_text(AxisKind kind, const AxisLimits& limits) {
  if (std::isinf(limits.lowest)) return "endless";
  return position_text(kind, limits.lowest) + " to " + position_text(kind, limits.highest);
}

void print_axis(AxisKind kind, const AxisStatus& s, const AxisLimits& limits) {
  const char* unit = kind == AxisKind::lift ? "mm" : "deg";
  const double in_unit = kind == AxisKind::lift ? 1 : 1 / kDegree;
  char at_most[64];
  std::snprintf(at_most, sizeof at_most, "%.4g %s/s, %.4g %s/s2", limits.max_speed * in_unit, unit,
                limits.max_acceleration * in_unit, unit);
  std::printf("%-10s %-11s %-6s %-15s %-28s %s\n", axis_name(kind), state_name(s.motion), s.homed ? "yes" : "no",
              position_text(kind, s.position).c_str(), travel_text(kind, limits).c_str(), at_most);
}

// Of a machine that may be working for another program: reads only, and gives no sign of life.
int show_status(const AxesArguments& arguments) {
  auto transport = open_transport(arguments.url);
  if (!transport) return failed(transport.error());
  MonotonicClock clock;
  DevicePoll machine(std::move(*transport), clock);
  DeviceMotion motion(machine);
  const auto lost = [&](LinkError error) { return failed(machine.failure("look at it", std::move(error))); };
  auto identity = machine.link.read_identity();
  if (!identity) return lost(std::move(identity.error()));
  auto capabilities = machine.link.read_capabilities();
  if (!capabilities) return lost(std::move(capabilities.error()));
  machine.capabilities = *capabilities;
  auto block = machine.link.watch_status();
  if (!block) return lost(std::move(block.error()));
  const DeviceStatus& s = block->status;
  std::printf("%s, protocol %u.%u%s\n", identity->machine.c_str(), unsigned{identity->protocol_major},
              unsigned{identity->protocol_minor}, identity->simulated ? ", simulated" : "");
  std::printf("interlock %s, emergency stop %s, lasers %s%s\n", s.interlock_closed ? "closed" : "open",
              s.emergency_stop ? "pressed" : "released", s.lasers_on != 0 ? "on" : "off",
              s.local_action_needed ? ", the button on the machine has to be pressed" : "");
  if (s.fault_code != 0) std::printf("fault %u: %s\n", unsigned{s.fault_code}, s.fault_text.c_str());
  std::printf("%-10s %-11s %-6s %-15s %-28s %s\n", "axis", "state", "homed", "position", "travel", "at most");
  for (const AxisKind kind : kAllKinds) {
    if (motion.has(kind)) print_axis(kind, axis_status(s, kind), motion.limits_of(kind));
  }
  return 0;
}

/// Opens the machine for this program, does it, and leaves it safe; a signal stops what moves.
template <class Do>
int with_machine(const std::string& url, Do work) {
  auto transport = open_transport(url);
  if (!transport) return failed(transport.error());
  std::signal(SIGINT, note_signal);
  std::signal(SIGTERM, note_signal);
  MonotonicClock clock;
  auto opened = ScannerDevice::open(std::move(*transport), clock);
  if (!opened) return failed(opened.error());
  ScannerDevice& device = **opened;
  device.set_interrupt([]() -> std::optional<std::string> {
    if (g_signal != 0) return "by a signal";
    return std::nullopt;
  });
  if (auto done = work(device); !done) return failed(done.error());
  const auto status = device.poll();
  if (!status) return failed(status.error());
  for (const AxisKind kind : kAllKinds) {
    if (!device.has_axis(kind)) continue;
    const AxisStatus axis = axis_status(*status, kind);
    std::printf("%-10s %-11s %s\n", axis_name(kind), state_name(axis.motion),
                position_text(kind, axis.position).c_str());
  }
  return 0;
}

int home_axes(const AxesArguments& arguments) {
  return with_machine(arguments.url, [&](ScannerDevice& device) -> tl::expected<void, DeviceError> {
    for (const AxisKind kind : kAllKinds) {
      if (arguments.axis == "all" ? !device.has_axis(kind) : arguments.axis != axis_name(kind)) continue;
      if (auto done = device.home_axis(kind); !done) return done;
    }
    return {};
  });
}

int move_axes(const AxesArguments& arguments) {
  if (!arguments.table_deg && !arguments.elevation_deg && !arguments.lift_mm)
    return fail(kInputError, "celadon device move: nothing is to be moved; give --table, --elevation or --lift");
  return with_machine(arguments.url, [&](ScannerDevice& device) -> tl::expected<void, DeviceError> {
    const std::pair<AxisKind, std::optional<double>> moves[] = {
        {AxisKind::lift, arguments.lift_mm},
        {AxisKind::elevation, arguments.elevation_deg},
        {AxisKind::turntable, arguments.table_deg},
    };
    for (const auto& [kind, to] : moves) {
      if (!to) continue;
      if (auto done = device.move_axis(kind, kind == AxisKind::lift ? *to : *to * kDegree); !done) return done;
    }
    return {};
  });
}

}  // namespace

void add_device_axes_commands(CLI::App& device, Run& run) {
  const auto arguments = std::make_shared<AxesArguments>();
  const auto add = [&](const char* name, const char* what, int (*does)(const AxesArguments&)) {
    auto* command = device.add_subcommand(name, what);
    command
        ->add_option("url", arguments->url,
                     "modbus-tcp://HOST[:PORT], modbus-rtu:/dev/TTY or usb:[VID:PID][/SERIAL], as of celadond")
        ->required();
    command->callback([arguments, does, &run] { run = [arguments, does] { return does(*arguments); }; });
    return command;
  };
  add("status", "Shows a controller's axes; reads only, also while another program works with it", show_status);
  add("home", "Finds the references of the axes, one after the other", home_axes)
      ->add_option("--axis", arguments->axis, "which")
      ->check(CLI::IsMember({"all", "table", "elevation", "lift"}))
      ->capture_default_str();
  auto* move = add("move", "Moves axes that are homed: lift, elevation, table, in this order", move_axes);
  move->add_option("--table", arguments->table_deg, "angle of the table, degrees");
  move->add_option("--elevation", arguments->elevation_deg, "angle of camera and lasers, degrees");
  move->add_option("--lift", arguments->lift_mm, "height of the table, mm");
}

}  // namespace celadon::cli
