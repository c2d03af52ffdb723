#include "daemon/drive_profile_reader.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <optional>
#include <utility>

#include "daemon/profile_file.h"

namespace celadon {
namespace {

namespace fs = std::filesystem;
using checked_toml::excerpt;
using checked_toml::Refusal;
using checked_toml::Section;

constexpr std::size_t kLargestProfile = std::size_t{1} << 18;
constexpr std::size_t kMostAlarms = 256, kMostSettings = 32, kLongestSetting = 200;
constexpr double kMostSteps = 1e9;

bool writes(const DriveAction& action, DriveWrite::What what) {
  return std::any_of(action.begin(), action.end(), [what](const DriveWrite& w) { return w.what == what; });
}

DriveAction wanted_action(const ProfileFile& file, Section& actions, const std::string& key) {
  actions.node(key);  // refuses where there is none
  DriveAction action = file.action(actions, key);
  if (action.empty()) actions.refuse(actions.node(key), key, "is empty; say what it writes");
  return action;
}

FaultCode fault_of(Section& section) {
  if (!section.has("fault")) return FaultCode::drive_fault;
  const std::string name = section.text("fault");
  for (const protocol::Code& code : protocol::kFaultCodes) {
    if (name == code.name && code.value >= 16) return static_cast<FaultCode>(code.value);
  }
  section.refuse(section.node("fault"), "fault",
                 "is " + excerpt(name) + " and must be a fault of PROTOCOL.md, section 6, from code 16 on");
}

DriveProfile drive_of(const toml::table& table, const std::string& name) {
  ProfileFile file(table, name, "celadon-drive");
  Section& root = file.root();
  DriveProfile p;
  p.name = file.text(root, "name");
  p.vendor = file.text(root, "vendor");
  p.model = file.text(root, "model");
  p.word_order = file.word_order();
  p.steps_per_turn = root.number("steps_per_turn");
  if (!(p.steps_per_turn > 0 && p.steps_per_turn <= kMostSteps))
    root.refuse(root.node("steps_per_turn"), "steps_per_turn", "must be above 0 and at most 1e9");
  if (const std::string stamp = root.text("time_stamp"); stamp != "host")
    root.refuse(
        root.node("time_stamp"), "time_stamp",
        "is " + excerpt(stamp) + " and must be \"host\": this version knows no drive that stamps its positions");
  const std::string loop = root.text("loop");
  if (loop != "open" && loop != "closed")
    root.refuse(root.node("loop"), "loop", "is " + excerpt(loop) + " and must be \"open\" or \"closed\"");
  p.closed_loop = loop == "closed";
  p.has_index = root.boolean("index");
  if (root.has("crc_exception")) p.crc_exception = root.integer("crc_exception", 1, 11);
  if (root.has("settings")) {
    const auto* list = root.node("settings").as_array();
    if (list == nullptr || list->size() > kMostSettings)
      root.refuse(root.node("settings"), "settings", "must be an array of at most 32 texts");
    for (const toml::node& entry : *list) {
      const auto* text = entry.as_string();
      if (text == nullptr || text->get().size() > kLongestSetting)
        root.refuse(entry, "settings", "must be an array of texts of at most 200 characters");
      p.settings.push_back(text->get());
    }
  }
  p.registers = file.registers();
  p.host_watchdog = file.host_watchdog();

  Section state = root.section("state");
  p.position = file.index(state, "position");
  p.speed = file.index(state, "speed");
  p.alarm = file.index(state, "alarm");
  if (p.registers[p.position].unit != DriveUnit::step)
    state.refuse(state.node("position"), "position", "must be a register whose unit is step");
  if (!is_speed(p.registers[p.speed].unit))
    state.refuse(state.node("speed"), "speed", "must be a register whose unit is step/s or rpm");
  if (p.registers[p.alarm].unit != DriveUnit::none)
    state.refuse(state.node("alarm"), "alarm", "must be a register without a unit");
  p.fault = file.condition(state, "fault");
  p.moving = file.condition(state, "moving");
  p.homed = file.condition(state, "homed");
  p.ready = file.maybe(state, "ready");
  p.enabled = file.maybe(state, "enabled");
  p.in_position = file.maybe(state, "in_position");
  state.finish();

  Section actions = root.section("actions");
  p.enable = file.action(actions, "enable");
  p.release = file.action(actions, "release");
  p.reset = file.action(actions, "reset");
  p.mark = file.action(actions, "mark");
  p.home = p.has_index || actions.has("home") ? wanted_action(file, actions, "home") : DriveAction{};
  p.move = wanted_action(file, actions, "move");
  p.stop = wanted_action(file, actions, "stop");
  for (const DriveWrite::What what :
       {DriveWrite::What::target, DriveWrite::What::speed, DriveWrite::What::acceleration}) {
    if (!writes(p.move, what))
      actions.refuse(actions.node("move"), "move", "must write target, speed and acceleration");
  }
  actions.finish();

  if (root.has("alarms")) {
    file.each(root, "alarms", kMostAlarms, [&](Section& section) {
      const auto code = static_cast<std::uint32_t>(section.whole("code", 1, 0xFFFF));
      p.alarms.push_back({code, file.text(section, "text"), fault_of(section)});
    });
  }
  root.finish();
  return p;
}

std::uint32_t output_mask(Section& section, const std::string& key, const DriveRegister& outputs) {
  return static_cast<std::uint32_t>(section.whole(key, 1, outputs.words == 1 ? 0xFFFF : 0xFFFFFFFF));
}

IoProfile io_of(const toml::table& table, const std::string& name) {
  ProfileFile file(table, name, "celadon-io");
  Section& root = file.root();
  IoProfile p;
  p.name = file.text(root, "name");
  p.word_order = file.word_order();
  p.laser_class = static_cast<std::uint16_t>(root.integer("laser_class", protocol::kClass1, protocol::kClass3R));
  p.registers = file.registers();
  p.host_watchdog = file.host_watchdog();

  Section inputs = root.section("inputs");
  p.interlock_closed = file.condition(inputs, "interlock_closed");
  p.emergency_stop = file.condition(inputs, "emergency_stop");
  p.button = file.condition(inputs, "button");
  p.remote_enabled = file.maybe(inputs, "remote_enabled");
  if (inputs.has("laser_emits")) {
    file.each(inputs, "laser_emits", protocol::kMaxLasers,
              [&](Section& section) { p.laser_emits.push_back(file.condition_of(section)); });
  }
  inputs.finish();

  Section outputs = root.section("outputs");
  p.outputs = file.index(outputs, "register");
  const DriveRegister& r = p.registers[p.outputs];
  if (r.area != protocol::Area::holding || r.unit != DriveUnit::none || r.is_signed)
    outputs.refuse(outputs.node("register"), "register", "must be an unsigned holding register without a unit");
  file.each(outputs, "lasers", protocol::kMaxLasers,
            [&](Section& section) { p.lasers.push_back(output_mask(section, "mask", r)); });
  if (p.lasers.empty()) outputs.refuse(outputs.node("lasers"), "lasers", "must name the output of one laser at least");
  if (outputs.has("motor_enable")) p.motor_enable = output_mask(outputs, "motor_enable", r);
  if (outputs.has("lamp")) p.lamp = output_mask(outputs, "lamp", r);
  outputs.finish();
  std::uint32_t used = p.motor_enable;
  bool twice = (p.lamp & used) != 0;
  used |= p.lamp;
  for (const std::uint32_t mask : p.lasers) {
    twice = twice || (mask & used) != 0;
    used |= mask;
  }
  if (twice) root.refuse(root.node("outputs"), "outputs", "gives one output to two things");
  if (!p.laser_emits.empty() && p.laser_emits.size() != p.lasers.size())
    root.refuse(root.node("inputs"), "inputs", "must name laser_emits for each laser or for none");
  root.finish();
  return p;
}

template <class Profile>
tl::expected<Profile, std::string> parse(const std::string& text, const std::string& name,
                                         Profile (*of)(const toml::table&, const std::string&)) {
  if (text.size() > kLargestProfile)
    return tl::unexpected(name + " is longer than 256 KiB and cannot be a profile; give the right file");
  const auto parsed = checked_toml::parse_ascii(text);
  if (!parsed) return tl::unexpected(name + ", " + parsed.error());
  try {
    return of(*parsed, name);
  } catch (const Refusal& refusal) {
    return tl::unexpected(refusal.message);
  }
}

tl::expected<std::string, std::string> text_of(fs::path path) {
  const bool is_name = !path.has_parent_path() && path.extension() != ".toml";
  if (is_name) path = profile_folder() / (path.string() + ".toml");
  std::ifstream in(path, std::ios::binary);
  if (!in) {
    const int cause = errno;
    return tl::unexpected("the profile " + path.string() + " cannot be opened: " + std::strerror(cause) +
                          "; give a file, or the name of one of the profiles in " + profile_folder().string());
  }
  std::string text(kLargestProfile + 1, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  if (in.bad()) return tl::unexpected("the profile " + path.string() + " cannot be read; copy the file again");
  return text;
}

}  // namespace

tl::expected<DriveProfile, std::string> parse_drive_profile(const std::string& text, const std::string& name) {
  return parse<DriveProfile>(text, name, drive_of);
}

tl::expected<IoProfile, std::string> parse_io_profile(const std::string& text, const std::string& name) {
  return parse<IoProfile>(text, name, io_of);
}

tl::expected<DriveProfile, std::string> read_drive_profile(const std::string& name_or_path) {
  return text_of(name_or_path).and_then([&](const std::string& text) {
    return parse_drive_profile(text, name_or_path);
  });
}

tl::expected<IoProfile, std::string> read_io_profile(const std::string& name_or_path) {
  return text_of(name_or_path).and_then([&](const std::string& text) { return parse_io_profile(text, name_or_path); });
}

fs::path profile_folder() {
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  return self.parent_path().parent_path() / "share" / "celadon" / "profiles";
}

}  // namespace celadon
