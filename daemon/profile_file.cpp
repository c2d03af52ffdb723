#include "daemon/profile_file.h"

#include <algorithm>
#include <array>

namespace celadon {
namespace {

using checked_toml::excerpt;

constexpr std::size_t kMostRegisters = 64, kMostWrites = 32, kLongestWord = 200;
constexpr double kLargestScale = 1e9;
constexpr std::array kUnits = {DriveUnit::none,        DriveUnit::step,           DriveUnit::step_per_s, DriveUnit::rpm,
                               DriveUnit::step_per_s2, DriveUnit::ms_per_1000rpm, DriveUnit::ms};

bool is_acceleration(DriveUnit unit) {
  return unit == DriveUnit::step_per_s2 || unit == DriveUnit::ms_per_1000rpm;
}

}  // namespace

bool is_speed(DriveUnit unit) {
  return unit == DriveUnit::step_per_s || unit == DriveUnit::rpm;
}

ProfileFile::ProfileFile(const toml::table& table, const std::string& name, const char* format)
    : name_(name), root_(table, name, "", false, kRemedy) {
  if (const std::string found = root_.text("format"); found != format)
    root_.refuse(root_.node("format"), "format", "is " + excerpt(found) + " and must be \"" + format + "\"");
  if (const std::string version = root_.text("version"); version != "1.0")
    root_.refuse(root_.node("version"), "version", "is " + excerpt(version) + " and this program reads \"1.0\"");
}

std::string ProfileFile::text(Section& section, const std::string& key) {
  std::string found = section.text(key);
  const bool printable = std::all_of(found.begin(), found.end(), [](char c) { return c >= 0x20 && c < 0x7F; });
  if (!printable || found.size() > kLongestWord)
    section.refuse(section.node(key), key,
                   "is " + excerpt(found) + " and must be at most 200 printable characters of ASCII");
  return found;
}

WordOrder ProfileFile::word_order() {
  const std::string found = root_.text("word_order");
  if (found == "high_first") return WordOrder::high_first;
  if (found == "low_first") return WordOrder::low_first;
  root_.refuse(root_.node("word_order"), "word_order",
               "is " + excerpt(found) + " and must be \"high_first\" or \"low_first\"");
}

std::vector<DriveRegister> ProfileFile::registers() {
  Section all = root_.section("registers");
  const toml::table& table = *root_.node("registers").as_table();
  if (table.size() > kMostRegisters)
    root_.refuse(table, "registers", "holds " + std::to_string(table.size()) + " registers and may hold 64");
  for (const auto& [key, value] : table) {
    const std::string register_name(key.str());
    const bool plain = !register_name.empty() && std::all_of(register_name.begin(), register_name.end(), [](char c) {
      return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_';
    });
    if (!plain) all.refuse(value, excerpt(register_name), "is no name of small letters, digits and underscores");
    Section section = all.section(register_name);
    registers_.push_back(register_of(section, register_name));
    section.finish();
  }
  return registers_;
}

std::optional<std::size_t> ProfileFile::host_watchdog() {
  if (!root_.has("host_watchdog")) return std::nullopt;
  const std::size_t found = index(root_, "host_watchdog");
  if (registers_[found].unit != DriveUnit::ms)
    root_.refuse(root_.node("host_watchdog"), "host_watchdog", "must be a register whose unit is ms");
  return found;
}

std::size_t ProfileFile::index(Section& section, const std::string& key) const {
  const std::string wanted = section.text(key);
  const auto found =
      std::find_if(registers_.begin(), registers_.end(), [&](const DriveRegister& r) { return r.name == wanted; });
  if (found == registers_.end())
    section.refuse(section.node(key), key, "is " + excerpt(wanted) + " and must be the name of one of [registers]");
  return static_cast<std::size_t>(found - registers_.begin());
}

DriveCondition ProfileFile::condition(Section& within, const std::string& key) const {
  Section section = within.section(key);
  return condition_of(section);
}

std::optional<DriveCondition> ProfileFile::maybe(Section& within, const std::string& key) const {
  if (!within.has(key)) return std::nullopt;
  return condition(within, key);
}

DriveCondition ProfileFile::condition_of(Section& section) const {
  DriveCondition c;
  c.reg = index(section, "register");
  const DriveRegister& r = registers_[c.reg];
  if (r.unit != DriveUnit::none) section.refuse(section.node("register"), "register", "has a unit, and bits have none");
  const std::int64_t all = r.words == 1 ? 0xFFFF : 0xFFFFFFFF;
  c.mask = static_cast<std::uint32_t>(section.whole("mask", 1, all));
  c.value = static_cast<std::uint32_t>(section.whole("value", 0, all));
  if ((c.value & ~c.mask) != 0)
    section.refuse(section.node("value"), "value", "has bits that the mask lacks, so that it never holds");
  section.finish();
  return c;
}

DriveAction ProfileFile::action(Section& within, const std::string& key) const {
  DriveAction action;
  if (!within.has(key)) return action;
  each(within, key, kMostWrites, [&](Section& section) { action.push_back(write_of(section)); });
  return action;
}

DriveRegister ProfileFile::register_of(Section& section, const std::string& name) {
  DriveRegister r;
  r.name = name;
  const std::string type = section.text("type");
  if (type != "u16" && type != "s16" && type != "u32" && type != "s32")
    section.refuse(section.node("type"), "type", "is " + excerpt(type) + " and must be u16, s16, u32 or s32");
  r.is_signed = type[0] == 's';
  r.words = type[1] == '1' ? 1 : 2;
  r.address = static_cast<std::uint16_t>(section.whole("address", 0, 0x10000 - r.words));
  if (section.has("area")) {
    const std::string area = section.text("area");
    if (area != "holding" && area != "input")
      section.refuse(section.node("area"), "area", "is " + excerpt(area) + " and must be \"holding\" or \"input\"");
    if (area == "input") r.area = protocol::Area::input;
  }
  if (section.has("unit")) {
    const std::string unit = section.text("unit");
    const auto found = std::find_if(kUnits.begin(), kUnits.end(), [&](DriveUnit u) { return unit == unit_name(u); });
    if (found == kUnits.end())
      section.refuse(section.node("unit"), "unit",
                     "is " + excerpt(unit) + " and must be none, step, step/s, rpm, step/s2, ms/1000rpm or ms");
    r.unit = *found;
  }
  if (section.has("scale")) {
    r.scale = section.number("scale");
    if (!(r.scale >= 1 / kLargestScale && r.scale <= kLargestScale))
      section.refuse(section.node("scale"), "scale", "must be from 1e-9 to 1e9");
  }
  r.confirmed = section.boolean("confirmed");
  r.source = text(section, "source");
  return r;
}

DriveWrite ProfileFile::write_of(Section& section) const {
  DriveWrite w;
  w.reg = index(section, "register");
  const DriveRegister& r = registers_[w.reg];
  const toml::node& value = section.node("value");
  if (r.area != protocol::Area::holding)
    section.refuse(section.node("register"), "register", "is an input register, which nobody can write");
  if (const auto* constant = value.as_integer()) {
    w.constant = constant->get();
    if (!in_range(r, w.constant)) section.refuse(value, "value", "does not fit into the register " + r.name);
    return w;
  }
  const std::string what = section.text("value");
  if (what == "target" && r.unit == DriveUnit::step)
    w.what = DriveWrite::What::target;
  else if (what == "speed" && is_speed(r.unit))
    w.what = DriveWrite::What::speed;
  else if (what == "acceleration" && is_acceleration(r.unit))
    w.what = DriveWrite::What::acceleration;
  else
    section.refuse(value, "value",
                   "is " + excerpt(what) +
                       " and must be a whole number, or target, speed or acceleration in a register of such a unit");
  return w;
}

}  // namespace celadon
