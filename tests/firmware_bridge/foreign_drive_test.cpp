// Each shipped profile against its drive as simulated from the maker's map: what reaches the drive, where the table
// truly stands, what is refused, what switches off.

#include "firmware_bridge/foreign_drive.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <numbers>
#include <ostream>
#include <string>

#include "daemon/drive_profile_reader.h"
#include "firmware_bridge/scanner_device.h"
#include "tests/build_paths.h"
#include "tests/firmware_bridge/simulated_drives.h"

namespace celadon::test {
namespace {

using Kind = DeviceError::Kind;
using Link = ModbusServer::Link;
constexpr double kDeg = std::numbers::pi / 180;

struct Case {
  const char* profile;
  Link link;
  double steps_per_turn;  // of the motor, by the maker's delivery
};

void PrintTo(const Case& c, std::ostream* out) {
  *out << c.profile;
}

std::string name_of(const testing::TestParamInfo<Case>& info) {
  return std::string(info.param.profile[0] == 'o' ? "Az" : "Leadshine") +
         (info.param.link == Link::tcp ? "Tcp" : "Rtu");
}

/// As somebody with the manual at hand makes it of the shipped one: what moves is confirmed, the drive's own watchdog,
/// which was not measured, is not.
DriveProfile drive_profile(const std::string& name) {
  const std::string folder = std::string(CELADON_SOURCE_DIR) + "/firmware_bridge/profiles/";
  auto profile = read_drive_profile(folder + name + ".toml");
  EXPECT_TRUE(profile) << profile.error();
  if (!profile) return {};
  for (std::size_t i = 0; i < profile->registers.size(); ++i)
    if (i != profile->host_watchdog) profile->registers[i].confirmed = true;
  return *profile;
}

IoProfile io_profile() {
  auto profile = read_io_profile(std::string(CELADON_SOURCE_DIR) + "/tests/firmware_bridge/io_module.toml");
  EXPECT_TRUE(profile) << profile.error();
  return profile.value_or(IoProfile{});
}

class ForeignDrive : public testing::TestWithParam<Case> {
 protected:
  ForeignDrive() {
    if (is_az()) {
      az = std::make_unique<AzDrive>(world, io);
      motor = az.get();
    } else {
      leadshine = std::make_unique<LeadshineDrive>(world, io);
      motor = leadshine.get();
    }
    Registers& registers = is_az() ? static_cast<Registers&>(*az) : static_cast<Registers&>(*leadshine);
    drive_server = std::make_unique<ModbusServer>(registers, GetParam().link);
    machine.drive = drive_profile(GetParam().profile);
    machine.io = io_profile();
    machine.serial = "7";
    machine.motor_turns_per_turn = 18;
    machine.max_speed_deg_per_s = 60;
    machine.max_acceleration_deg_per_s2 = 200;
  }
  bool is_az() const { return GetParam().profile[0] == 'o'; }

  tl::expected<std::unique_ptr<ScannerDevice>, DeviceError> try_open() {
    auto drive = open_transport(drive_server->url());
    auto to_io = open_transport(io_server.url());
    if (!drive) return tl::unexpected(drive.error());
    if (!to_io) return tl::unexpected(to_io.error());
    auto transport = open_foreign_machine(machine, std::move(*drive), std::move(*to_io), clock);
    if (!transport) return tl::unexpected(transport.error());
    return ScannerDevice::open(std::move(*transport), clock);
  }
  void open() {
    auto opened = try_open();
    ASSERT_TRUE(opened) << opened.error().message();
    device = std::move(*opened);
  }
  void press() {
    set([](IoModule& module) { module.button = true; });
    poll_for_ms(100);
    set([](IoModule& module) { module.button = false; });
    poll_for_ms(100);
  }
  void poll_for_ms(int ms) {
    for (int i = 0; i < ms; i += 20) {
      const auto polled = device->poll();
      ASSERT_TRUE(polled) << polled.error().message();
      world.advance_ms(20);
    }
  }
  void open_and_home() {
    ASSERT_NO_FATAL_FAILURE(open());
    ASSERT_NO_FATAL_FAILURE(press());
    const auto homed = device->home();
    ASSERT_TRUE(homed) << homed.error().message();
  }
  template <class Change>
  void set(Change change) {
    const std::lock_guard lock(world.mutex);
    change(io);
  }
  void set_alarm(int code) {
    const std::lock_guard lock(world.mutex);
    motor->alarm = code;
  }
  /// Steps of the motor in one degree of the table, by hand.
  double steps_per_deg() const { return GetParam().steps_per_turn * 18 / 360; }

