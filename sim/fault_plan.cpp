#include "sim/fault_plan.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <sstream>

#include "sim/random.h"

namespace celadon::sim {
namespace {

using Lasts = FaultKind::Lasts;
using When = FaultOrder::When;

constexpr std::uint64_t kPlanPurpose = 11;
constexpr double kMostSeconds = 1e6;

constexpr std::array<FaultKind, 43> kKinds{{
    // link
    {"modbus-silent", "requests are done but not answered", "REQUESTS (0: until cleared)", 0, 0, 1e6, Lasts::count},
    {"heartbeat-lost", "requests neither arrive nor are answered", "REQUESTS (0: until cleared)", 0, 0, 1e6,
     Lasts::count},
    {"modbus-late", "answers come late", "MS", 300, 0, 60e3, Lasts::until_cleared},
    {"modbus-corrupt", "answers are damaged (RTU: CRC, TCP: transaction)", "REQUESTS (0: until cleared)", 1, 0, 1e6,
     Lasts::count},
    {"modbus-exception", "requests are answered with this exception and not done", "CODE", 4, 1, 11,
     Lasts::until_cleared},
    {"modbus-disconnect", "connections are closed, once", "", 0, 0, 0, Lasts::once},
    {"serial-noise", "bytes on the serial line change, both ways, this share of them", "SHARE", 0.005, 0, 1,
     Lasts::until_cleared},
    // controller
    {"controller-reset", "the controller starts anew, once", "", 0, 0, 0, Lasts::once},
    {"controller-unplug", "the controller's link is unplugged until cleared", "", 0, 0, 0, Lasts::until_cleared},
    {"clock-step", "the controller's clock jumps, once", "MS", 250, -60e3, 60e3, Lasts::once},
    {"interlock-open", "the interlock is open", "", 0, 0, 0, Lasts::until_cleared},
    {"emergency-stop", "the emergency stop is pressed", "", 0, 0, 0, Lasts::until_cleared},
    {"remote-off", "the switch at the machine forbids a start from afar", "", 0, 0, 0, Lasts::until_cleared},
    {"button-stuck", "the button stays down", "", 0, 0, 0, Lasts::until_cleared},
    {"button-chatter", "the button is pushed once, and its contact bounces this long whenever it is pushed or let go",
     "MS", 10, 0, 1000, Lasts::until_cleared},
    // motion
    {"motor-stall", "the motor is blocked", "", 0, 0, 0, Lasts::until_cleared},
    {"motor-slip", "the table slips on its drive, behind the encoder, once", "DEG", -2, -360, 360, Lasts::once},
    {"backlash", "play between drive and table", "DEG", 0.5, 0, 10, Lasts::until_cleared},
    {"steps-wrong", "the table turns further than the encoder says by this factor", "FACTOR", 1.01, 0.5, 2,
     Lasts::until_cleared},
    {"encoder-slip", "the encoder jumps, once", "DEG", 1, -360, 360, Lasts::once},
    {"elevation-stall", "the elevation axis is blocked, where there is one", "", 0, 0, 0, Lasts::until_cleared},
    {"lift-stall", "the lift is blocked, where there is one", "", 0, 0, 0, Lasts::until_cleared},
    {"lift-sink", "the lift sinks under its load, once", "MM", 2, -50, 50, Lasts::once},
    {"lift-slip", "the lift's encoder jumps, once: behind its travel lies a hard end", "MM", 20, -500, 500,
     Lasts::once},
    // laser
    {"laser-dead", "the laser does not emit", "", 0, 0, 0, Lasts::until_cleared},
    {"laser-flicker", "the laser goes out for this share of the time, in moments of 8 ms", "SHARE", 0.3, 0, 1,
     Lasts::until_cleared},
    {"laser-stuck-on", "the laser emits although it is switched off", "", 0, 0, 0, Lasts::until_cleared},
    {"laser-hidden", "the laser emits although it is switched off, and its sensor does not see it", "", 0, 0, 0,
     Lasts::until_cleared},
    // camera
    {"drop-frame", "the next frames are lost", "FRAMES", 1, 1, 1e6, Lasts::once},
    {"duplicate-frame", "the next frames are the one before once more, with its stamp", "FRAMES", 1, 0, 1e6,
     Lasts::count},
    {"stale-frame", "the next frames show the picture of the one before", "FRAMES", 1, 0, 1e6, Lasts::count},
    {"corrupt-frame", "the next frames arrive damaged and flagged", "FRAMES", 1, 0, 1e6, Lasts::count},
    {"short-frame", "the next frames arrive with half of their bytes, not flagged", "FRAMES", 1, 0, 1e6, Lasts::count},
    {"delay-frames", "frames arrive later", "MS", 100, 0, 60e3, Lasts::until_cleared},
    {"stamp-step", "the clock that stamps frames is off by this much", "MS", 250, -60e3, 60e3, Lasts::until_cleared},
    {"camera-unplug", "the camera is gone (ENODEV) until cleared", "", 0, 0, 0, Lasts::until_cleared},
    {"usb-unplug", "controller and camera are pulled out of USB until cleared", "", 0, 0, 0, Lasts::until_cleared},
    {"camera-nudge", "the camera turns about its vertical, once", "DEG", 0.2, -10, 10, Lasts::once},
    // object and room
    {"vibration", "the camera shakes about its vertical at 31 Hz", "DEG", 0.02, 0, 10, Lasts::until_cleared},
    {"lights-on", "room light is brighter by this factor", "FACTOR", 6, 0, 100, Lasts::until_cleared},
    {"object-slip", "the object turns on the table, once", "DEG", 2, -360, 360, Lasts::once},
    {"object-wobble", "the object rocks to and fro on the table at 3 Hz", "MM", 0.5, 0, 50, Lasts::until_cleared},
    {"object-fall", "the object falls off the table", "", 0, 0, 0, Lasts::until_cleared},
}};

std::string number_text(double v) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%g", v);
  return text.data();
}

bool parse_number(const std::string& text, double& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() && std::isfinite(value);
}

/// A number, or LOW..HIGH: one of its numbers, drawn by (seed, line, nth).
bool parse_span(const std::string& text, const FaultOrigin& origin, std::uint32_t nth, double& value) {
  const auto dots = text.find("..");
  if (dots == std::string::npos) return parse_number(text, value);
  double low = 0, high = 0;
  if (!parse_number(text.substr(0, dots), low) || !parse_number(text.substr(dots + 2), high) || high < low)
    return false;
  value = low + (high - low) * random_uniform(make_key(origin.seed, kPlanPurpose, origin.line), nth);
  return true;
}

std::vector<std::string> words_of(const std::string& line) {
  std::istringstream in(line.substr(0, line.find('#')));
  std::vector<std::string> words;
  for (std::string word; in >> word;) words.push_back(word);
  return words;
}

tl::unexpected<std::string> no_fault(const std::string& sentence) {
  return tl::unexpected<std::string>(sentence);
}

}  // namespace

