#include "firmware_bridge/foreign_drive.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>
#include <utility>

#include "firmware_bridge/drive_plant.h"

namespace celadon {
namespace {

using Kind = DeviceError::Kind;
using protocol::Exception;
namespace reg = protocol::reg;
namespace groups = protocol::groups;

// Shorter ones fall between two polls, longer ones let a laser of a dead host shine too long.
constexpr double kShortestWatchdog_ms = 100, kLongestWatchdog_ms = 1000;
constexpr double kUdeg_per_deg = 1e6;

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

struct Refused {
  std::string cause, remedy;
};

double motor_steps_per_turn(const ForeignMachine& m) {
  return m.steps_per_turn > 0 ? m.steps_per_turn : m.drive.steps_per_turn;
}

double steps_per_deg(const ForeignMachine& m) {
  return motor_steps_per_turn(m) * std::abs(m.motor_turns_per_turn) / 360;
}

// A quantity of a move as its register takes it; nullopt: it does not.
std::optional<std::int64_t> move_count(const ForeignMachine& m, DriveWrite::What what, double quantity) {
  for (const DriveWrite& write : m.drive.move) {
    if (write.what == what) return count_of(m.drive.registers[write.reg], quantity, motor_steps_per_turn(m));
  }
  return 0;
}

std::optional<Refused> unfit(const ForeignMachine& m) {
  const std::string drive = "the drive " + m.drive.name, io = "the I/O device " + m.io.name;
  if (const DriveRegister* r = unconfirmed_for_motion(m.drive))
    return Refused{drive + " would move by the register " + r->name + ", which its profile does not confirm",
                   "look it up in the manual (" + r->source + ") and say confirmed = true in a copy of the profile"};
  if (const DriveRegister* r = unconfirmed_for_safety(m.io))
    return Refused{io + " would protect by the register " + r->name + ", which its profile does not confirm",
                   "look it up in the manual (" + r->source + ") and say confirmed = true in the profile"};
  if (!m.io.host_watchdog)
    return Refused{io + " has no watchdog, so that the laser of a dead host would stay on",
                   "take one whose outputs fall by themselves, and name its register as host_watchdog"};
  const auto& own = m.drive.host_watchdog;
  if (m.io.motor_enable == 0 && !(own && m.drive.registers[*own].confirmed))
    return Refused{drive + " has no confirmed watchdog and its enable does not go through " + io +
                       ", so that the motor of a dead host would go on",
                   "wire the drive's enable or torque-off input to an output of the I/O device and name it "
                   "motor_enable"};
  if (m.homes_at_mark && m.drive.mark.empty())
    return Refused{drive + " cannot take the place where it stands for 0", "home it by its index"};
  if (!m.homes_at_mark && !m.drive.has_index)
    return Refused{drive + " has no index to home at", "home it at an operator's mark: homing = \"mark\""};
  const double rate = steps_per_deg(m);
  if (!(rate > 0) || !std::isfinite(rate))
    return Refused{"the gear between motor and table is " + number(m.motor_turns_per_turn) + " turns a turn",
                   "give the motor's turns in one turn of the table"};
  if (!(m.max_speed_deg_per_s > 0 && m.max_speed_deg_per_s <= 3600) ||
      !move_count(m, DriveWrite::What::speed, m.max_speed_deg_per_s * rate))
    return Refused{"a greatest speed of " + number(m.max_speed_deg_per_s) + " deg/s is more than " + drive +
                       " can be told, or no speed",
                   "give a smaller max_speed_deg_per_s"};
  if (!(m.max_acceleration_deg_per_s2 > 0 && m.max_acceleration_deg_per_s2 <= 4200) ||
      !move_count(m, DriveWrite::What::acceleration, m.max_acceleration_deg_per_s2 * rate))
    return Refused{"a greatest acceleration of " + number(m.max_acceleration_deg_per_s2) + " deg/s2 is none that " +
                       drive + " can be told",
                   "give another max_acceleration_deg_per_s2"};
  return std::nullopt;
}

class ForeignTransport final : public Transport {
 public:
  ForeignTransport(const ForeignMachine& machine, std::unique_ptr<Transport> drive, std::unique_ptr<Transport> io,
                   Clock& clock)
      : machine_(machine), drive_(std::move(drive)), io_(std::move(io)), plant_(machine_, *drive_, *io_, clock) {}

  /// Watchdogs, first observation, core. @returns what keeps it from starting
  tl::expected<void, LinkError> start();

