// celadon device probe: what the registers of a drive or an I/O device say, decoded by its profile. Reads only.

#include <cmath>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "daemon/cli/commands.h"
#include "daemon/drive_profile_reader.h"
#include "firmware_bridge/transport.h"

namespace celadon::cli {
namespace {

constexpr int kDevice = 3, kInput = 2;

struct ProbeArguments {
  std::string url, profile;
};

/// What drives and I/O devices have in common here.
struct Map {
  std::string name;
  WordOrder word_order = WordOrder::high_first;
  double steps_per_turn = 1;
  std::vector<DriveRegister> registers;
};

/// Reads one register into its words.
tl::expected<std::vector<std::uint16_t>, LinkError> read(Transport& transport, const DriveRegister& r) {
  std::vector<std::uint16_t> words(static_cast<std::size_t>(r.words));
  auto done = r.area == protocol::Area::input ? transport.read_inputs(r.address, words)
                                              : transport.read_holding(r.address, words);
  if (!done) return tl::make_unexpected(done.error());
  return words;
}

std::string value_text(const Map& map, const DriveRegister& r, std::int64_t count) {
  char text[64];
  const double quantity = quantity_of(r, count, map.steps_per_turn);
  if (r.unit == DriveUnit::none) {
    std::snprintf(text, sizeof text, "%lld", static_cast<long long>(count));
  } else if (r.unit == DriveUnit::rpm || r.unit == DriveUnit::ms_per_1000rpm) {
    std::snprintf(text, sizeof text, "%g %s = %g %s", static_cast<double>(count) * r.scale, unit_name(r.unit), quantity,
                  r.unit == DriveUnit::rpm ? "step/s" : "step/s2");
  } else {
    std::snprintf(text, sizeof text, "%g %s", quantity, unit_name(r.unit));
  }
  return text;
}

void print_state(const DriveProfile& p, const std::vector<std::int64_t>& counts, const std::vector<bool>& known) {
  const auto show = [&](const char* name, const DriveCondition& c) {
    if (!known[c.reg]) return;
    const bool holds = (static_cast<std::uint32_t>(counts[c.reg]) & c.mask) == c.value;
    std::printf("  %-12s %s\n", name, holds ? "yes" : "no");
  };
  std::printf("state\n");
  show("fault", p.fault);
  show("moving", p.moving);
  show("homed", p.homed);
  if (p.ready) show("ready", *p.ready);
  if (p.enabled) show("enabled", *p.enabled);
  if (p.in_position) show("in position", *p.in_position);
  if (known[p.alarm] && counts[p.alarm] != 0) {
    std::string text = "not in the profile";
    for (const DriveAlarm& alarm : p.alarms) {
      if (std::int64_t{alarm.code} == counts[p.alarm]) text = alarm.text;
    }
    std::printf("  alarm        0x%02llX: %s\n", static_cast<unsigned long long>(counts[p.alarm]), text.c_str());
  }
  std::printf("to be set with the maker's tool\n");
  for (const std::string& setting : p.settings) std::printf("  %s\n", setting.c_str());
}

int probe(const ProbeArguments& arguments) {
  auto drive = read_drive_profile(arguments.profile);
  auto io = drive ? tl::expected<IoProfile, std::string>() : read_io_profile(arguments.profile);
  if (!drive && !io) return fail(kInput, drive.error());
  const Map map = drive ? Map{drive->name, drive->word_order, drive->steps_per_turn, drive->registers}
                        : Map{io->name, io->word_order, 1, io->registers};
  auto transport = open_transport(arguments.url);
  if (!transport) {
    return fail(transport.error().kind == DeviceError::Kind::refused ? kInput : kDevice, transport.error().message());
  }
  std::printf("%s at %s\n%-22s %-7s %-11s %-38s %s\n", map.name.c_str(), arguments.url.c_str(), "register", "address",
              "words", "value", "source");
  std::vector<std::int64_t> counts(map.registers.size());
  std::vector<bool> known(map.registers.size());
  std::size_t answered = 0;
  std::string last_cause;
  for (std::size_t i = 0; i < map.registers.size(); ++i) {
    const DriveRegister& r = map.registers[i];
    const auto words = read(**transport, r);
    std::string raw, value;
    if (words) {
      counts[i] = get_count(r, map.word_order, *words);
      known[i] = true;
      ++answered;
      for (const std::uint16_t word : *words) {
        char hex[8];
        std::snprintf(hex, sizeof hex, "%04X ", unsigned{word});
        raw += hex;
      }
      value = value_text(map, r, counts[i]);
    } else {
      last_cause = value = words.error().cause;
    }
    std::printf("%-22s 0x%04X  %-11s %-38s %s%s\n", r.name.c_str(), unsigned{r.address}, raw.c_str(), value.c_str(),
                r.source.c_str(), r.confirmed ? "" : " (NOT CONFIRMED)");
  }
  if (answered == 0)
    return fail(kDevice, "no register of " + map.name + " was answered at " + arguments.url + ": " + last_cause +
                             "; check cable, power, unit number and serial settings");
  if (drive) print_state(*drive, counts, known);
  return 0;
}

}  // namespace

void add_device_command(CLI::App& program, Run& run) {
  auto* device = program.add_subcommand("device", "Looks at a device, or moves its axes");
  device->require_subcommand(1);
  add_device_axes_commands(*device, run);
  auto* command = device->add_subcommand("probe", "Reads the registers of a drive or an I/O device by its profile");
  const auto arguments = std::make_shared<ProbeArguments>();
  command->add_option("url", arguments->url, "modbus-tcp://HOST[:PORT][?unit=N] or modbus-rtu:/dev/TTY[?baud=N&..]")
      ->required();
  command->add_option("--profile", arguments->profile, "a file, or a name: oriental-motor-az, leadshine-rs")
      ->required();
  command->callback([arguments, &run] { run = [arguments] { return probe(*arguments); }; });
}

}  // namespace celadon::cli