std::span<const FaultKind> fault_kinds() {
  return kKinds;
}

const FaultKind* find_fault(const std::string& name) {
  const auto* at = std::find_if(kKinds.begin(), kKinds.end(), [&](const FaultKind& k) { return name == k.name; });
  return at == kKinds.end() ? nullptr : at;
}

tl::expected<FaultOrder, std::string> make_fault(const std::string& name, std::span<const std::string> arguments) {
  const FaultKind* kind = find_fault(name);
  if (kind == nullptr) return no_fault("no fault is named \"" + name + "\"; \"fault list\" names them");
  FaultOrder order;
  order.kind = kind;
  order.value = kind->default_value;
  const bool takes_one = kind->argument[0] != '\0';
  if (arguments.size() > (takes_one ? 1U : 0U)) {
    return no_fault("fault " + name +
                    (takes_one ? " takes one argument, " + std::string(kind->argument) : " takes no argument"));
  }
  if (!arguments.empty()) {
    if (!parse_number(arguments[0], order.value) || order.value < kind->least || order.value > kind->most) {
      return no_fault("fault " + name + " takes " + kind->argument + " from " + number_text(kind->least) + " to " +
                      number_text(kind->most) + ", not \"" + arguments[0] + "\"");
    }
  }
  return order;
}

tl::expected<FaultOrder, std::string> parse_fault_option(const std::string& text, std::int64_t start_ns) {
  std::string head = text, seconds;
  if (const auto at = text.find('@'); at != std::string::npos) {
    head = text.substr(0, at);
    seconds = text.substr(at + 1);
  }
  std::vector<std::string> arguments;
  if (const auto comma = head.find(','); comma != std::string::npos) {
    arguments.push_back(head.substr(comma + 1));
    head.resize(comma);
  }
  auto order = make_fault(head, arguments);
  if (!order) return order;
  double at = 0;
  if (!seconds.empty() && (!parse_number(seconds, at) || at < 0 || at > kMostSeconds))
    return no_fault("fault time \"" + seconds + "\" is not a number of seconds from 0 to 1000000");
  order->at_ns = start_ns + static_cast<std::int64_t>(at * 1e9);
  return order;
}