  tl::expected<void, LinkError> read_inputs(std::uint16_t address, std::span<std::uint16_t> words) override;
  tl::expected<void, LinkError> read_holding(std::uint16_t address, std::span<std::uint16_t> words) override;
  tl::expected<void, LinkError> write_holding(std::uint16_t address, std::span<const std::uint16_t> words) override;
  tl::expected<void, LinkError> reconnect() override;
  const std::string& url() const override { return drive_->url(); }
  /// Both links opened once are one connection.
  std::uint64_t connections() const override {
    const std::uint64_t both = drive_->connections() + io_->connections();
    return both > 0 ? both - 1 : 0;
  }
  std::string warning() const override;
  std::string fault_text(std::uint16_t detail) const override { return plant_.alarm_text(detail); }

 private:
  tl::expected<double, LinkError> watchdog_ms(const DriveRegister& r, WordOrder order, Transport& from);
  ControllerConfig core_config(double watchdog_ms) const;
  tl::expected<void, LinkError> move_fits(std::span<const std::uint16_t> block) const;

  const ForeignMachine machine_;
  std::unique_ptr<Transport> drive_, io_;
  DrivePlant plant_;
  std::unique_ptr<ControllerCore> core_;
};

tl::expected<void, LinkError> answer(Exception exception) {
  if (exception == Exception::none) return {};
  return tl::unexpected(LinkError{Kind::refused, static_cast<int>(exception),
                                  "exception " + std::to_string(static_cast<int>(exception)), false});
}

tl::expected<double, LinkError> ForeignTransport::watchdog_ms(const DriveRegister& r, WordOrder order,
                                                              Transport& from) {
  auto time_ms = plant_.read_time_ms(r, order, from);
  if (time_ms && !(*time_ms >= kShortestWatchdog_ms && *time_ms <= kLongestWatchdog_ms))
    return tl::unexpected(LinkError{Kind::refused, 0,
                                    "the watchdog " + r.name + " at " + from.url() + " is set to " + number(*time_ms) +
                                        " ms; set it to " + number(kShortestWatchdog_ms) + " to " +
                                        number(kLongestWatchdog_ms) + " ms with the maker's tool",
                                    false});
  return time_ms;
}

ControllerConfig ForeignTransport::core_config(double watchdog_ms) const {
  ControllerConfig config;
  config.vendor = machine_.drive.vendor.c_str();
  config.model = machine_.drive.model.c_str();
  config.serial = machine_.serial.c_str();
  config.lasers = static_cast<std::uint16_t>(machine_.io.lasers.size());
  config.laser_class = machine_.io.laser_class;
  config.lease_max_ms = config.heartbeat_timeout_ms = static_cast<std::uint16_t>(watchdog_ms);
  if (machine_.io.remote_enabled)
    config.safety_hardware = static_cast<std::uint16_t>(config.safety_hardware | protocol::kHasRemoteEnable);
  config.session_timeout_ms = 0;  // the core is this process's own: it could not keep another host away
  ControllerConfig::Axis& axis = config.axis[0];
  axis.features = protocol::kEndless | protocol::kStampedByHost;
  if (machine_.drive.has_index && !machine_.homes_at_mark)
    axis.features = static_cast<std::uint16_t>(axis.features | protocol::kHasIndex);
  if (machine_.drive.closed_loop) axis.features = static_cast<std::uint16_t>(axis.features | protocol::kClosedLoop);
  const DriveRegister& position = machine_.drive.registers[machine_.drive.position];
  axis.encoder_resolution_ndeg =
      static_cast<std::uint32_t>(std::min(1e9 * position.scale / steps_per_deg(machine_), 4e9));
  axis.max_speed_udeg_per_s = static_cast<std::uint32_t>(std::floor(machine_.max_speed_deg_per_s * kUdeg_per_deg));
  axis.max_acceleration_udeg_per_s2 =
      static_cast<std::uint32_t>(std::floor(machine_.max_acceleration_deg_per_s2 * kUdeg_per_deg));
  return config;
}

tl::expected<void, LinkError> ForeignTransport::start() {
  const IoProfile& io = machine_.io;
  const DriveProfile& drive = machine_.drive;
  auto io_ms = watchdog_ms(io.registers[*io.host_watchdog], io.word_order, *io_);
  if (!io_ms) return tl::unexpected(std::move(io_ms.error()));
  double shortest_ms = *io_ms;
  if (io.motor_enable == 0) {
    auto drive_ms = watchdog_ms(drive.registers[*drive.host_watchdog], drive.word_order, *drive_);
    if (!drive_ms) return tl::unexpected(std::move(drive_ms.error()));
    shortest_ms = std::min(shortest_ms, *drive_ms);
  }
  if (auto seen = plant_.observe_inputs(); !seen) return seen;
  if (auto seen = plant_.observe_drive(); !seen) return seen;
  core_ = std::make_unique<ControllerCore>(core_config(shortest_ms), plant_,
                                           static_cast<std::uint16_t>(std::random_device{}()), plant_.now_us());
  return plant_.carry_out();
}

tl::expected<void, LinkError> ForeignTransport::read_inputs(std::uint16_t address, std::span<std::uint16_t> words) {
  if (address < groups::identity.base) {
    if (auto seen = plant_.observe_inputs(); !seen) return seen;
    if (auto seen = plant_.observe_drive(); !seen) return seen;
  }
  const Exception read =
      core_->read_input(plant_.now_us(), address, static_cast<std::uint16_t>(words.size()), words.data());
  if (auto done = plant_.carry_out(); !done) return done;
  return answer(read);
}

tl::expected<void, LinkError> ForeignTransport::read_holding(std::uint16_t address, std::span<std::uint16_t> words) {
  return answer(core_->read_holding(plant_.now_us(), address, static_cast<std::uint16_t>(words.size()), words.data()));
}

// Whether a write can only make the machine safer, so that it goes through on any news or none.
bool only_makes_safer(std::uint16_t address, std::span<const std::uint16_t> words) {
  if (address == reg::control::make_safe.address()) return true;
  if (address == reg::control::laser_lease.address())
    return std::all_of(words.begin(), words.end(), [](std::uint16_t ms) { return ms == 0; });
  const int command = reg::axis_command::command.address() - address;
  return address >= groups::axis_command.base && command >= 0 && command < static_cast<int>(words.size()) &&
         words[static_cast<std::size_t>(command)] == protocol::kStop;
}

tl::expected<void, LinkError> ForeignTransport::move_fits(std::span<const std::uint16_t> block) const {
  if (block.size() <= reg::axis_command::command.offset || block[reg::axis_command::command.offset] != protocol::kMove)
    return {};
  const double deg =
      static_cast<double>(protocol::join_turns(protocol::get_s32(&block[reg::axis_command::goal_angle.offset]),
                                               protocol::get_s32(&block[reg::axis_command::goal_turns.offset]))) /
      kUdeg_per_deg;
  if (move_count(machine_, DriveWrite::What::target, deg * steps_per_deg(machine_))) return {};
  return tl::unexpected(LinkError{Kind::refused, 0,
                                  "a target of " + number(deg) + " deg is beyond what the drive " +
                                      machine_.drive.name + " counts to; home again to begin at 0",
                                  false});
}

tl::expected<void, LinkError> ForeignTransport::write_holding(std::uint16_t address,
                                                              std::span<const std::uint16_t> words) {
  const bool to_axis = address >= groups::axis_command.base;
  const bool clears = address == reg::control::clear_fault.address();
  if (address == groups::axis_command.base) {
    if (auto fits = move_fits(words); !fits) return fits;
  }
  auto seen = plant_.observe_inputs();
  if (seen && clears) {
    plant_.reset_alarm();
    seen = plant_.carry_out();
  }
  if (seen && (to_axis || clears)) seen = plant_.observe_drive();
  if (!seen && !only_makes_safer(address, words)) return seen;
  const Exception written =
      core_->write_holding(plant_.now_us(), address, static_cast<std::uint16_t>(words.size()), words.data());
  if (auto done = plant_.carry_out(); !done) return done;
  return answer(written);
}

tl::expected<void, LinkError> ForeignTransport::reconnect() {
  auto io = io_->reconnect();
  auto drive = drive_->reconnect();
  return io ? drive : io;
}

std::string ForeignTransport::warning() const {
  std::string text = "the drive " + machine_.drive.name +
                     " does not stamp its positions: the angle's uncertainty holds the time of the exchanges that "
                     "bring them";
  if (machine_.homes_at_mark) text += "; homing takes the place where the table stands for 0, without an index";
  for (const Transport* link : {drive_.get(), io_.get()}) {
    if (const std::string own = link->warning(); !own.empty()) text += "; " + own;
  }
  return text;
}

}  // namespace

tl::expected<std::unique_ptr<Transport>, DeviceError> open_foreign_machine(const ForeignMachine& machine,
                                                                           std::unique_ptr<Transport> drive,
                                                                           std::unique_ptr<Transport> io,
                                                                           Clock& clock) {
  const std::string url = drive->url();
  if (auto refused = unfit(machine))
    return tl::unexpected(DeviceError{Kind::refused, "open", url, std::move(refused->cause),
                                      "its state unknown and untouched", std::move(refused->remedy)});
  auto transport = std::make_unique<ForeignTransport>(machine, std::move(drive), std::move(io), clock);
  if (auto started = transport->start(); !started)
    return tl::unexpected(DeviceError{started.error().kind, "open", url, std::move(started.error().cause),
                                      "its outputs off as far as they could be reached", ""});
  return transport;
}

}  // namespace celadon
