#include "sim/control_socket.h"

#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "sim/device_truth.h"
#include "sim/frame_server.h"

namespace celadon::sim {
namespace {

using nlohmann::json;
using Words = std::vector<std::string>;

constexpr int kVersion = 1;
constexpr std::size_t kMaxClients = 32, kMaxLine = 4096;
constexpr std::int64_t kLongestWait_ns = 3'600'000'000'000;

json refused(const std::string& sentence) {
  return {{"ok", false}, {"error", sentence}};
}

// Anything a client may send, shown in an answer: short and printable.
std::string shown(const std::string& text) {
  std::string out = text.substr(0, 40);
  for (char& c : out) {
    if (c < ' ' || c > '~') c = '?';
  }
  return "\"" + out + (text.size() > 40 ? "...\"" : "\"");
}

template <class Number>
bool parse(const std::string& text, Number& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

template <std::size_t N>
const char* name_of(const protocol::Code (&table)[N], std::uint16_t value) {
  return protocol::find_code(table, value).name;
}

struct Device {
  DeviceModel& model;
  Pacer& pacer;
  const std::string& modbus_url;
  std::uint64_t client;
};

json hello(const Device& d, const Words&) {
  const DeviceConfig& c = d.model.config();
  return {{"version", kVersion},
          {"scene", d.model.scene().name()},
          {"seed", c.seed},
          {"lock_step", d.pacer.lock_step()},
          {"time_ns", d.model.now_ns()},
          {"modbus_url", d.modbus_url},
          {"machine", d.model.machine()},
          {"camera", d.model.camera_identity()}};
}

json time_now(const Device& d, const Words&) {
  return {{"time_ns", d.model.now_ns()}};
}

json wait_until(const Device& d, const Words& words) {
  std::int64_t time = 0;
  if (words.size() != 2 || !parse(words[1], time)) return refused("wait-until takes one time in nanoseconds");
  if (!d.pacer.lock_step()) return refused("wait-until is for lock-step; this device runs in real time");
  if (time > d.model.now_ns() + kLongestWait_ns)
    return refused("wait-until goes at most one hour ahead of time_ns " + std::to_string(d.model.now_ns()));
  d.pacer.declare(d.client);
  d.model.advance_to(time);
  return {{"time_ns", d.model.now_ns()}};
}

json press(const Device& d, const Words& words) {
  double ms = 100;
  if (words.size() > 2 || (words.size() == 2 && (!parse(words[1], ms) || !(ms >= 1 && ms <= 600'000)))) {
    return refused("press takes the time held in milliseconds, 1 to 600000");
  }
  return {{"presses", d.model.press(static_cast<std::int64_t>(ms * 1e6))}};
}

// null where there is none.
json other_axis(const std::optional<DeviceState::OtherAxis>& axis, const char* position) {
  if (!axis) return nullptr;
  return {{position, axis->position},
          {"motion", name_of(protocol::kMotionStates, static_cast<std::uint16_t>(axis->motion))}};
}

json state(const Device& d, const Words&) {
  const DeviceState s = d.model.state();
  return {{"angle_rad", s.angle_rad},
          {"speed_rad_per_s", s.speed_rad_per_s},
          {"motor_speed_rad_per_s", s.motor_speed_rad_per_s},
          {"motion", name_of(protocol::kMotionStates, static_cast<std::uint16_t>(s.motion))},
          {"elevation", other_axis(s.elevation, "angle_rad")},
          {"lift", other_axis(s.lift, "height_mm")},
          {"lasers_on", s.lasers_on},
          {"lease_left_ms", s.lease_left_ms},
          {"lamp", name_of(protocol::kLampPatterns, static_cast<std::uint16_t>(s.lamp))},
          {"fault", name_of(protocol::kFaultCodes, static_cast<std::uint16_t>(s.fault))},
          {"interlock_closed", s.interlock_closed},
          {"local_action_needed", s.local_action_needed},
          {"time_ns", s.time_ns},
          {"dark_since_ns", s.dark_since_ns},
          {"fault_since_ns", s.fault_since_ns},
          {"struck_ns", s.struck_ns},
          {"faults", s.faults}};
}

json truth(const Device& d, const Words& words) {
  double theta = 0, z = 0;
  if (words.size() != 3 || !parse(words[1], theta) || !parse(words[2], z) || !std::isfinite(theta) ||
      !std::isfinite(z)) {
    return refused("truth takes an angle in radians and a height in millimetres");
  }
  const double r = d.model.scene().truth_r_mm(theta, z);
  if (std::isnan(r)) {
    return refused("the object has no surface at z = " + words[2] + " mm; it reaches from " +
                   std::to_string(d.model.scene().z_min_mm()) + " to " + std::to_string(d.model.scene().z_max_mm()) +
                   " mm");
  }
  json out{{"r_mm", r}};
  if (d.model.scene().coloured()) {
    const Eigen::Array3d share = d.model.scene().truth_reflectance(theta, z);
    out["reflectance"] = {share.x(), share.y(), share.z()};
  }
  return out;
}

json scene(const Device& d, const Words& words) {
  if (words.size() > 1) {
    // File names have spaces.
    std::string name = words[1];
    for (std::size_t i = 2; i < words.size(); ++i) name += " " + words[i];
    if (const auto put = d.model.put(name); !put) return refused(put.error());
  }
  return {{"time_ns", d.model.now_ns()},
          {"name", d.model.scene().name()},
          {"z_min_mm", d.model.scene().z_min_mm()},
          {"z_max_mm", d.model.scene().z_max_mm()}};
}

json corners(const Device& d, const Words& words) {
  std::array<double, 3> at{};
  bool good = words.size() <= 1 + at.size();
  for (std::size_t i = 1; good && i < words.size(); ++i) good = parse(words[i], at[i - 1]) && std::isfinite(at[i - 1]);
  if (!good) {
    return refused(
        "corners takes what the axes say: the table's angle and the elevation in radians, the lift's height in "
        "millimetres, each 0 without");
  }
  const Posture posture = d.model.config().optics.axes.at(at[0], at[1], at[2]);
  return {{"corners", corners_of(d.model.config(), d.model.scene(), posture)}};
}

json effects(const Device& d, const Words&) {
  return {{"effects", effects_of(d.model.config())}};
}

json calibration(const Device& d, const Words&) {
  return {{"calibration", format_calibration(d.model.calibration())}};
}

json fault(const Device& d, const Words& words) {
  if (words.size() < 2) return refused("fault takes a name; \"fault list\" names them");
  if (words[1] == "list") {
    json list = json::array();
    for (const FaultKind& kind : fault_kinds()) {
      list.push_back({{"name", kind.name}, {"meaning", kind.meaning}, {"argument", kind.argument}});
    }
    return {{"faults", list}};
  }
  const FaultOrigin origin{d.model.now_ns(), d.model.config().seed, 0};
  const auto order = parse_fault_words(std::span(words).subspan(1), origin);
  if (!order) return refused(order.error());
  d.model.inject(*order);
  return {{"armed", words[1]}};
}

json clear(const Device& d, const Words& words) {
  if (words.size() != 2 || find_fault(words[1]) == nullptr)
    return refused("clear takes the name of a fault; \"fault list\" names them");
  d.model.clear_fault(words[1]);
  return {{"cleared", words[1]}};
}

struct Command {
  json (*run)(const Device&, const Words&);
  bool takes_arguments;
};

const std::map<std::string, Command>& commands() {
  static const std::map<std::string, Command> kCommands{
      {"hello", {hello, false}},     {"time", {time_now, false}}, {"wait-until", {wait_until, true}},
      {"press", {press, true}},      {"state", {state, false}},   {"truth", {truth, true}},
      {"scene", {scene, true}},      {"fault", {fault, true}},    {"calibration", {calibration, false}},
      {"effects", {effects, false}}, {"clear", {clear, true}},    {"corners", {corners, true}}};
  return kCommands;
}

}  // namespace

json ControlSocket::answer(const std::string& line, std::uint64_t client) {
  Words words;
  std::size_t at = 0;
  while (at < line.size()) {
    const std::size_t end = std::min(line.find(' ', at), line.size());
    if (end > at) words.push_back(line.substr(at, end - at));
    at = end + 1;
  }
  if (words.empty()) return refused("the line is empty; send a command of CONTROL.md, e.g. hello");
  const auto command = commands().find(words[0]);
  if (command == commands().end())
    return refused("command " + shown(words[0]) + " is unknown; CONTROL.md lists the commands");
  if (!command->second.takes_arguments && words.size() > 1)
    return refused("command " + words[0] + " takes no arguments");
  pacer_.catch_up();
  json out = command->second.run({model_, pacer_, modbus_url_, client}, words);
  if (!out.contains("ok")) out["ok"] = true;
  return out;
}

tl::expected<std::unique_ptr<ControlSocket>, std::string> ControlSocket::open(const std::filesystem::path& socket_path,
                                                                              DeviceModel& model, Pacer& pacer,
                                                                              const std::string& modbus_url) {
  auto listener = listen_unix(socket_path, SOCK_STREAM);
  if (!listener) return tl::unexpected(listener.error());
  std::unique_ptr<ControlSocket> control(new ControlSocket(model, pacer, modbus_url));
  control->listener_ = *std::move(listener);
  control->path_ = socket_path;
  return control;
}

ControlSocket::~ControlSocket() {
  std::error_code ignored;
  std::filesystem::remove(path_, ignored);
}

void ControlSocket::collect(std::vector<pollfd>& polls) {
  polls.push_back({listener_.get(), POLLIN, 0});
  for (const auto& client : clients_) polls.push_back({client->fd.get(), POLLIN, 0});
}

void ControlSocket::serve(const pollfd* polls, std::size_t count) {
  for (std::size_t i = 0; i < clients_.size() && i + 1 < count; ++i) {
    if (polls[i + 1].revents != 0) receive(*clients_[i]);
  }
  for (const auto& client : clients_) {
    if (client->closed) pacer_.forget(client->number);
  }
  std::erase_if(clients_, [](const auto& client) { return client->closed; });
  if (count == 0 || (polls[0].revents & POLLIN) == 0) return;
  FileDescriptor fd(accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
  if (!fd || clients_.size() >= kMaxClients) return;
  auto client = std::make_unique<Client>();
  client->fd = std::move(fd);
  client->number = pacer_.new_client();
  clients_.push_back(std::move(client));
}

void ControlSocket::receive(Client& client) {
  std::array<char, 4096> bytes{};
  const ssize_t n = recv(client.fd.get(), bytes.data(), bytes.size(), MSG_DONTWAIT);
  if (n < 0 && (errno == EAGAIN || errno == EINTR)) return;
  if (n <= 0) {
    client.closed = true;
    return;
  }
  client.input.append(bytes.data(), static_cast<std::size_t>(n));
  std::size_t end = 0;
  while (!client.closed && (end = client.input.find('\n')) != std::string::npos && end <= kMaxLine) {
    const std::string line = client.input.substr(0, end);
    client.input.erase(0, end + 1);
    send_line(client, answer(line, client.number));
  }
  if (client.input.size() > kMaxLine) {
    send_line(client,
              refused("the line is longer than " + std::to_string(kMaxLine) + " bytes; the connection is closed"));
    client.closed = true;
  }
}

void ControlSocket::send_line(Client& client, const json& answer) {
  const std::string text = answer.dump(-1, ' ', false, json::error_handler_t::replace) + "\n";
  // A client that does not read its answers loses its connection.
  if (send(client.fd.get(), text.data(), text.size(), MSG_NOSIGNAL | MSG_DONTWAIT) !=
      static_cast<ssize_t>(text.size())) {
    client.closed = true;
  }
}

}  // namespace celadon::sim
