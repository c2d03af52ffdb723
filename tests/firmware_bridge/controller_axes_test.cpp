// The controller core with an elevation axis and a lift besides the table: what is each axis's own, and what is all
// axes'.

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <array>
#include <cstdint>
#include <utility>
#include <vector>

#include "firmware_bridge/controller_core.h"
#include "tests/firmware_bridge/core_bench.h"

namespace celadon::test {
namespace {

using protocol::Exception;
namespace reg = protocol::reg;

constexpr int kTable = 0, kElevationBlock = 1, kLiftBlock = 2;
constexpr std::array kBlocks = {kTable, kElevationBlock, kLiftBlock};
constexpr std::int64_t kMillion = 1'000'000;

Exception move(CoreBench& b, int axis, double to, std::uint16_t sequence = 0) {
  const std::int64_t unit = axis == kLiftBlock ? 1'000 : kMillion;
  return b.command(protocol::kMove, static_cast<std::int64_t>(to * static_cast<double>(unit)),
                   static_cast<std::uint32_t>(30 * unit), sequence, axis);
}

std::int64_t position(const std::vector<std::uint16_t>& words, int axis) {
  return protocol::join_turns(protocol::get_s32(&words[reg::axis_status::angle.address(axis)]),
                              protocol::get_s32(&words[reg::axis_status::turns.address(axis)]));
}

MotionState state(const std::vector<std::uint16_t>& words, int axis) {
  return static_cast<MotionState>(words[reg::axis_status::motion_state.address(axis)]);
}

TEST(Axes, CapabilitiesSayWhichBlockHoldsWhichKind) {
  CoreBench b(three_axes());
  std::vector<std::uint16_t> words(16 * 4);
  ASSERT_EQ(b.core.read_input(0, protocol::groups::capabilities.base, 64, words.data()), Exception::none);
  EXPECT_EQ(words[reg::capabilities::axes.offset], 3);
  const auto at = [&](const protocol::Register& r, int axis) {
    return &words[static_cast<std::size_t>(r.address(axis) - protocol::groups::capabilities.base)];
  };
  EXPECT_EQ(*at(reg::axis_capabilities::kind, 0), 1);
  EXPECT_EQ(*at(reg::axis_capabilities::kind, 1), 2);
  EXPECT_EQ(*at(reg::axis_capabilities::kind, 2), 3);
  EXPECT_EQ(protocol::get_s32(at(reg::axis_capabilities::travel_min, 1)), -20'000'000);
  EXPECT_EQ(protocol::get_s32(at(reg::axis_capabilities::travel_max, 2)), 160'000);
  // One block read brings all of them; the next word is nobody's.
  EXPECT_EQ(b.core.read_input(0, 0, protocol::status_words(3), std::array<std::uint16_t, 125>{}.data()),
            Exception::none);
  EXPECT_EQ(b.core.read_input(0, 0, protocol::status_words(3) + 1, std::array<std::uint16_t, 125>{}.data()),
            Exception::illegal_address);
}

TEST(Axes, EachHomesAndMovesByItself) {
  CoreBench b(three_axes());
  ASSERT_EQ(b.home(kElevationBlock), Exception::none);
  b.advance_polling_ms(200);
  auto words = b.poll();
  EXPECT_EQ(state(words, kElevationBlock), MotionState::homing);
  EXPECT_EQ(state(words, kTable), MotionState::unhomed);
  EXPECT_EQ(state(words, kLiftBlock), MotionState::unhomed);
  ASSERT_EQ(b.home(kTable), Exception::none) << "while another axis homes";
  EXPECT_EQ(move(b, kLiftBlock, 10), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::unhomed);
  b.advance_polling_ms(6000);
  ASSERT_EQ(b.home(kLiftBlock), Exception::none);
  b.advance_polling_ms(6000);
  // 40 degrees and 100 mm at 30 units a second with ramps of a third of a second, together; -7.25 mm back.
  ASSERT_EQ(move(b, kElevationBlock, 40), Exception::none);
  ASSERT_EQ(move(b, kLiftBlock, 100), Exception::none);
  EXPECT_EQ(move(b, kLiftBlock, 50), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::moving);
  b.advance_polling_ms(1000);
  words = b.poll();
  EXPECT_EQ(state(words, kTable), MotionState::standstill);
  EXPECT_NEAR(static_cast<double>(position(words, kElevationBlock)), 25e6, 1e4);  // 30 (1 - 1/6)
  EXPECT_NEAR(static_cast<double>(position(words, kLiftBlock)), 25e3, 10);
  EXPECT_EQ(protocol::get_s32(&words[reg::axis_status::speed.address(kLiftBlock)]), 30'000);
  b.advance_polling_ms(4000);
  words = b.poll();
  EXPECT_EQ(position(words, kElevationBlock), 40'000'000);
  EXPECT_EQ(position(words, kLiftBlock), 100'000);
  EXPECT_EQ(position(words, kTable), 0);
  ASSERT_EQ(move(b, kLiftBlock, -7.25), Exception::none);
  b.advance_polling_ms(6000);
  words = b.poll();
  EXPECT_EQ(position(words, kLiftBlock), -7'250);
  EXPECT_EQ(protocol::get_s32(&words[reg::axis_status::turns.address(kLiftBlock)]), -1);
  EXPECT_EQ(b.plant.motor(kTable).moves, 0);
}

TEST(Axes, TravelEndsAreEachAxissOwn) {
  CoreBench b(three_axes());
  b.home_and_wait();
  for (const auto& [axis, beyond] : {std::pair{kElevationBlock, -20.001},
                                     {kElevationBlock, 160.001},
                                     {kLiftBlock, -10.001},
                                     {kLiftBlock, 160.001}}) {
    EXPECT_EQ(move(b, axis, beyond), Exception::refused) << axis << " " << beyond;
    EXPECT_EQ(b.refusal(), Refusal::beyond_travel);
  }
  EXPECT_EQ(b.command(protocol::kMove, 5'000'000, 60'000'001, 0, kElevationBlock), Exception::illegal_value);
  EXPECT_EQ(b.command(protocol::kMove, 5'000, 60'001, 0, kLiftBlock), Exception::illegal_value);
  EXPECT_EQ(move(b, kLiftBlock, 160), Exception::none) << "the end itself";
  EXPECT_EQ(b.plant.motor(kElevationBlock).moves, 0);
}

TEST(Axes, NumbersOfCommandsAreEachAxissOwn) {
  CoreBench b(three_axes());
  b.home_and_wait();
  ASSERT_EQ(move(b, kElevationBlock, 10, 7), Exception::none);
  ASSERT_EQ(move(b, kLiftBlock, 10, 7), Exception::none) << "the same number on another axis is another command";
  EXPECT_EQ(move(b, kLiftBlock, 10, 7), Exception::none) << "a repeat";
  EXPECT_EQ(b.plant.motor(kLiftBlock).moves, 1);
  EXPECT_EQ(b.plant.motor(kElevationBlock).moves, 1);
  EXPECT_EQ(b.poll()[reg::axis_status::command_sequence.address(kLiftBlock)], 7);
}

TEST(Axes, StopIsForOneAxisAndMakeSafeForAll) {
  CoreBench b(three_axes());
  b.home_and_wait();
  for (const int axis : kBlocks) ASSERT_EQ(move(b, axis, 90), Exception::none);
  b.advance_polling_ms(500);
  ASSERT_EQ(b.command(protocol::kStop, 0, 0, 0, kLiftBlock), Exception::none);
  b.advance_polling_ms(800);
  auto words = b.poll();
  EXPECT_EQ(state(words, kLiftBlock), MotionState::standstill);
  EXPECT_EQ(state(words, kTable), MotionState::moving);
  EXPECT_EQ(state(words, kElevationBlock), MotionState::moving);
  ASSERT_EQ(move(b, kLiftBlock, 90), Exception::none);
  b.advance_polling_ms(300);
  ASSERT_EQ(b.make_safe(), Exception::none);
  b.advance_polling_ms(500);  // from 30 units a second at 90 a second, and 50 ms of settling
  for (const int axis : kBlocks) {
    EXPECT_EQ(state(b.poll(), axis), MotionState::standstill) << axis;
    EXPECT_EQ(b.plant.speed_udeg(b.now_us, axis), 0) << axis;
  }
}

// Every cause that takes motion away takes it from all axes, whichever of them moves.
TEST(Axes, HeartbeatInterlockAndEmergencyStopStopWhicheverMoves) {
  for (const int moving : kBlocks) {
    for (int cause = 0; cause < 3; ++cause) {
      SCOPED_TRACE(std::to_string(moving) + " by cause " + std::to_string(cause));
      CoreBench b(three_axes());
      b.home_and_wait();
      ASSERT_EQ(move(b, moving, 90), Exception::none);
      b.advance_polling_ms(600);
      ASSERT_NE(b.plant.speed_udeg(b.now_us, moving), 0);
      if (cause == 1) b.plant.interlock_closed = false;
      if (cause == 2) b.plant.emergency_stop = true;
      b.advance_ms(cause == 0 ? 1000 : 1);
      const FaultCode expected[] = {FaultCode::heartbeat_lost, FaultCode::interlock_opened, FaultCode::emergency_stop};
      EXPECT_EQ(b.core.fault(), expected[cause]);
      EXPECT_EQ(b.core.motion(moving), MotionState::stopped);
      b.advance_ms(400);
      EXPECT_EQ(b.plant.speed_udeg(b.now_us, moving), 0);
      if (cause == 2) {
        for (const int axis : kBlocks) {
          EXPECT_EQ(b.plant.motor(axis).releases, 1) << axis;
          EXPECT_EQ(b.poll()[reg::axis_status::axis_flags.address(axis)], 0) << "the reference is lost";
        }
      }
      EXPECT_EQ(b.grant(0, 100), Exception::refused);
    }
  }
}

TEST(Axes, AFaultOfOneIsAFaultOfAllAndSaysWhose) {
  CoreBench b(three_axes());
  b.home_and_wait();
  ASSERT_EQ(b.grant(0, 500), Exception::none);
  ASSERT_EQ(move(b, kTable, 90), Exception::none);
  b.plant.faulty_axis = kLiftBlock;
  b.plant.axis_fault = FaultCode::motor_stalled;
  b.advance_ms(1);
  EXPECT_EQ(b.plant.lasers, 0);
  auto words = b.poll();
  EXPECT_EQ(words[reg::status::fault_code.address()], 16);
  EXPECT_EQ(words[reg::status::fault_axis.address()], kLiftBlock);
  for (const int axis : kBlocks) {
    EXPECT_EQ(state(words, axis), MotionState::fault);
    EXPECT_EQ(b.plant.motor(axis).releases, 1) << axis;
  }
  EXPECT_EQ(b.clear_fault(), Exception::refused);
  EXPECT_EQ(b.refusal(), Refusal::cause_persists);
  b.plant.axis_fault = FaultCode::none;
  EXPECT_EQ(b.clear_fault(), Exception::none);
  words = b.poll();
  EXPECT_EQ(words[reg::status::fault_axis.address()], 0);
  for (const int axis : kBlocks) EXPECT_EQ(state(words, axis), MotionState::unhomed);
  // A reference that is not found is told with its axis, too.
  b.plant.index_exists = false;
  ASSERT_EQ(b.home(kElevationBlock), Exception::none);
  b.advance_polling_ms(6000);
  EXPECT_EQ(b.core.fault(), FaultCode::homing_failed);
  EXPECT_EQ(b.poll()[reg::status::fault_axis.address()], kElevationBlock);
}

TEST(Axes, ASessionHoldsThemAll) {
  CoreBench b(three_axes());
  ASSERT_EQ(b.write(reg::control::session.address(), {77}), Exception::none);
  for (const int axis : kBlocks) {
    EXPECT_EQ(b.home(axis), Exception::refused) << axis;
    EXPECT_EQ(b.refusal(), Refusal::session_held);
    EXPECT_EQ(b.command(protocol::kStop, 0, 0, 0, axis), Exception::none) << "stopping is everybody's";
  }
  EXPECT_EQ(b.plant.homes, 0);
}

/// What a host may do next.
struct Act {
  int axis = 0;
  std::uint16_t command = 0;
  int to = 0;
  int wait_ms = 0;
};

// Whatever is commanded: an axis's state changes only by what concerns it, positions stay within the travel, and
// make_safe brings all to rest.
RC_GTEST_PROP(AxesProperties, AxesDoNotDisturbEachOther, ()) {
  CoreBench b(three_axes());
  b.home_and_wait();
  const int acts = *rc::gen::inRange(1, 25);
  for (int i = 0; i < acts; ++i) {
    const Act act{*rc::gen::inRange(0, 3), *rc::gen::element<std::uint16_t>(1, 2, 2, 2, 3), *rc::gen::inRange(-40, 200),
                  *rc::gen::inRange(0, 3000)};
    const auto before = b.poll();
    const std::int64_t unit = act.axis == kLiftBlock ? 1'000 : kMillion;
    const Exception done = b.command(act.command, act.to * unit, static_cast<std::uint32_t>(30 * unit), 0, act.axis);
    const auto after = b.poll();
    for (const int axis : kBlocks) {
      if (axis != act.axis) RC_ASSERT(state(before, axis) == state(after, axis));
    }
    if (act.command == protocol::kMove && act.axis != kTable && (act.to < (act.axis == 1 ? -20 : -10) || act.to > 160))
      RC_ASSERT(done == Exception::refused);
    b.advance_polling_ms(static_cast<std::uint64_t>(act.wait_ms));
    const auto later = b.poll();
    for (const int axis : {kElevationBlock, kLiftBlock}) {
      if (state(later, axis) != MotionState::standstill) continue;  // a homing starts its count anew where it ends
      const std::int64_t one = axis == kLiftBlock ? 1'000 : kMillion;
      RC_ASSERT(position(later, axis) >= (axis == 1 ? -20 : -10) * one && position(later, axis) <= 160 * one);
    }
  }
  RC_ASSERT(b.make_safe() == Exception::none);
  b.advance_polling_ms(500);
  for (const int axis : kBlocks) {
    RC_ASSERT(b.plant.speed_udeg(b.now_us, axis) == 0);
    const MotionState now = b.core.motion(axis);
    RC_ASSERT(now == MotionState::standstill || now == MotionState::unhomed);
  }
}

}  // namespace
}  // namespace celadon::test