  DriveWorld world;
  WorldClock clock{world};
  IoModule io{world};
  std::unique_ptr<AzDrive> az;
  std::unique_ptr<LeadshineDrive> leadshine;
  SimulatedMotor* motor = nullptr;
  ModbusServer io_server{io, Link::tcp};
  std::unique_ptr<ModbusServer> drive_server;
  ForeignMachine machine;
  std::unique_ptr<ScannerDevice> device;
};

INSTANTIATE_TEST_SUITE_P(Profiles, ForeignDrive,
                         testing::Values(Case{"oriental-motor-az", Link::tcp, 1000},
                                         Case{"oriental-motor-az", Link::rtu, 1000},
                                         Case{"leadshine-rs", Link::tcp, 10000},
                                         Case{"leadshine-rs", Link::rtu, 10000}),
                         name_of);

TEST_P(ForeignDrive, SaysWhatItIs) {
  open();
  EXPECT_EQ(device->identity().machine, is_az() ? "Oriental Motor AZ 7" : "Leadshine RS 7");
  EXPECT_FALSE(device->identity().simulated);
  const DeviceCapabilities& c = device->capabilities();
  EXPECT_TRUE(c.stamped_by_host);
  EXPECT_TRUE(c.endless_rotation);
  EXPECT_EQ(c.lease_ms, 500);  // the I/O device's watchdog
  EXPECT_EQ(c.heartbeat_timeout_ms, 500);
  EXPECT_NEAR(c.max_speed_rad_per_s, 60 * kDeg, 1e-9);
  EXPECT_NEAR(c.encoder_resolution_rad, kDeg / steps_per_deg(), 1e-9);
  EXPECT_EQ(motor->moves + motor->homings, 0);
}

TEST_P(ForeignDrive, NothingStartsBeforeSomebodyPressed) {
  open();
  const auto early = device->home();
  ASSERT_FALSE(early);
  EXPECT_NE(early.error().message().find("press the button"), std::string::npos) << early.error().message();
  EXPECT_EQ(motor->homings, 0);
  press();
  EXPECT_EQ(device->take_button_presses(), 1);
  EXPECT_TRUE(device->home());
  EXPECT_EQ(motor->homings, 1);
}

TEST_P(ForeignDrive, HomesAndTurnsToWhereItShould) {
  open_and_home();
  EXPECT_NEAR(motor->position_now(), 0, 0.5);
  for (const double deg : {36.0, -123.456, 725.0, 725.0, 0.01}) {
    const auto there = device->rotate_to(deg * kDeg, 45 * kDeg);
    ASSERT_TRUE(there) << there.error().message();
    EXPECT_NEAR(motor->position_now() / steps_per_deg(), deg, 0.51 / steps_per_deg());
    EXPECT_NEAR(there->angle_rad / kDeg, deg, 0.51 / steps_per_deg());
    EXPECT_TRUE(there->homed);
  }
}

TEST_P(ForeignDrive, AMotorThatTurnsTheOtherWay) {
  machine.motor_turns_per_turn = -18;
  open_and_home();
  ASSERT_TRUE(device->rotate_to(30 * kDeg, 45 * kDeg));
  EXPECT_NEAR(motor->position_now(), -30 * steps_per_deg(), 0.5);
  EXPECT_NEAR(device->poll()->angle_rad / kDeg, 30, 1e-3);
}

TEST_P(ForeignDrive, SpeedAndAccelerationInTheDrivesUnits) {
  open_and_home();
  ASSERT_TRUE(device->start_sweep(90 * kDeg, 30 * kDeg));
  EXPECT_EQ(motor->moves, 1);
  EXPECT_NEAR(motor->last_target, 90 * steps_per_deg(), 1e-6);
  const double speed = 30 * steps_per_deg(), acceleration = 200 * steps_per_deg();
  // AZ counts steps a second, Leadshine whole revolutions a minute and whole milliseconds.
  EXPECT_NEAR(motor->last_speed, speed, is_az() ? 0.5 : GetParam().steps_per_turn / 60 / 2 + 1e-6);
  EXPECT_LE(motor->last_acceleration, acceleration * (1 + 1e-9));
  EXPECT_GE(motor->last_acceleration, acceleration * 0.98);
  const auto moving = device->poll();
  ASSERT_TRUE(moving);
  EXPECT_EQ(moving->motion, MotionState::moving);
}

TEST_P(ForeignDrive, WordsOnTheWire) {
  open_and_home();
  // 100.8 degrees of the table are 5.04 turns of the motor.
  ASSERT_TRUE(device->start_sweep(100.8 * kDeg, 60 * kDeg));
  if (is_az()) {
    // 5040 steps, 3000 Hz, 10000 steps/s^2, 100.0 %.
    const std::array<std::uint16_t, 16> expected = {0, 0, 0, 1, 0, 5040, 0, 3000, 0, 10000, 0, 10000, 0, 1000, 0, 1};
    EXPECT_EQ(az->direct_data, expected);
  } else {
    // 50400 steps, 180 rpm; 200 deg/s^2 are 600 rpm/s: 1667 ms to 1000 rpm at least.
    const std::array<std::uint16_t, 8> expected = {1, 0, 50400, 180, 1667, 1667, 0, 0x10};
    EXPECT_EQ(leadshine->pr0, expected);
  }
  ASSERT_TRUE(device->stop());
  ASSERT_TRUE(device->rotate_to(-1310.72 * kDeg, 60 * kDeg));
  if (is_az()) {
    // -65536
    EXPECT_EQ(az->direct_data[4], 0xFFFF);
    EXPECT_EQ(az->direct_data[5], 0x0000);
  } else {
    // -655360
    EXPECT_EQ(leadshine->pr0[1], 0xFFF6);
    EXPECT_EQ(leadshine->pr0[2], 0x0000);
  }
}

TEST_P(ForeignDrive, PositionsAreAsUncertainAsTheExchange) {
  open_and_home();
  ASSERT_TRUE(device->start_sweep(400 * kDeg, 36 * kDeg));
  for (int i = 0; i < 60; ++i) {
    world.advance_ms(17);
    const auto status = device->poll();
    ASSERT_TRUE(status) << status.error().message();
    // Somewhere within the exchange the table stood where the sample says.
    const double first = motor->position_at(static_cast<std::uint64_t>(status->host_before_ns / 1000));
    const double last = motor->position_at(static_cast<std::uint64_t>(status->host_after_ns / 1000));
    const double steps = status->angle_rad / kDeg * steps_per_deg();
    EXPECT_GE(steps, first - 1);
    EXPECT_LE(steps, last + 1);
  }
}

TEST_P(ForeignDrive, TheLaserGoesThroughTheModuleAndItsLease) {
  open_and_home();
  ASSERT_TRUE(device->renew_laser(0, 300));
  EXPECT_EQ(io.relays_now() & 1, 1);
  EXPECT_EQ(device->poll()->lasers_on, 1);
  world.advance_ms(280);
  ASSERT_TRUE(device->poll());
  EXPECT_EQ(io.relays_now() & 1, 1);
  world.advance_ms(30);
  ASSERT_TRUE(device->poll());  // polled, not renewed
  EXPECT_EQ(io.relays_now() & 1, 0);
  EXPECT_EQ(io.relays_now() & 2, 2);  // the motor keeps its torque
}

TEST_P(ForeignDrive, AHostThatDiesLeavesItDarkAndStill) {
  open_and_home();
  ASSERT_TRUE(device->start_sweep(3600 * kDeg, 36 * kDeg));
  ASSERT_TRUE(device->renew_laser(0, 500));
  world.advance_ms(520);  // nobody polls: the module's watchdog acts
  EXPECT_EQ(io.relays_now(), 0);
  const double at = motor->position_now();
  world.advance_ms(1000);
  EXPECT_EQ(motor->position_now(), at);
  // A host that only slept finds the machine stopped, not going on.
  const auto back = device->poll();
  ASSERT_TRUE(back);
  EXPECT_EQ(back->motion, MotionState::stopped);
  EXPECT_EQ(io.relays_now() & 1, 0);
}

TEST_P(ForeignDrive, AlarmsAreToldInTheMakersTerms) {
  open_and_home();
  ASSERT_TRUE(device->start_sweep(3600 * kDeg, 36 * kDeg));
  ASSERT_TRUE(device->renew_laser(0, 500));
  set_alarm(is_az() ? 0x10 : 0x20);
  const auto status = device->poll();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->fault_code, static_cast<std::uint16_t>(FaultCode::motor_stalled));
  EXPECT_NE(status->fault_text.find(is_az() ? "alarm 0x10 of the drive oriental-motor-az"
                                            : "alarm 0x20 of the drive leadshine-rs"),
            std::string::npos)
      << status->fault_text;
  EXPECT_NE(status->fault_text.find("deviates too far"), std::string::npos) << status->fault_text;
  EXPECT_EQ(io.relays_now(), 0);  // laser off, torque off
  const auto refused = device->home();
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message().find("deviates too far"), std::string::npos) << refused.error().message();

