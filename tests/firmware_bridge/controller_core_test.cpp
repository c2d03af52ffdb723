#include "firmware_bridge/controller_core.h"

#include <gtest/gtest.h>

#include "tests/firmware_bridge/core_bench.h"

namespace celadon::test {
namespace {

using protocol::Exception;
namespace reg = protocol::reg;

// ---- lease ----

TEST(Lease, EndsInDeviceTimeAtItsVeryEnd) {
  CoreBench b;
  b.advance_ms(123);
  ASSERT_EQ(b.grant(0, 500), Exception::none);
  EXPECT_EQ(b.plant.lasers, 1);
  b.advance_to(122'999 + 500'000);
  EXPECT_EQ(b.plant.lasers, 1);
  b.advance_to(123'000 + 500'000);
  EXPECT_EQ(b.plant.lasers, 0);
  EXPECT_EQ(b.plant.laser_log.back().first, 623'000u);
  EXPECT_EQ(b.poll()[reg::status::lease_expiries.address()], 1);
}

TEST(Lease, IsRenewedShortenedAndEndedByWrites) {
  CoreBench b;
  b.grant(0, 500);
  b.advance_ms(400);
  b.grant(0, 300);
  EXPECT_EQ(b.core.lease_left_ms(0), 300);
  b.advance_ms(299);
  EXPECT_EQ(b.plant.lasers, 1);
  EXPECT_EQ(b.poll()[reg::status::lease_left.address()], 1);
  b.grant(0, 10);
  b.advance_ms(10);
  EXPECT_EQ(b.plant.lasers, 0);
  b.grant(1, 500);
  EXPECT_EQ(b.plant.lasers, 2);
  b.grant(1, 0);
  EXPECT_EQ(b.plant.lasers, 0);
  EXPECT_EQ(b.poll()[reg::status::lease_expiries.address()], 1);  // ending is no expiry
}

TEST(Lease, CountsEachLaserForItself) {
  CoreBench b;
  ASSERT_EQ(b.write(reg::control::laser_lease.address(), {100, 300}), Exception::none);
  EXPECT_EQ(b.plant.lasers, 3);
  b.advance_ms(100);
  EXPECT_EQ(b.plant.lasers, 2);
  b.advance_ms(200);
  EXPECT_EQ(b.plant.lasers, 0);
}

TEST(Lease, IsGrantedAtMostForItsMaximumAndOnlyForLasersThatAre) {
  CoreBench b;
  EXPECT_EQ(b.grant(0, 501), Exception::illegal_value);
  EXPECT_EQ(b.grant(2, 100), Exception::illegal_address);
  EXPECT_EQ(b.write(reg::control::laser_lease.address(), {100, 501}), Exception::illegal_value);
  EXPECT_EQ(b.plant.lasers, 0);  // all of a write or nothing
}

TEST(Lease, CannotBeRenewedOnceItRanOutUnseen) {
  CoreBench b;
  b.grant(0, 200);
  b.now_us += 5'000'000;  // no step in between
  b.plant.interlock_closed = false;
  EXPECT_EQ(b.grant(0, 200), Exception::refused);
  EXPECT_EQ(b.plant.lasers, 0);
}

// ---- interlock, emergency stop, laser that does not go dark ----

TEST(Interlock, DropsLaserAndMotionAndDoesNotComeBackByItself) {
  CoreBench b;
  b.home_and_wait();
  ASSERT_EQ(b.command(protocol::kMove, 350'000'000), Exception::none);
  b.advance_ms(500);
  b.grant(0, 500);
  b.plant.interlock_closed = false;
  b.core.step(b.now_us);
  EXPECT_EQ(b.plant.lasers, 0);
  EXPECT_EQ(b.plant.stops, 2);  // one at start, one now
  EXPECT_EQ(b.core.motion(0), MotionState::stopped);
  EXPECT_EQ(b.core.fault(), FaultCode::interlock_opened);

  b.plant.interlock_closed = true;
  b.advance_polling_ms(3000);
  EXPECT_EQ(b.plant.lasers, 0);
  EXPECT_EQ(b.core.motion(0), MotionState::stopped);
  EXPECT_EQ(b.grant(0, 500), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::local_action_needed);
  EXPECT_EQ(b.home(), Exception::refused);
  EXPECT_EQ(b.clear_fault(), Exception::refused);
  EXPECT_EQ(b.plant.lamp, LampPattern::attention);

  b.press_button();
  EXPECT_EQ(b.core.motion(0), MotionState::standstill);  // an orderly stop keeps the reference
  EXPECT_EQ(b.core.fault(), FaultCode::none);
  EXPECT_EQ(b.plant.lasers, 0);
  EXPECT_EQ(b.plant.speed_udeg(b.now_us), 0);
  EXPECT_EQ(b.core.button_presses(), 1);
  EXPECT_EQ(b.grant(0, 500), Exception::none);
}

TEST(Interlock, PressCountsForNothingWhileItIsOpen) {
  CoreBench b;
  b.home_and_wait();
  b.command(protocol::kMove, 90'000'000);
  b.plant.interlock_closed = false;
  b.advance_ms(1000);
  b.press_button();
  EXPECT_EQ(b.core.motion(0), MotionState::stopped);
  EXPECT_EQ(b.core.fault(), FaultCode::interlock_opened);
  b.plant.interlock_closed = true;
  b.advance_ms(10);
  EXPECT_TRUE(b.core.local_action_needed());
}

TEST(Interlock, OpenedAtRestNeedsAPressButLeavesTheState) {
  CoreBench b;
  b.home_and_wait();
  b.plant.interlock_closed = false;
  b.advance_ms(10);
  b.plant.interlock_closed = true;
  b.advance_ms(10);
  EXPECT_EQ(b.core.motion(0), MotionState::standstill);
  EXPECT_EQ(b.core.fault(), FaultCode::none);
  EXPECT_EQ(b.command(protocol::kMove, 1), Exception::refused);
  b.press_button();
  EXPECT_EQ(b.command(protocol::kMove, 1), Exception::none);
}

TEST(EmergencyStop, LosesTheReferenceAndAsksForAPress) {
  CoreBench b;
  b.home_and_wait();
  b.grant(0, 500);
  b.plant.emergency_stop = true;
  b.core.step(b.now_us);
  EXPECT_EQ(b.plant.lasers, 0);
  EXPECT_EQ(b.plant.releases, 1);
  EXPECT_EQ(b.core.motion(0), MotionState::stopped);
  EXPECT_EQ(b.plant.lamp, LampPattern::fault);
  b.advance_ms(1000);
  EXPECT_EQ(b.plant.releases, 1);
  EXPECT_EQ(b.home(), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::emergency_stop);
  b.plant.emergency_stop = false;
  b.advance_ms(1000);
  EXPECT_EQ(b.home(), Exception::refused);
  b.press_button();
  EXPECT_EQ(b.core.motion(0), MotionState::unhomed);
  EXPECT_EQ(b.command(protocol::kMove, 1), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::unhomed);
  EXPECT_EQ(b.home(), Exception::none);
}

TEST(EmergencyStop, TakesTheTorqueAlsoFromAMachineInFault) {
  CoreBench b;
  b.home_and_wait();
  b.command(protocol::kMove, 350'000'000);
  b.advance_ms(500);
  b.plant.input_fault = FaultCode::laser_driver_fault;
  b.core.step(b.now_us);
  EXPECT_EQ(b.core.motion(0), MotionState::fault);
  EXPECT_GT(b.plant.speed_udeg(b.now_us), 0);
  b.plant.emergency_stop = true;
  b.core.step(b.now_us);
  EXPECT_EQ(b.plant.releases, 1);
  EXPECT_EQ(b.core.motion(0), MotionState::fault);
  EXPECT_EQ(b.core.fault(), FaultCode::laser_driver_fault);
}

TEST(StuckLaser, IsAFaultAfterItsLimitAndStaysOneWhileItEmits) {
  CoreBench b;
  b.grant(0, 300);
  b.plant.stuck_lasers = 1;
  b.advance_ms(300 + 99);
  EXPECT_EQ(b.core.fault(), FaultCode::none);
  b.advance_ms(1);
  EXPECT_EQ(b.core.fault(), FaultCode::laser_stuck_on);
  EXPECT_EQ(b.core.motion(0), MotionState::fault);
  EXPECT_EQ(b.clear_fault(), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::cause_persists);
  b.plant.stuck_lasers = 0;
  EXPECT_EQ(b.clear_fault(), Exception::none);
  EXPECT_EQ(b.core.motion(0), MotionState::unhomed);
}

// ---- heartbeat ----

TEST(Heartbeat, LostInMotionStopsTheMotorAndTheLaser) {
  ControllerConfig config = test_config();
  config.lease_max_ms = 5000;
  CoreBench b(config);
  b.home_and_wait();
  b.command(protocol::kMove, 10 * 360'000'000ll);
  b.grant(0, 5000);
  const std::uint64_t last_sign_us = b.now_us;
  b.advance_to(last_sign_us + 999'999);
  EXPECT_EQ(b.core.motion(0), MotionState::moving);
  EXPECT_EQ(b.plant.lasers, 1);
  b.advance_to(last_sign_us + 1'000'000);
  EXPECT_EQ(b.core.motion(0), MotionState::stopped);
  EXPECT_EQ(b.plant.lasers, 0);
  EXPECT_EQ(b.core.fault(), FaultCode::heartbeat_lost);
  b.advance_ms(1000);
  EXPECT_EQ(b.plant.speed_udeg(b.now_us), 0);

  // The host's return restarts nothing; a move is refused until it releases the machine.
  b.advance_polling_ms(1000);
  EXPECT_EQ(b.core.motion(0), MotionState::stopped);
  EXPECT_EQ(b.command(protocol::kMove, 0), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::stopped);
  EXPECT_EQ(b.clear_fault(), Exception::none);
  EXPECT_EQ(b.core.motion(0), MotionState::standstill);
}

TEST(Heartbeat, LostAtRestChangesOnlyTheLamp) {
  CoreBench b;
  b.home_and_wait();
  b.write(reg::control::lamp_pattern.address(), {1});
  EXPECT_EQ(b.plant.lamp, LampPattern::ready);
  b.advance_ms(60'000);
  EXPECT_EQ(b.core.motion(0), MotionState::standstill);
  EXPECT_EQ(b.core.fault(), FaultCode::none);
  EXPECT_EQ(b.plant.lamp, LampPattern::off);
  b.poll();
  EXPECT_EQ(b.plant.lamp, LampPattern::ready);
}

TEST(Heartbeat, IsNotFedByAMonitor) {
  CoreBench b;
  b.home();
  std::uint16_t words[40];
  for (int i = 0; i < 20; ++i) {
    b.advance_ms(100);
    EXPECT_EQ(b.core.read_input(b.now_us, 1, 40, words), Exception::none);
  }
  EXPECT_EQ(b.core.motion(0), MotionState::stopped);
}

// ---- states ----

TEST(Motion, HomesMovesSettlesAndStands) {
  CoreBench b;
  EXPECT_EQ(b.core.motion(0), MotionState::unhomed);
  EXPECT_EQ(b.home(), Exception::none);
  EXPECT_EQ(b.core.motion(0), MotionState::homing);
  b.advance_polling_ms(6000);
  EXPECT_EQ(b.core.motion(0), MotionState::standstill);
  EXPECT_EQ(b.poll()[reg::axis_status::axis_flags.address()], protocol::kHomed);

  // 180 degrees at 90 degrees/s and 90 degrees/s2: 1 s up, 1 s cruise, 1 s down; then 50 ms of settling.
  const std::uint64_t start_us = b.now_us;
  EXPECT_EQ(b.command(protocol::kMove, -180'000'000), Exception::none);
  for (int i = 0; i < 15; ++i) b.advance_polling_ms(100);
  const auto words = b.poll();
  EXPECT_EQ(protocol::get_s32(&words[reg::axis_status::turns.address()]), -1);
  EXPECT_EQ(protocol::get_s32(&words[reg::axis_status::angle.address()]), 270'000'000);
  EXPECT_EQ(protocol::get_s32(&words[reg::axis_status::speed.address()]), -90'000'000);
  EXPECT_EQ(protocol::get_u64(&words[reg::axis_status::position_time.address()]), start_us + 1'500'000);
  b.advance_polling_ms(1520);
  EXPECT_EQ(b.core.motion(0), MotionState::settling);
  b.advance_polling_ms(40);
  EXPECT_EQ(b.core.motion(0), MotionState::standstill);
}

TEST(Motion, StopKeepsTheReferenceButNotWhileHoming) {
  CoreBench b;
  b.home();
  b.advance_ms(500);
  EXPECT_EQ(b.command(protocol::kStop), Exception::none);
  b.advance_polling_ms(2000);
  EXPECT_EQ(b.core.motion(0), MotionState::unhomed);
  b.home_and_wait();
  b.command(protocol::kMove, 360'000'000);
  b.advance_ms(500);
  EXPECT_EQ(b.make_safe(), Exception::none);
  b.advance_ms(100);
  EXPECT_EQ(b.core.motion(0), MotionState::moving);  // decelerating
  b.advance_polling_ms(2000);
  EXPECT_EQ(b.core.motion(0), MotionState::standstill);
  EXPECT_EQ(b.core.fault(), FaultCode::none);
}

TEST(Motion, HomingWithoutIndexIsAFault) {
  CoreBench b;
  b.plant.index_exists = false;
  b.home_and_wait();
  EXPECT_EQ(b.core.motion(0), MotionState::fault);
  EXPECT_EQ(b.core.fault(), FaultCode::homing_failed);
  EXPECT_EQ(b.home(), Exception::refused);
  EXPECT_EQ(b.clear_fault(), Exception::none);
  b.plant.index_exists = true;
  b.home_and_wait();
  EXPECT_EQ(b.core.motion(0), MotionState::standstill);
}

TEST(Motion, FirstFaultIsTheOneReported) {
  CoreBench b;
  b.home();
  b.grant(0, 500);
  b.plant.axis_fault = FaultCode::motor_stalled;
  b.advance_ms(10);
  b.plant.input_fault = FaultCode::laser_driver_fault;
  b.advance_ms(10);
  EXPECT_EQ(b.core.fault(), FaultCode::motor_stalled);
  EXPECT_EQ(b.plant.lasers, 0);
  EXPECT_EQ(b.plant.releases, 1);
  b.plant.axis_fault = FaultCode::none;
  EXPECT_EQ(b.clear_fault(), Exception::refused);
  b.plant.input_fault = FaultCode::none;
  EXPECT_EQ(b.clear_fault(), Exception::none);
}

TEST(Motion, RepeatedSequenceIsAcknowledgedAndNotExecuted) {
  CoreBench b;
  b.home_and_wait();
  EXPECT_EQ(b.command(protocol::kMove, 90'000'000, 90'000'000, 17), Exception::none);
  EXPECT_EQ(b.command(protocol::kMove, 90'000'000, 90'000'000, 17), Exception::none);
  EXPECT_EQ(b.plant.moves, 1);
  b.advance_polling_ms(4000);
  EXPECT_EQ(b.command(protocol::kMove, 0, 90'000'000, 17), Exception::none);
  EXPECT_EQ(b.plant.moves, 1);
  EXPECT_EQ(b.command(protocol::kMove, 0, 90'000'000, 18), Exception::none);
  EXPECT_EQ(b.plant.moves, 2);
}

TEST(Motion, ValuesOutsideTheirRangesAreRefused) {
  CoreBench b;
  b.home_and_wait();
  EXPECT_EQ(b.command(protocol::kMove, 1, 0), Exception::illegal_value);
  EXPECT_EQ(b.command(protocol::kMove, 1, 180'000'001), Exception::illegal_value);
  EXPECT_EQ(b.command(4), Exception::illegal_value);
  EXPECT_EQ(b.command(protocol::kMove, (std::int64_t{1} << 30) * 360'000'000 + 1), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::beyond_travel);
  EXPECT_EQ(b.plant.moves, 0);

  ControllerConfig limited = test_config();
  limited.axis[0].features = protocol::kHasIndex;
  limited.axis[0].travel_min_udeg = -10'000'000;
  limited.axis[0].travel_max_udeg = 90'000'000;
  CoreBench l(limited);
  l.home_and_wait();
  EXPECT_EQ(l.command(protocol::kMove, 90'000'001), Exception::refused);
  EXPECT_EQ(l.command(protocol::kMove, -10'000'001), Exception::refused);
  EXPECT_EQ(l.command(protocol::kMove, -10'000'000), Exception::none);
}

// ---- start ----

TEST(Start, LockedMachineWaitsForAPress) {
  ControllerConfig config = test_config();
  config.locked_at_start = true;
  CoreBench b(config);
  EXPECT_EQ(b.home(), Exception::refused);
  EXPECT_EQ(b.grant(0, 100), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::local_action_needed);
  b.press_button();
  EXPECT_EQ(b.plant.homes, 0);
  EXPECT_EQ(b.home(), Exception::none);
}

TEST(Start, ResetInMotionStopsTheMotorAndResumesNothing) {
  TestPlant plant;
  plant.move(0, 3'600'000'000, 90'000'000, 90'000'000, 0, 0);
  plant.lasers = 3;
  ControllerCore core(test_config(), plant, 2, 2'000'000);
  EXPECT_EQ(plant.lasers, 0);
  core.step(3'500'000);
  EXPECT_EQ(plant.speed_udeg(3'500'000), 0);
  EXPECT_EQ(core.motion(0), MotionState::unhomed);
}

// ---- button ----

TEST(Button, BouncesAreOnePressAndGlitchesNone) {
  CoreBench b;
  for (int i = 0; i < 5; ++i) {  // 3 ms on, 3 ms off
    b.plant.button = !b.plant.button;
    b.core.step(b.now_us);
    b.advance_ms(3);
  }
  EXPECT_EQ(b.core.button_presses(), 0);
  b.advance_ms(17);
  EXPECT_EQ(b.core.button_presses(), 1);
  EXPECT_TRUE(b.flags() & protocol::kButtonDown);
  b.advance_ms(500);
  b.plant.button = false;
  b.core.step(b.now_us);
  b.advance_ms(50);
  EXPECT_EQ(b.core.button_presses(), 1);
  EXPECT_FALSE(b.flags() & protocol::kButtonDown);
  EXPECT_EQ(b.poll()[reg::status::button_held.address()], 520);
}

TEST(Button, HeldDownAtStartCountsOnlyAfterItsRelease) {
  TestPlant plant;
  plant.button = true;
  ControllerCore core(test_config(), plant, 1, 0);
  for (std::uint64_t t = 0; t < 1'000'000; t += 1000) core.step(t);
  EXPECT_EQ(core.button_presses(), 0);
  plant.button = false;
  for (std::uint64_t t = 1'000'000; t < 1'100'000; t += 1000) core.step(t);
  plant.button = true;
  for (std::uint64_t t = 1'100'000; t < 1'200'000; t += 1000) core.step(t);
  EXPECT_EQ(core.button_presses(), 1);
}

// ---- registers ----

TEST(Registers, UnmappedHalvedAndEmptyBlocksAreRefused) {
  CoreBench b;
  std::uint16_t words[125];
  EXPECT_EQ(b.core.read_input(0, 0, 48, words), Exception::none);
  EXPECT_EQ(b.core.read_input(0, 0, 49, words), Exception::illegal_address);  // axis 1 is not there
  EXPECT_EQ(b.core.read_input(0, 0, 0, words), Exception::illegal_value);
  EXPECT_EQ(b.core.read_input(0, 0, 126, words), Exception::illegal_value);
  EXPECT_EQ(b.core.read_input(0, 0xFFFF, 1, words), Exception::illegal_address);
  EXPECT_EQ(b.core.read_input(0, 0xFFFF, 2, words), Exception::illegal_address);
  EXPECT_EQ(b.core.read_input(0, 0x0100, 64 + 16 + 16, words), Exception::none);
  EXPECT_EQ(b.core.read_holding(0, 0, 16, words), Exception::none);
  EXPECT_EQ(b.core.read_holding(0, 0, 17, words), Exception::illegal_address);
  EXPECT_EQ(b.core.read_holding(0, 0x0020, 16, words), Exception::none);
  EXPECT_EQ(b.core.read_holding(0, 0x0030, 1, words), Exception::illegal_address);

  EXPECT_EQ(b.write(0x0005, {0}), Exception::illegal_address);     // reserved
  EXPECT_EQ(b.write(0x0000, {1, 1}), Exception::illegal_address);  // two commands at once
  EXPECT_EQ(b.write(0x0000, {2}), Exception::illegal_value);
  EXPECT_EQ(b.write(0x0002, {7}), Exception::illegal_value);
  EXPECT_EQ(b.write(0x0021, {0}), Exception::illegal_address);  // the low half of an angle
  EXPECT_EQ(b.write(0x0020, {0}), Exception::illegal_address);
  EXPECT_EQ(b.write(0x0020, {0, 5}), Exception::none);
  EXPECT_EQ(b.write(0x002B, {0}), Exception::illegal_address);
  EXPECT_EQ(b.write(0x0030, {0, 0}), Exception::illegal_address);
  EXPECT_EQ(b.write(0x0020, {}), Exception::illegal_value);
}

// ---- jerk ----

TEST(Jerk, GoesWithOneWriteAndOnlyWhereTheMachineTakesIt) {
  CoreBench b;
  b.home_and_wait();
  std::vector<std::uint16_t> words(13);
  protocol::put_u32(&words[4], 10'000'000);
  words[0] = 100;
  words[9] = protocol::kMove;
  protocol::put_u32(&words[11], 5000);
  EXPECT_EQ(b.write(protocol::groups::axis_command.base, words), Exception::illegal_value);
  EXPECT_EQ(b.plant.moves, 0);
  // Half of it is no value.
  words.resize(12);
  EXPECT_EQ(b.write(protocol::groups::axis_command.base, words), Exception::illegal_address);

  ControllerConfig config = test_config();
  config.axis[0].features |= protocol::kTakesJerk;
  CoreBench takes(config);
  takes.home_and_wait();
  words.resize(13);
  protocol::put_u32(&words[11], 70'000);
  EXPECT_EQ(takes.write(protocol::groups::axis_command.base, words), Exception::none);
  EXPECT_EQ(takes.plant.last_jerk, 70'000u);
  takes.advance_polling_ms(3000);
  // A host that knows no jerk gets the trapezoid it counts on.
  words.resize(10);
  words[0] = 200;
  EXPECT_EQ(takes.write(protocol::groups::axis_command.base, words), Exception::none);
  EXPECT_EQ(takes.plant.moves, 2);
  EXPECT_EQ(takes.plant.last_jerk, 0u);
}

// ---- session ----

struct SessionBench : CoreBench {
  Exception claim(std::uint16_t token) { return write(reg::control::session.address(), {token}); }
  Exception end(std::uint16_t token) { return write(reg::control::session_end.address(), {token}); }
  Exception grant_as(std::uint16_t token, std::vector<std::uint16_t> leases) {
    leases.insert(leases.begin(), token);
    return write(reg::control::lease_session.address(), leases);
  }
  Exception command_as(std::uint16_t token, std::uint16_t code) {
    std::vector<std::uint16_t> words(11);
    protocol::put_u32(&words[4], 10'000'000);
    words[0] = 100;
    words[9] = code;
    words[10] = token;
    return write(protocol::groups::axis_command.base, words);
  }
};

TEST(Session, WhatStartsSomethingCarriesTheTokenWhileOneIsHeld) {
  SessionBench b;
  EXPECT_EQ(b.claim(0), Exception::illegal_value);
  EXPECT_EQ(b.claim(7), Exception::none);
  EXPECT_EQ(b.claim(7), Exception::none);
  EXPECT_EQ(b.claim(8), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::session_held);
  EXPECT_EQ(b.home(), Exception::refused);
  EXPECT_EQ(b.command_as(8, protocol::kHome), Exception::refused);
  EXPECT_EQ(b.grant(0, 100), Exception::refused);
  EXPECT_EQ(b.grant_as(8, {100}), Exception::refused);
  EXPECT_EQ(b.plant.homes + b.plant.lasers, 0);

  EXPECT_EQ(b.command_as(7, protocol::kHome), Exception::none);
  EXPECT_EQ(b.grant_as(7, {protocol::kLeaseUnchanged, 100}), Exception::none);
  EXPECT_EQ(b.plant.lasers, 2);
  EXPECT_EQ(b.grant_as(7, {200}), Exception::none);
  EXPECT_EQ(b.plant.lasers, 3);
  EXPECT_EQ(b.grant_as(7, {protocol::kLeaseUnchanged, 0}), Exception::none);
  EXPECT_EQ(b.plant.lasers, 1);

  // What makes it safer stays everybody's.
  EXPECT_EQ(b.grant(0, 0), Exception::none);
  EXPECT_EQ(b.plant.lasers, 0);
  EXPECT_EQ(b.command(protocol::kStop), Exception::none);
  EXPECT_EQ(b.make_safe(), Exception::none);

  EXPECT_EQ(b.end(8), Exception::refused);
  EXPECT_EQ(b.end(7), Exception::none);
  EXPECT_EQ(b.claim(8), Exception::none);
}

TEST(Session, EndsWithoutItsTokenAndWithTheController) {
  SessionBench b;
  ASSERT_EQ(b.claim(7), Exception::none);
  b.advance_polling_ms(2'999);
  EXPECT_EQ(b.claim(8), Exception::refused);
  b.advance_polling_ms(2);  // polls keep nothing
  EXPECT_EQ(b.claim(8), Exception::none);
  b.advance_polling_ms(2'000);
  ASSERT_EQ(b.grant_as(8, {100}), Exception::none);  // this does
  b.advance_polling_ms(2'000);
  EXPECT_EQ(b.claim(7), Exception::refused);
  b.advance_polling_ms(2'000);
  EXPECT_EQ(b.home(), Exception::none);  // nobody holds it: no token is asked for
  SessionBench fresh;
  EXPECT_EQ(fresh.claim(7), Exception::none);
}

TEST(Session, TheTokenIsNeverRead) {
  SessionBench b;
  ASSERT_EQ(b.claim(0x5A5A), Exception::none);
  ASSERT_EQ(b.command_as(0x5A5A, protocol::kHome), Exception::none);
  ASSERT_EQ(b.grant_as(0x5A5A, {100}), Exception::none);
  std::uint16_t words[125] = {};
  for (const std::uint16_t base : std::initializer_list<std::uint16_t>{0x0000, 0x0020}) {
    ASSERT_EQ(b.core.read_holding(b.now_us, base, 16, words), Exception::none);
    for (int i = 0; i < 16; ++i) EXPECT_NE(words[i], 0x5A5A) << base + i;
  }
  ASSERT_EQ(b.core.read_input(b.now_us, 0, 48, words), Exception::none);
  for (int i = 0; i < 48; ++i) EXPECT_NE(words[i], 0x5A5A) << i;
  EXPECT_TRUE(b.flags() & protocol::kSessionHeld);
}

TEST(Registers, AnyReadIsAPieceOfTheWholeBlock) {
  CoreBench b;
  std::uint16_t whole[96], piece[96];
  ASSERT_EQ(b.core.read_input(0, 0x0100, 96, whole), Exception::none);
  for (std::uint16_t first = 0; first < 96; ++first) {
    for (std::uint16_t count = 1; first + count <= 96; ++count) {
      ASSERT_EQ(b.core.read_input(0, static_cast<std::uint16_t>(0x0100 + first), count, piece), Exception::none);
      for (int i = 0; i < count; ++i) ASSERT_EQ(piece[i], whole[first + i]);
    }
  }
  EXPECT_EQ(whole[0], 0x4345);
  EXPECT_EQ(whole[1], 0x4C41);
  EXPECT_EQ(whole[8], 'C' << 8 | 'e');
  EXPECT_EQ(whole[6], 48);
}

}  // namespace
}  // namespace celadon::test
