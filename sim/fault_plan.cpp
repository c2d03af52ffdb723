#include "sim/fault_plan.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>

namespace celadon::sim {
namespace {

constexpr std::array<FaultKind, 24> kKinds{{
    {"drop-frame", "the next frames are lost", "FRAMES", 1, 1, 1e6, true},
    {"corrupt-frame", "the next frames arrive damaged and flagged", "FRAMES", 1, 0, 1e6, true},
    {"short-frame", "the next frames arrive with half of their bytes, not flagged", "FRAMES", 1, 0, 1e6, true},
    {"stale-frame", "the next frames show the picture of the one before", "FRAMES", 1, 0, 1e6, true},
    {"delay-frames", "frames arrive later", "MS", 100, 0, 60e3, false},
    {"camera-unplug", "the camera is gone (ENODEV) until cleared", "", 0, 0, 0, false},
    {"usb-unplug", "controller and camera are pulled out of USB until cleared", "", 0, 0, 0, false},
    {"modbus-silent", "requests are done but not answered", "REQUESTS (0: until cleared)", 0, 0, 1e6, true},
    {"modbus-exception", "requests are answered with this exception and not done", "CODE", 4, 1, 11, false},
    {"modbus-late", "answers come late", "MS", 300, 0, 60e3, false},
    {"modbus-corrupt", "answers are damaged (RTU: CRC, TCP: transaction)", "REQUESTS (0: until cleared)", 1, 0, 1e6,
     true},
    {"modbus-disconnect", "connections are closed, once", "", 0, 0, 0, false},
    {"controller-reset", "the controller starts anew, once", "", 0, 0, 0, false},
    {"laser-stuck-on", "the laser emits although it is switched off", "", 0, 0, 0, false},
    {"laser-dead", "the laser does not emit", "", 0, 0, 0, false},
    {"interlock-open", "the interlock is open", "", 0, 0, 0, false},
    {"emergency-stop", "the emergency stop is pressed", "", 0, 0, 0, false},
    {"button-stuck", "the button stays down", "", 0, 0, 0, false},
    {"encoder-slip", "the encoder jumps, once", "DEG", 1, -360, 360, false},
    {"motor-stall", "the motor is blocked", "", 0, 0, 0, false},
    {"steps-wrong", "the table turns further than the encoder says by this factor", "FACTOR", 1.01, 0.5, 2, false},
    {"object-slip", "the object turns on the table, once", "DEG", 2, -360, 360, false},
    {"camera-nudge", "the camera turns about its vertical, once", "DEG", 0.2, -10, 10, false},
    {"lights-on", "room light is brighter by this factor", "FACTOR", 6, 0, 100, false},
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
  if (kind == nullptr) return tl::unexpected("no fault is named \"" + name + "\"; \"fault list\" names them");
  FaultOrder order{kind, kind->default_value, 0};
  const bool takes_one = kind->argument[0] != '\0';
  if (arguments.size() > (takes_one ? 1U : 0U)) {
    return tl::unexpected("fault " + name +
                          (takes_one ? " takes one argument, " + std::string(kind->argument) : " takes no argument"));
  }
  if (!arguments.empty()) {
    if (!parse_number(arguments[0], order.value) || order.value < kind->least || order.value > kind->most) {
      return tl::unexpected("fault " + name + " takes " + kind->argument + " from " + number_text(kind->least) +
                            " to " + number_text(kind->most) + ", not \"" + arguments[0] + "\"");
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
  if (!seconds.empty() && (!parse_number(seconds, at) || at < 0 || at > 1e6)) {
    return tl::unexpected("fault time \"" + seconds + "\" is not a number of seconds from 0 to 1000000");
  }
  order->at_ns = start_ns + static_cast<std::int64_t>(at * 1e9);
  return order;
}

std::int64_t FaultPlan::next_ns() const {
  std::int64_t next = INT64_MAX;
  for (const FaultOrder& order : orders_) next = std::min(next, order.at_ns);
  return next;
}

std::vector<FaultOrder> FaultPlan::due(std::int64_t now_ns) {
  std::vector<FaultOrder> out;
  std::erase_if(orders_, [&](const FaultOrder& order) {
    if (order.at_ns > now_ns) return false;
    out.push_back(order);
    return true;
  });
  return out;
}

bool FaultPlan::strikes(const std::string& name) {
  const auto at = armed_.find(name);
  if (at == armed_.end()) return false;
  if (at->second.limited && --at->second.value <= 0) armed_.erase(at);
  return true;
}

}  // namespace celadon::sim