  const auto cleared = device->clear_fault();  // resets the drive's alarm, too
  ASSERT_TRUE(cleared) << cleared.error().message();
  const auto homed = device->home();
  ASSERT_TRUE(homed) << homed.error().message();
}

TEST_P(ForeignDrive, AnUnknownAlarmIsADriveFault) {
  open_and_home();
  set_alarm(0x77);
  const auto status = device->poll();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->fault_code, static_cast<std::uint16_t>(FaultCode::drive_fault));
  EXPECT_NE(status->fault_text.find("0x77"), std::string::npos) << status->fault_text;
}

TEST_P(ForeignDrive, OpeningTheCoverStopsEverything) {
  open_and_home();
  ASSERT_TRUE(device->start_sweep(3600 * kDeg, 36 * kDeg));
  ASSERT_TRUE(device->renew_laser(0, 500));
  const int stops = motor->stops;
  set([](IoModule& module) { module.interlock_closed = false; });
  const auto status = device->poll();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->motion, MotionState::stopped);
  EXPECT_EQ(io.relays_now() & 1, 0);
  EXPECT_EQ(motor->stops, stops + 1);
  EXPECT_FALSE(device->renew_laser(0, 500));
}

TEST_P(ForeignDrive, TheEmergencyStopTakesTheTorqueOff) {
  open_and_home();
  set([](IoModule& module) { module.emergency_stop = true; });
  ASSERT_TRUE(device->poll());
  EXPECT_EQ(io.relays_now(), 0);
}

