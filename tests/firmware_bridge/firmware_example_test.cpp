// The firmware example on a simulated board: byte by byte on a clock of the test's, and through a terminal with the
// real device code and libmodbus at the other end. And its binary for a microcontroller, as the cross compiler left it.

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <pty.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <regex>
#include <string>
#include <thread>
#include <vector>

#include "firmware_bridge/firmware_example/firmware.h"
#include "firmware_bridge/scanner_device.h"
#include "tests/firmware_bridge/simulated_board.h"

namespace celadon::test {
namespace {

using example::Firmware;
using Bytes = std::vector<std::uint8_t>;

constexpr std::uint64_t kMs = 1'000;
constexpr double kDeg = std::numbers::pi / 180;

/// Fresh wires, a clock that the test moves.
class Bench {
 public:
  Bench() {
    SimulatedBoard& b = simulated_board();
    b.now_us = [this] { return now_us; };
    b.received.clear();
    b.sent.clear();
    b.interlock_closed = b.index_exists = true;
    b.emergency_stop = b.button = b.light_stuck = b.laser = b.lamp = b.motor = false;
    b.steps = 0;
    b.steps_without_power = b.watchdog_fed = 0;
    firmware = std::make_unique<Firmware>(example::machine_config(true), std::uint16_t{7}, now_us);
  }
  void run_ms(std::uint64_t ms) {
    for (const std::uint64_t end = now_us + ms * kMs; now_us < end; now_us += 20) firmware->run_once(now_us);
  }
  /// Sends these bytes; what comes back within 20 ms.
  Bytes ask(const Bytes& request) {
    simulated_board().received.assign(request.begin(), request.end());
    run_ms(20);
    Bytes answer(simulated_board().sent.begin(), simulated_board().sent.end());
    simulated_board().sent.clear();
    return answer;
  }
  void unlock() {
    run_ms(50);
    simulated_board().button = true;
    run_ms(50);
    simulated_board().button = false;
    run_ms(50);
  }
  std::uint64_t now_us = 1'000'000;
  std::unique_ptr<Firmware> firmware;
};

TEST(FirmwareExample, FramesAreThoseOfTheSpecification) {
  Bench bench;
  // "MODBUS over Serial Line": the checksum of 02 07 is 0x1241, sent 41 12.
  const std::uint8_t known[] = {0x02, 0x07};
  EXPECT_EQ(example::modbus_crc(known, 2), 0x1241);
  // Function 4, the two registers of the magic at 0x0100; checksums by another program (Python).
  const Bytes request = {0x01, 0x04, 0x01, 0x00, 0x00, 0x02, 0x70, 0x37};
  EXPECT_EQ(bench.ask(request), (Bytes{0x01, 0x04, 0x04, 0x43, 0x45, 0x4C, 0x41, 0x0B, 0x25}));
  // Function 1 is none of ours.
  EXPECT_EQ(bench.ask({0x01, 0x01, 0x00, 0x00, 0x00, 0x01, 0xFD, 0xCA}), (Bytes{0x01, 0x81, 0x01, 0x81, 0x90}));
  // An address that is not mapped.
  EXPECT_EQ(bench.ask({0x01, 0x04, 0x70, 0x00, 0x00, 0x01, 0x2B, 0x0A}), (Bytes{0x01, 0x84, 0x02, 0xC2, 0xC1}));
  Bytes broken = request;
  broken[3] ^= 1;
  EXPECT_EQ(bench.ask(broken), Bytes{});
  EXPECT_EQ(bench.ask({0x02, 0x04, 0x01, 0x00, 0x00, 0x02, 0x70, 0x04}), Bytes{}) << "another unit";
  EXPECT_EQ(bench.ask(Bytes(700, 0x01)), Bytes{}) << "longer than a frame";
  EXPECT_EQ(bench.ask(request).size(), 9u) << "and it still answers";
}

/// A table that moves as the plant was told, against the closed form of the trapezoid.
TEST(FirmwareExample, TheStepsOfAMoveAreATrapezoid) {
  Bench bench;
  example::StepperPlant plant;
  const auto run_to = [&](std::uint64_t end_us) {
    for (; bench.now_us < end_us; bench.now_us += 10) plant.advance(bench.now_us);
  };
  const std::uint64_t begun = bench.now_us;
  // 90 degrees at 45 degrees/s and 90 degrees/s^2: half a second of ramps, 1.5 s between.
  plant.move(0, 90'000'000, 45'000'000, 90'000'000, 0, bench.now_us);
  for (const auto& [at_s, degrees] : std::vector<std::pair<double, double>>{
           {0.25, 2.8125}, {0.5, 11.25}, {1.0, 33.75}, {2.0, 78.75}, {2.25, 87.1875}}) {
    run_to(begun + static_cast<std::uint64_t>(at_s * 1e6));
    EXPECT_NEAR(static_cast<double>(simulated_board().steps) * 360 / 32'000, degrees, 0.1) << at_s << " s";
  }
  run_to(begun + 3'000'000);
  EXPECT_EQ(simulated_board().steps, 8'000);
  EXPECT_EQ(plant.axis(0, bench.now_us).phase, AxisPhase::standing);
  // A stop from full speed: v^2 / 2a, 11.25 degrees.
  plant.move(0, -360'000'000, 45'000'000, 90'000'000, 0, bench.now_us);
  run_to(bench.now_us + 1'000'000);
  const std::int64_t before = simulated_board().steps;
  plant.stop(0, bench.now_us);
  run_to(bench.now_us + 1'000'000);
  EXPECT_NEAR(static_cast<double>(before - simulated_board().steps), 1'000, 5);
  EXPECT_EQ(plant.axis(0, bench.now_us).phase, AxisPhase::standing);
  EXPECT_EQ(plant.axis(0, bench.now_us).position_udeg, simulated_board().steps * 11'250);
}

TEST(FirmwareExample, HomingEndsAtTheIndexOrSaysThatThereIsNone) {
  Bench bench;
  example::StepperPlant plant;
  const auto home = [&] {
    plant.home(0, bench.now_us);
    const std::uint64_t limit = bench.now_us + 60'000'000;
    AxisSample sample = plant.axis(0, bench.now_us);
    for (; sample.phase != AxisPhase::standing && bench.now_us < limit; bench.now_us += 50) {
      plant.advance(bench.now_us);
      sample = plant.axis(0, bench.now_us);
    }
    return sample;
  };
  for (const std::int64_t from : {0, 1'999, 2'005, 2'010, 31'000}) {
    simulated_board().steps = from;
    const AxisSample sample = home();
    EXPECT_TRUE(sample.index_found) << from;
    EXPECT_EQ(sample.position_udeg, 0);
    EXPECT_EQ((simulated_board().steps - simulated_board().index_at) % 32'000, 0) << from;
  }
  simulated_board().index_exists = false;
  const AxisSample sample = home();
  EXPECT_FALSE(sample.index_found);
  EXPECT_EQ(sample.fault, FaultCode::homing_failed);
}

/// The firmware in a thread of its own, its serial line a terminal.
class Served {
 public:
  Served() {
    char name[128] = {};
    int slave = -1;
    if (::openpty(&master_, &slave, name, nullptr, nullptr) != 0) throw std::runtime_error("no terminal");
    termios raw{};
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    slave_ = slave;  // kept open, so that the other end may come and go
    url = std::string("modbus-rtu:") + name + "?parity=N&timeout_ms=2000";
    simulated_board().now_us = [start = clock_.now_ns(), this] {
      return static_cast<std::uint64_t>((clock_.now_ns() - start) / 1'000);
    };
    thread_ = std::thread([this] { run(); });
  }
  ~Served() {
    ended_ = true;
    thread_.join();
    ::close(slave_);
    ::close(master_);
  }
  std::string url;

 private:
  void run() {
    SimulatedBoard& b = simulated_board();
    Firmware firmware(example::machine_config(true), 1, b.now_us());
    while (!ended_) {
      pollfd ready{master_, POLLIN, 0};
      std::array<std::uint8_t, 256> bytes{};
      if (::poll(&ready, 1, 1) > 0) {
        const ssize_t count = ::read(master_, bytes.data(), bytes.size());
        for (ssize_t i = 0; i < count; ++i) b.received.push_back(bytes[static_cast<std::size_t>(i)]);
      }
      do {
        b.sent.clear();
        firmware.run_once(b.now_us());
        const Bytes sent(b.sent.begin(), b.sent.end());
        if (!sent.empty() && ::write(master_, sent.data(), sent.size()) < 0) return;
      } while (!b.sent.empty());
    }
  }
  MonotonicClock clock_;
  int master_ = -1, slave_ = -1;
  std::atomic<bool> ended_ = false;
  std::thread thread_;
};

TEST(FirmwareExample, TheScannersDeviceCodeDrivesIt) {
  Bench bench;  // fresh wires; its own firmware stands still
  SimulatedBoard& b = simulated_board();
  Served served;
  MonotonicClock clock;
  auto transport = open_transport(served.url);
  ASSERT_TRUE(transport) << transport.error().message();
  auto opened = ScannerDevice::open(std::move(*transport), clock);
  ASSERT_TRUE(opened) << opened.error().message();
  ScannerDevice& device = **opened;
  EXPECT_EQ(device.identity().machine, "Celadon Firmware Example 0001");
  const auto locked = device.home();
  ASSERT_FALSE(locked);
  EXPECT_EQ(locked.error().kind, DeviceError::Kind::interlock) << "nothing moves after power-up before a press";
  const auto poll_until = [&](auto condition) {
    for (;;) {
      const auto status = device.poll();
      ASSERT_TRUE(status) << status.error().message();
      if (condition(*status)) return;
    }
  };
  b.button = true;
  poll_until([](const DeviceStatus& s) { return s.button_presses == 1; });
  b.button = false;
  const auto homed = device.home();
  ASSERT_TRUE(homed) << homed.error().message();
  EXPECT_EQ(b.steps, b.index_at);
  const auto turned = device.rotate_to(20 * kDeg, 80 * kDeg);
  ASSERT_TRUE(turned) << turned.error().message();
  EXPECT_EQ(b.steps - b.index_at, std::llround(20. * 32'000 / 360));
  EXPECT_EQ(b.steps_without_power, 0u);

  ASSERT_TRUE(device.renew_laser(0, 500));
  poll_until([](const DeviceStatus& s) { return s.lasers_on == 1; });
  EXPECT_TRUE(b.laser);
  b.interlock_closed = false;
  poll_until([](const DeviceStatus& s) { return s.lasers_on == 0; });
  EXPECT_FALSE(b.laser);
  EXPECT_FALSE(device.renew_laser(0, 500));
  const SafeReport safe = device.make_safe();
  EXPECT_TRUE(safe.lasers_off && safe.motor_stopped) << safe.text;
}

TEST(FirmwareExample, WithoutAHostTheLaserGoesOutWithItsLease) {
  Bench bench;
  bench.unlock();
  // laser_lease of laser 0: 300 ms, by function 6 at 0x0008.
  const Bytes grant = {0x01, 0x06, 0x00, 0x08, 0x01, 0x2C, 0x08, 0x45};
  EXPECT_EQ(bench.ask(grant), grant);
  EXPECT_TRUE(simulated_board().laser);
  bench.run_ms(270);
  EXPECT_TRUE(simulated_board().laser);
  bench.run_ms(20);
  EXPECT_FALSE(simulated_board().laser);
  EXPECT_GT(simulated_board().watchdog_fed, 0u);
}

#ifdef CELADON_FIRMWARE_ELF

std::string output_of(const std::string& command) {
  std::string text;
  FILE* const pipe = ::popen(command.c_str(), "r");
  std::array<char, 512> line{};
  while (std::fgets(line.data(), line.size(), pipe) != nullptr) text += line.data();
  EXPECT_EQ(::pclose(pipe), 0) << command;
  return text;
}

/// The first symbol that has no place in firmware; empty: none.
std::string unwanted_in(const std::string& symbols) {
  static const std::regex kUnwanted(
      R"( (malloc|calloc|realloc|free|_?sbrk|_Zn[wa]\w*|_Zd[la]\w*|__cxa_\w+|__gxx_\w+|_Unwind_\w+|__aeabi_[fd]\w+)\b)");
  std::smatch found;
  return std::regex_search(symbols, found, kUnwanted) ? found.str() : "";
}

TEST(FirmwareBinary, HasNoHeapNoExceptionsNoFloatsAndNothingMissing) {
  const std::string symbols = output_of(std::string(CELADON_ARM_NM) + " " + CELADON_FIRMWARE_ELF);
  EXPECT_NE(symbols.find("ControllerCore"), std::string::npos);
  EXPECT_NE(symbols.find("08000000"), std::string::npos) << "the vectors begin the flash";
  EXPECT_EQ(unwanted_in(symbols), "");
  EXPECT_EQ(symbols.find(" U "), std::string::npos) << symbols;
  for (const char* planted : {"08000010 T malloc", "08000010 W _Znwj", "08000010 T __aeabi_fadd", "08000010 T _sbrk"})
    EXPECT_NE(unwanted_in(symbols + planted), "") << planted;
}

#endif

}  // namespace
}  // namespace celadon::test
