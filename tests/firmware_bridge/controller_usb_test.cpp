// The controller's side of USB on the core and a plant in closed form: requests, refusals, events, trace.

#include "firmware_bridge/controller_usb.h"

#include <gtest/gtest.h>

#include <array>
#include <numeric>
#include <vector>

#include "firmware_bridge/controller_core.h"
#include "tests/firmware_bridge/test_plant.h"

namespace celadon::test {
namespace {

namespace usb = protocol::usb;
namespace reg = protocol::reg;
using protocol::Exception;

/// Core and plant at an instant that the test moves.
class Board final : private UsbRegisters {
 public:
  explicit Board(const ControllerConfig& machine = test_config()) : config(machine) {}

  ControllerUsb usb{*this};
  TestPlant plant;
  std::uint64_t now_us = 0;
  ControllerConfig config;
  ControllerCore core{config, plant, 1, 0};

  /// Runs the millisecond loop of a firmware.
  void run_ms(int ms) {
    for (int i = 0; i < ms; ++i) {
      now_us += 1000;
      core.step(now_us);
      usb.sample();
    }
  }
  void press() {
    plant.button = true;
    run_ms(50);
    plant.button = false;
    run_ms(50);
  }
  int in(usb::Request request, std::uint16_t address, std::uint16_t bytes) {
    return usb.control_in({usb::kTypeIn, static_cast<std::uint8_t>(request), address, 0, bytes}, data.data());
  }
  int write(std::uint16_t address, const std::vector<std::uint16_t>& words) {
    std::vector<std::uint8_t> bytes(2 * words.size());
    for (std::size_t i = 0; i < words.size(); ++i) usb::put_word(&bytes[2 * i], words[i]);
    const auto count = static_cast<std::uint16_t>(bytes.size());
    return usb.control_out({usb::kTypeOut, static_cast<std::uint8_t>(usb::Request::write_holding), address, 0, count},
                           bytes.data(), count);
  }
  Exception exception() {
    EXPECT_EQ(in(usb::Request::exception, 0, 2), 2);
    return static_cast<Exception>(usb::get_word(data.data()));
  }
  std::uint16_t word(int at) const { return usb::get_word(&data[static_cast<std::size_t>(2 * at)]); }
  std::array<std::uint8_t, 2 * usb::kMaxRegisters> data{};