TEST_P(ForeignDrive, DamagedRequestsAreRepeated) {
  open_and_home();
  if (!is_az()) {
    const auto before = device->link_quality().broken_replies;
    drive_server->mishap(Mishap::bad_crc);
    ASSERT_TRUE(device->poll());
    EXPECT_EQ(device->link_quality().broken_replies, before + 1);
    drive_server->mishap(Mishap::bad_crc, 20);
    const auto dead = device->poll();
    ASSERT_FALSE(dead);
    EXPECT_EQ(dead.error().kind, Kind::broken_reply);
    EXPECT_NE(dead.error().message().find("exception 8, which stands for a wrong CRC"), std::string::npos)
        << dead.error().message();
  } else {
    // No such habit: exception 8 is what the drive says.
    drive_server->mishap(Mishap::bad_crc, 20);
    const auto refused = device->poll();
    ASSERT_FALSE(refused);
    EXPECT_NE(refused.error().message().find("oriental-motor-az refused it"), std::string::npos)
        << refused.error().message();
  }
}

// A command whose exchange fails is not taken for carried out.
TEST_P(ForeignDrive, AMoveWhoseRequestIsLostIsSentAgain) {
  open_and_home();
  motor->busy_writes = 2;
  const auto there = device->rotate_to(20 * kDeg, 45 * kDeg);
  ASSERT_TRUE(there) << there.error().message();
  EXPECT_EQ(motor->busy_writes, 0);
  EXPECT_EQ(motor->moves, 1);
  EXPECT_NEAR(motor->position_now(), 20 * steps_per_deg(), 0.5);
  // Given up: it does not come later.
  motor->busy_writes = 3;
  EXPECT_FALSE(device->start_sweep(0, 45 * kDeg));
  (void)device->make_safe();
  poll_for_ms(3000);
  EXPECT_EQ(motor->moves, 1);
}