tl::expected<FaultOrder, std::string> parse_fault_words(std::span<const std::string> words, const FaultOrigin& origin) {
  if (words.empty()) return no_fault("an order begins with the name of a fault; \"fault list\" names them");
  const auto is_clause = [](const std::string& w) { return w == "at" || w == "angle" || w == "frame" || w == "for"; };
  std::size_t next = 1;
  std::vector<std::string> arguments;
  for (; next < words.size() && !is_clause(words[next]); ++next) {
    double value = 0;
    const bool drawn = words[next].find("..") != std::string::npos && parse_span(words[next], origin, 0, value);
    arguments.push_back(drawn ? number_text(value) : words[next]);
  }
  auto order = make_fault(words[0], arguments);
  if (!order) return order;
  for (; next < words.size(); next += 2) {
    const std::string& clause = words[next];
    if (!is_clause(clause) || next + 1 == words.size())
      return no_fault("\"" + clause + "\" is not followed by a number, or is none of at, angle, frame, for");
    double value = 0;
    const double least = clause == "angle" ? -kMostSeconds : 0;
    if (!parse_span(words[next + 1], origin, static_cast<std::uint32_t>(next), value) || value < least ||
        value > kMostSeconds)
      return no_fault(clause + " takes a number up to 1000000 or LOW..HIGH, not \"" + words[next + 1] + "\"");
    if (clause == "for") {
      if (order->kind->lasts == Lasts::once) return no_fault(words[0] + " happens once and has no duration");
      order->duration_ns = static_cast<std::int64_t>(value * 1e9);
    } else if (clause == "at") {
      order->at_ns = origin.start_ns + static_cast<std::int64_t>(value * 1e9);
    } else if (clause == "angle") {
      order->when = When::angle;
      order->at_deg = value;
    } else {
      order->when = When::frame;
      order->at_frame = static_cast<std::uint64_t>(value);
    }
  }
  return order;
}

tl::expected<std::vector<FaultOrder>, std::string> parse_fault_plan(const std::string& text, FaultOrigin origin) {
  std::vector<FaultOrder> orders;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) {
    ++origin.line;
    const std::vector<std::string> words = words_of(line);
    if (words.empty()) continue;
    const auto wrong = [&](const std::string& what) {
      return no_fault("line " + std::to_string(origin.line) + " of the fault plan: " + what);
    };
    if (words[0] == "seed") {
      double seed = 0;
      if (words.size() != 2 || !parse_number(words[1], seed) || seed < 0 || seed > 0x1p53)
        return wrong("seed takes one whole number");
      origin.seed = static_cast<std::uint64_t>(seed);
      continue;
    }
    auto order = parse_fault_words(words, origin);
    if (!order) return wrong(order.error());
    orders.push_back(*order);
  }
  return orders;
}

std::int64_t FaultPlan::next_ns() const {
  std::int64_t next = INT64_MAX;
  for (const FaultOrder& order : orders_) {
    if (order.when == When::time) next = std::min(next, order.at_ns);
  }
  for (const auto& [name, armed] : armed_) next = std::min(next, armed.end_ns);
  return next;
}

std::vector<FaultOrder> FaultPlan::take(const std::function<bool(const FaultOrder&)>& due) {
  std::vector<FaultOrder> out;
  std::erase_if(orders_, [&](const FaultOrder& order) {
    if (!due(order)) return false;
    out.push_back(order);
    return true;
  });
  return out;
}

std::vector<FaultOrder> FaultPlan::due(std::int64_t now_ns) {
  return take([&](const FaultOrder& order) { return order.when == When::time && order.at_ns <= now_ns; });
}
std::vector<FaultOrder> FaultPlan::due_at_angle(double position_deg) {
  return take([&](const FaultOrder& order) { return order.when == When::angle && order.at_deg <= position_deg; });
}
std::vector<FaultOrder> FaultPlan::due_at_frame(std::uint64_t sequence) {
  return take([&](const FaultOrder& order) { return order.when == When::frame && order.at_frame <= sequence; });
}

std::vector<std::string> FaultPlan::over(std::int64_t now_ns) {
  std::vector<std::string> names;
  for (auto& [name, armed] : armed_) {
    if (armed.end_ns > now_ns) continue;
    armed.end_ns = INT64_MAX;
    names.push_back(name);
  }
  return names;
}

void FaultPlan::arm(const FaultOrder& order, std::int64_t now_ns) {
  armed_[order.kind->name] = {order.value, order.value > 0,
                              order.duration_ns > 0 ? now_ns + order.duration_ns : INT64_MAX};
}

bool FaultPlan::strikes(const std::string& name) {
  const auto at = armed_.find(name);
  if (at == armed_.end()) return false;
  if (at->second.limited && --at->second.value <= 0) armed_.erase(at);
  return true;
}

std::vector<std::string> FaultPlan::names_armed() const {
  std::vector<std::string> names;
  for (const auto& [name, armed] : armed_) names.push_back(name);
  return names;
}

}  // namespace celadon::sim
