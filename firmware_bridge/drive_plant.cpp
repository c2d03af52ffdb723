#include "firmware_bridge/drive_plant.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

namespace celadon {
namespace {

using What = DriveWrite::What;

constexpr std::uint64_t kReadyLimit_us = 1'500'000;   // from the enable to ready
constexpr std::uint64_t kStartLimit_us = 300'000;     // from the command to the first step
constexpr std::uint64_t kSettleLimit_us = 2'000'000;  // from the last step to "in position"
constexpr std::int64_t kOnMark_steps = 2;

std::vector<RegisterBlock> polled_blocks(const DriveProfile& p) {
  return blocks_of(p.registers, polled_registers(p));
}
std::vector<RegisterBlock> polled_blocks(const IoProfile& p) {
  return blocks_of(p.registers, polled_registers(p));
}

tl::expected<void, LinkError> read_block(Transport& from, const RegisterBlock& block, std::span<std::uint16_t> words) {
  return block.area == protocol::Area::input ? from.read_inputs(block.address, words)
                                             : from.read_holding(block.address, words);
}

void take_counts(const std::vector<DriveRegister>& registers, WordOrder order, const RegisterBlock& block,
                 std::span<const std::uint16_t> words, std::vector<std::int64_t>& counts) {
  for (const std::size_t i : block.registers) {
    const auto at = static_cast<std::size_t>(registers[i].address - block.address);
    counts[i] = get_count(registers[i], order, words.subspan(at, static_cast<std::size_t>(registers[i].words)));
  }
}

bool meets(const DriveCondition& condition, std::int64_t count) {
  return (static_cast<std::uint32_t>(count) & condition.mask) == condition.value;
}

}  // namespace

DrivePlant::DrivePlant(const ForeignMachine& machine, Transport& drive, Transport& io, Clock& clock)
    : machine_(machine),
      drive_(drive),
      io_(io),
      clock_(clock),
      start_ns_(clock.now_ns()),
      steps_per_turn_(machine.steps_per_turn > 0 ? machine.steps_per_turn : machine.drive.steps_per_turn),
      udeg_per_step_(static_cast<double>(protocol::kTurn_udeg) / (steps_per_turn_ * machine.motor_turns_per_turn)),
      drive_blocks_(polled_blocks(machine_.drive)),
      io_blocks_(polled_blocks(machine_.io)),
      counts_(machine_.drive.registers.size()),
      io_counts_(machine_.io.registers.size()) {}

// What a drive answers is its own and no refusal of the core's; damage that it noticed is damage.
tl::expected<void, LinkError> DrivePlant::exchanged(tl::expected<void, LinkError> result) const {
  if (result || result.error().kind != DeviceError::Kind::refused) return result;
  LinkError& error = result.error();
  if (machine_.drive.crc_exception != 0 && error.code == machine_.drive.crc_exception) {
    error.kind = DeviceError::Kind::broken_reply;
    error.cause = "a request reached the drive damaged: it answered exception " + std::to_string(error.code) +
                  ", which stands for a wrong CRC there";
    error.retry_may_help = true;
  } else {
    error.cause = "the drive " + machine_.drive.name + " refused it: " + error.cause;
  }
  error.code = 0;
  return result;
}

bool DrivePlant::holds(const DriveCondition& condition) const {
  return meets(condition, counts_[condition.reg]);
}

bool DrivePlant::holds_input(const DriveCondition& condition) const {
  return meets(condition, io_counts_[condition.reg]);
}

std::uint32_t DrivePlant::outputs_now() const {
  std::uint32_t word = 0;
  for (std::size_t i = 0; i < machine_.io.lasers.size(); ++i) {
    if (lasers_ >> i & 1) word |= machine_.io.lasers[i];
  }
  if (motor_enabled_) word |= machine_.io.motor_enable;
  const auto now = static_cast<std::uint64_t>((clock_.now_ns() - start_ns_) / 1000);
  if (protocol::lamp_lit(lamp_, now)) word |= machine_.io.lamp;
  return word;
}

tl::expected<void, LinkError> DrivePlant::write_outputs() {
  const std::uint32_t word = outputs_now();
  const DriveRegister& r = machine_.io.registers[machine_.io.outputs];
  std::array<std::uint16_t, 2> words{};
  const std::span<std::uint16_t> span(words.data(), static_cast<std::size_t>(r.words));
  put_count(r, machine_.io.word_order, word, span);
  outputs_written_.reset();
  if (auto written = io_.write_holding(r.address, span); !written) return written;
  outputs_written_ = word;
  return {};
}

tl::expected<void, LinkError> DrivePlant::observe_inputs() {
  if (auto written = write_outputs(); !written) return written;
  std::array<std::uint16_t, 128> words{};
  for (const RegisterBlock& block : io_blocks_) {
    const std::span<std::uint16_t> part(words.data(), block.words);
    if (auto read = read_block(io_, block, part); !read) return read;
    take_counts(machine_.io.registers, machine_.io.word_order, block, part, io_counts_);
  }
  return {};
}

tl::expected<void, LinkError> DrivePlant::observe_drive() {
  const DriveProfile& profile = machine_.drive;
  std::array<std::uint16_t, 128> words{};
  std::int64_t taken_ns = clock_.now_ns();
  for (const RegisterBlock& block : drive_blocks_) {
    const std::span<std::uint16_t> part(words.data(), block.words);
    const std::int64_t before_ns = clock_.now_ns();
    if (auto read = exchanged(read_block(drive_, block, part)); !read) return read;
    const std::int64_t after_ns = clock_.now_ns();
    take_counts(profile.registers, profile.word_order, block, part, counts_);
    const auto& held = block.registers;
    if (std::find(held.begin(), held.end(), profile.position) != held.end())
      taken_ns = before_ns + (after_ns - before_ns) / 2;
  }
  sample_.time_us = static_cast<std::uint64_t>((taken_ns - start_ns_) / 1000);
  ++sample_.counter;
  const double steps = quantity_of(profile.registers[profile.position], count(profile.position), steps_per_turn_);
  const double steps_per_s = quantity_of(profile.registers[profile.speed], count(profile.speed), steps_per_turn_);
  sample_.position_udeg = std::llround(steps * udeg_per_step());
  sample_.speed_udeg_per_s =
      static_cast<std::int32_t>(std::clamp(std::round(steps_per_s * udeg_per_step()), -2147483647.0, 2147483647.0));
  follow_motion(now_us());
  sample_.fault = lost_ ? FaultCode::drive_fault : FaultCode::none;
  sample_.fault_detail = 0;
  if (holds(profile.fault)) {
    const auto code = static_cast<std::uint32_t>(count(profile.alarm));
    const auto known = std::find_if(profile.alarms.begin(), profile.alarms.end(),
                                    [code](const DriveAlarm& alarm) { return alarm.code == code; });
    sample_.fault = known != profile.alarms.end() ? known->fault : FaultCode::drive_fault;
    sample_.fault_detail = static_cast<std::uint16_t>(code);
  }
  return {};
}

void DrivePlant::follow_motion(std::uint64_t now) {
  const DriveProfile& profile = machine_.drive;
  const bool moving = holds(profile.moving);
  const auto stage = [&](Motion next) {
    motion_ = next;
    motion_since_us_ = now;
  };
  const std::uint64_t since_us = now - motion_since_us_;
  if (motion_ == Motion::wanted && since_us > kReadyLimit_us) {
    lost_ = true;
    stage(Motion::none);
  }
  if (motion_ == Motion::sent) {
    const bool there = !homing_ && count(profile.position) == values_.target;
    if (moving) {
      stage(Motion::running);
    } else if (there || since_us > kStartLimit_us) {
      stage(Motion::settling);
    }
  }
  if (motion_ == Motion::running && !moving) stage(Motion::settling);
  if (motion_ == Motion::settling) {
    const bool settled = !profile.in_position || holds(*profile.in_position) || !motor_enabled_;
    if (settled || now - motion_since_us_ > kSettleLimit_us) stage(Motion::none);
  }
  // A motor without torque has lost its way, whatever else the drive says.
  if (motion_ == Motion::running && profile.enabled && !holds(*profile.enabled)) lost_ = true;
  if (motion_ == Motion::none && homing_) {
    homing_ = false;
    sample_.index_found =
        machine_.homes_at_mark ? std::abs(count(profile.position)) <= kOnMark_steps : holds(profile.homed);
  }
  const bool at_rest = motion_ == Motion::none && !moving;
  sample_.phase = at_rest ? AxisPhase::standing : motion_ == Motion::settling ? AxisPhase::settling : AxisPhase::moving;
}

// Values whose registers follow each other leave in one request: drives take a block as one command.
tl::expected<void, LinkError> DrivePlant::run(const DriveAction& action) {
  const DriveProfile& profile = machine_.drive;
  std::array<std::uint16_t, 128> words{};
  for (std::size_t i = 0; i < action.size();) {
    const std::uint16_t first = profile.registers[action[i].reg].address;
    std::size_t used = 0;
    do {
      const DriveRegister& r = profile.registers[action[i].reg];
      const std::int64_t value = action[i].what == What::target         ? values_.target
                                 : action[i].what == What::speed        ? values_.speed
                                 : action[i].what == What::acceleration ? values_.acceleration
                                                                        : action[i].constant;
      const auto size = static_cast<std::size_t>(r.words);
      put_count(r, profile.word_order, value, std::span(words).subspan(used, size));
      used += size;
      ++i;
    } while (i < action.size() && profile.registers[action[i].reg].address == first + used && used + 2 <= words.size());
    if (auto done = exchanged(drive_.write_holding(first, std::span(words).first(used))); !done) return done;
  }
  return {};
}

tl::expected<void, LinkError> DrivePlant::carry_out() {
  const DriveProfile& profile = machine_.drive;
  if (release_wanted_) motor_enabled_ = false;
  if (outputs_written_ != outputs_now()) {
    if (auto written = write_outputs(); !written) return written;
  }
  if (stop_wanted_) {
    if (auto done = run(profile.stop); !done) {
      // A drive that cannot be told to stop loses its torque instead.
      if (machine_.io.motor_enable != 0 && motion_ != Motion::none) lost_ = true;
      motor_enabled_ = enable_sent_ = false;
      (void)write_outputs();
      return done;
    }
    stop_wanted_ = false;
  }
  if (release_wanted_) {
    if (auto done = run(profile.release); !done) return done;
    release_wanted_ = false;
  }
  if (reset_wanted_) {
    if (auto done = run(profile.reset); !done) return done;
    reset_wanted_ = false;
  }
  return motion_ == Motion::wanted ? begin_motion() : tl::expected<void, LinkError>{};
}

tl::expected<void, LinkError> DrivePlant::begin_motion() {
  const DriveProfile& profile = machine_.drive;
  if (!enable_sent_) {
    motor_enabled_ = true;
    if (auto written = write_outputs(); !written) return written;
    if (auto done = run(profile.enable); !done) return done;
    enable_sent_ = true;
  }
  if (profile.ready && !holds(*profile.ready)) return {};
  const DriveAction& action = !homing_ ? profile.move : machine_.homes_at_mark ? profile.mark : profile.home;
  if (auto done = run(action); !done) return done;
  motion_ = Motion::sent;
  motion_since_us_ = now_us();
  return {};
}

tl::expected<double, LinkError> DrivePlant::read_time_ms(const DriveRegister& r, WordOrder order, Transport& from) {
  std::array<std::uint16_t, 2> words{};
  const std::span<std::uint16_t> part(words.data(), static_cast<std::size_t>(r.words));
  auto read = read_block(from, {r.area, r.address, static_cast<std::uint16_t>(r.words), {}}, part);
  if (!read) return tl::unexpected(std::move(read.error()));
  return quantity_of(r, get_count(r, order, part), steps_per_turn_);
}

void DrivePlant::reset_alarm() {
  reset_wanted_ = true;
  lost_ = false;
}

std::string DrivePlant::alarm_text(std::uint16_t code) const {
  if (code == 0) return {};
  char number[16];
  std::snprintf(number, sizeof number, "0x%02X", unsigned{code});
  const auto& alarms = machine_.drive.alarms;
  const auto known = std::find_if(alarms.begin(), alarms.end(), [code](const DriveAlarm& a) { return a.code == code; });
  return "alarm " + std::string(number) + " of the drive " + machine_.drive.name + ", " +
         (known != alarms.end() ? known->text : "which its profile does not know");
}

PlantInputs DrivePlant::inputs(std::uint64_t) {
  const IoProfile& io = machine_.io;
  PlantInputs in;
  in.interlock_closed = holds_input(io.interlock_closed);
  in.emergency_stop = holds_input(io.emergency_stop);
  in.button = holds_input(io.button);
  in.remote_enabled = !io.remote_enabled || holds_input(*io.remote_enabled);
  in.lasers_measured = io.laser_emits.empty() ? lasers_ : std::uint16_t{0};
  for (std::size_t i = 0; i < io.laser_emits.size(); ++i) {
    if (holds_input(io.laser_emits[i])) in.lasers_measured = static_cast<std::uint16_t>(in.lasers_measured | 1u << i);
  }
  return in;
}

AxisSample DrivePlant::axis(int, std::uint64_t) {
  return sample_;
}

void DrivePlant::home(int, std::uint64_t now) {
  homing_ = true;
  enable_sent_ = release_wanted_ = stop_wanted_ = false;
  motion_ = Motion::wanted;
  motion_since_us_ = now;
  sample_.index_found = false;
  sample_.phase = AxisPhase::moving;
}

void DrivePlant::move(int, std::int64_t target_udeg, std::uint32_t speed_udeg_per_s,
                      std::uint32_t acceleration_udeg_per_s2, std::uint32_t /*jerk_mdeg_per_s3*/, std::uint64_t now) {
  const DriveProfile& profile = machine_.drive;
  const double step_udeg = std::abs(udeg_per_step());
  // In range: the transport asked before the core took the command.
  const auto counts = [&](What what, double quantity) {
    for (const DriveWrite& write : profile.move) {
      if (write.what == what) return count_of(profile.registers[write.reg], quantity, steps_per_turn_).value_or(0);
    }
    return std::int64_t{0};
  };
  values_.target = counts(What::target, static_cast<double>(target_udeg) / udeg_per_step());
  values_.speed = counts(What::speed, speed_udeg_per_s / step_udeg);
  values_.acceleration = counts(What::acceleration, acceleration_udeg_per_s2 / step_udeg);
  homing_ = false;
  stop_wanted_ = false;
  motion_ = Motion::wanted;
  motion_since_us_ = now;
  sample_.phase = AxisPhase::moving;
}

void DrivePlant::stop(int, std::uint64_t) {
  stop_wanted_ = true;
  if (motion_ == Motion::wanted) motion_ = Motion::none;
}

void DrivePlant::release(int, std::uint64_t) {
  release_wanted_ = true;
  enable_sent_ = false;
  if (motion_ == Motion::wanted) motion_ = Motion::none;
}

void DrivePlant::set_lasers(std::uint16_t mask, std::uint64_t) {
  lasers_ = mask;
}

void DrivePlant::set_lamp(LampPattern pattern, std::uint64_t) {
  lamp_ = pattern;
}

}  // namespace celadon