TEST_P(ForeignDrive, ASilentDriveIsNamedAndLosesItsTorque) {
  machine.io = io_profile();
  auto drive = open_transport(drive_server->url("timeout_ms=30"));
  auto to_io = open_transport(io_server.url());
  ASSERT_TRUE(drive && to_io);
  auto transport = open_foreign_machine(machine, std::move(*drive), std::move(*to_io), clock);
  ASSERT_TRUE(transport) << transport.error().message();
  auto opened = ScannerDevice::open(std::move(*transport), clock);
  ASSERT_TRUE(opened) << opened.error().message();
  device = std::move(*opened);
  press();
  ASSERT_TRUE(device->home());
  ASSERT_TRUE(device->start_sweep(3600 * kDeg, 36 * kDeg));
  ASSERT_TRUE(device->renew_laser(0, 500));
  drive_server->stop();
  const auto polled = device->poll();
  ASSERT_FALSE(polled);
  EXPECT_NE(polled.error().kind, Kind::refused) << polled.error().message();
  EXPECT_NE(polled.error().message().find("within 500 ms"), std::string::npos) << polled.error().message();
  (void)device->make_safe();
  EXPECT_EQ(io.relays_now() & 3, 0);  // dark, and without torque: nobody could tell the drive to stop
  drive_server->start();
}

TEST_P(ForeignDrive, ADriveThatIsNeverReadyIsAFault) {
  open();
  press();
  {
    const std::lock_guard lock(world.mutex);
    motor->dead = true;
  }
  const auto homed = device->home();
  ASSERT_FALSE(homed);
  EXPECT_EQ(homed.error().kind, Kind::fault);
  EXPECT_EQ(motor->homings, 0);
  EXPECT_EQ(io.relays_now() & 2, 0);
}

TEST_P(ForeignDrive, AnOperatorsMark) {
  machine.homes_at_mark = true;
  if (is_az()) {
    const auto refused = try_open();
    ASSERT_FALSE(refused);
    EXPECT_NE(refused.error().message().find("home it by its index"), std::string::npos) << refused.error().message();
    return;
  }
  open_and_home();
  EXPECT_EQ(motor->homings, 0);
  EXPECT_NEAR(motor->position_now(), 0, 0.5);
  ASSERT_TRUE(device->rotate_to(10 * kDeg, 45 * kDeg));
  EXPECT_NEAR(motor->position_now(), 10 * steps_per_deg(), 0.5);
}

TEST_P(ForeignDrive, WhatCannotBeSafeIsRefusedBeforeAnythingIsWritten) {
  const auto refusal = [&] {
    const auto opened = try_open();
    EXPECT_FALSE(opened);
    EXPECT_EQ(motor->moves + motor->homings + motor->stops, 0);
    return opened ? std::string() : opened.error().message();
  };
  const ForeignMachine good = machine;
  machine.io.motor_enable = 0;
  EXPECT_NE(refusal().find("has no confirmed watchdog and its enable does not go through"), std::string::npos)
      << refusal();
  machine = good;
  machine.io.host_watchdog.reset();
  EXPECT_NE(refusal().find("laser of a dead host"), std::string::npos) << refusal();
  machine = good;
  machine.drive.registers[machine.drive.position].confirmed = false;
  EXPECT_NE(refusal().find("would move by the register position, which its profile does not confirm"),
            std::string::npos)
      << refusal();
  machine = good;
  machine.io.registers[machine.io.outputs].confirmed = false;
  EXPECT_NE(refusal().find("would protect by the register outputs"), std::string::npos) << refusal();
  machine = good;
  machine.max_speed_deg_per_s = 0;
  EXPECT_NE(refusal().find("0 deg/s"), std::string::npos) << refusal();
  machine = good;
  machine.motor_turns_per_turn = 0;
  EXPECT_NE(refusal().find("gear"), std::string::npos) << refusal();
  machine = good;
  machine.drive.has_index = false;
  EXPECT_NE(refusal().find("no index"), std::string::npos) << refusal();
  machine = good;
  set([](IoModule& module) { module.watchdog_100ms = 0; });
  EXPECT_NE(refusal().find("is set to 0 ms; set it to 100 to 1000 ms"), std::string::npos) << refusal();
  set([](IoModule& module) { module.watchdog_100ms = 50; });
  EXPECT_NE(refusal().find("is set to 5000 ms"), std::string::npos) << refusal();
}

TEST_P(ForeignDrive, TargetsBeyondItsCounterAreRefusedByValue) {
  open_and_home();
  const double deg = 2147483648.0 / steps_per_deg() + 1;
  const auto refused = device->rotate_to(deg * kDeg, 45 * kDeg);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message().find("beyond what the drive"), std::string::npos) << refused.error().message();
  EXPECT_EQ(motor->moves, 0);
}

}  // namespace
}  // namespace celadon::test