 private:
  Exception read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override {
    return core.read_input(now_us, address, count, words);
  }
  Exception read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override {
    return core.read_holding(now_us, address, count, words);
  }
  Exception write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override {
    return core.write_holding(now_us, address, count, words);
  }
};

TEST(ControllerUsb, ReadsBlocksAndWritesCommands) {
  Board board;
  board.run_ms(1);
  board.press();
  ASSERT_EQ(board.in(usb::Request::read_input, protocol::groups::identity.base, 2 * protocol::groups::identity.words),
            2 * protocol::groups::identity.words);
  EXPECT_EQ(board.word(0), 0x4345);  // "CELA", most significant byte first
  EXPECT_EQ(board.word(1), 0x4C41);
  ASSERT_EQ(board.write(reg::control::laser_lease.address(), {300}), 0);
  EXPECT_EQ(board.plant.lasers, 1);
  ASSERT_EQ(board.in(usb::Request::read_holding, reg::control::laser_lease.address(), 2), 2);
  EXPECT_EQ(board.word(0), 300);
  EXPECT_EQ(board.exception(), Exception::none);
}

TEST(ControllerUsb, RefusalsStallAndTellTheirException) {
  Board board;  // unlocked, not homed
  board.press();
  std::vector<std::uint16_t> move(10);
  move[5] = 1000;
  move[9] = protocol::kMove;
  EXPECT_EQ(board.write(reg::axis_command::goal_angle.address(), move), ControllerUsb::kStall);
  EXPECT_EQ(board.exception(), Exception::refused);
  ASSERT_EQ(board.in(usb::Request::read_input, reg::status::refusal.address(), 2), 2);
  EXPECT_EQ(board.word(0), static_cast<int>(Refusal::unhomed));
  EXPECT_EQ(board.exception(), Exception::none) << "of the last request";
  EXPECT_EQ(board.in(usb::Request::read_input, 0x4000, 2), ControllerUsb::kStall);
  EXPECT_EQ(board.exception(), Exception::illegal_address);
  for (const int bytes : {0, 3, 252, 65535}) {
    EXPECT_EQ(board.in(usb::Request::read_input, 0, static_cast<std::uint16_t>(bytes)), ControllerUsb::kStall);
    EXPECT_EQ(board.exception(), Exception::illegal_value) << bytes;
  }
  EXPECT_EQ(board.in(static_cast<usb::Request>(77), 0, 2), ControllerUsb::kStall);
  EXPECT_EQ(board.exception(), Exception::illegal_function);
  // Fewer data than announced: not executed.
  const std::array<std::uint8_t, 2> one{0, 1};
  EXPECT_EQ(board.usb.control_out({usb::kTypeOut, 3, reg::control::make_safe.address(), 0, 4}, one.data(), 2),
            ControllerUsb::kStall);
  EXPECT_EQ(board.usb.control_in({0xA1, 1, 0, 0, 2}, board.data.data()), ControllerUsb::kStall) << "a class request";
}

TEST(ControllerUsb, AnEventIsSentForEachChangeAndFeedsNoHeartbeat) {
  Board board;
  board.run_ms(1);
  board.press();
  std::array<std::uint8_t, usb::kEventBytes> event{};
  const auto presses = [&] {
    return usb::get_word(&event[2 * usb::offset_of(usb::kEventRegisters, reg::status::button_presses)]);
  };
  ASSERT_EQ(board.usb.take_event(event.data()), usb::kEventBytes) << "the first state";
  EXPECT_EQ(presses(), 1);
  EXPECT_EQ(board.usb.take_event(event.data()), 0);
  board.run_ms(10);
  EXPECT_EQ(board.usb.take_event(event.data()), 0) << "only the clock went on";
  board.press();
  board.press();
  ASSERT_EQ(board.usb.take_event(event.data()), usb::kEventBytes);
  EXPECT_EQ(presses(), 3) << "the newest state, none lost";
  EXPECT_EQ(board.usb.take_event(event.data()), 0);
  // Events are no sign of life of the host: the laser's heartbeat runs out.
  ASSERT_EQ(board.write(reg::control::laser_lease.address(), {500}), 0);
  for (int i = 0; i < 2000 && board.core.fault() == FaultCode::none; ++i) {
    if (i % 100 == 0) (void)board.usb.take_event(event.data());
    board.run_ms(1);
    (void)board.usb.take_event(event.data());
  }
  EXPECT_EQ(board.plant.lasers, 0);
  board.usb.reset();
  EXPECT_EQ(board.usb.take_event(event.data()), usb::kEventBytes);
}

TEST(ControllerUsb, TheTraceHoldsEverySampleOnceAndTheNewestOnes) {
  Board board;
  board.run_ms(50);
  std::vector<std::uint8_t> bytes(8192);
  const auto time_us = [&](int k) {  // its lowest word
    return usb::get_word(&bytes[static_cast<std::size_t>(k) * usb::kTraceBytes + 6]);
  };
  int got = board.usb.take_trace(bytes.data(), 10 * usb::kTraceBytes + 5) / usb::kTraceBytes;
  ASSERT_EQ(got, 10);
  const std::uint16_t last_us = time_us(9);
  for (int k = 1; k < got; ++k) EXPECT_EQ(time_us(k), time_us(k - 1) + 1000);
  got = board.usb.take_trace(bytes.data(), 8192) / usb::kTraceBytes;
  EXPECT_EQ(got, 40);
  EXPECT_EQ(time_us(0), last_us + 1000);
  EXPECT_EQ(board.usb.take_trace(bytes.data(), 8192), 0);
  board.run_ms(500);
  got = board.usb.take_trace(bytes.data(), 8192) / usb::kTraceBytes;
  ASSERT_EQ(got, ControllerUsb::kTraceSamples);
  EXPECT_EQ(time_us(got - 1), static_cast<std::uint16_t>(board.now_us)) << "the newest one is there";
}

TEST(ControllerUsb, TheMotionOfAnotherAxisIsAnEventToo) {
  Board board(three_axes());
  board.run_ms(1);
  ASSERT_EQ(board.usb.take_event(board.data.data()), usb::kEventBytes);
  EXPECT_EQ(board.usb.take_event(board.data.data()), 0);
  std::vector<std::uint16_t> home(10);
  home[9] = protocol::kHome;
  ASSERT_EQ(board.write(protocol::groups::axis_command.address(2), home), 0);
  ASSERT_EQ(board.usb.take_event(board.data.data()), usb::kEventBytes);
  EXPECT_EQ(board.word(10), static_cast<std::uint16_t>(MotionState::unhomed)) << "the table's";
  EXPECT_EQ(board.usb.take_event(board.data.data()), 0);
}

}  // namespace
}  // namespace celadon::test
