// The scanner's device code over USB, in this process: real libusb, the simulator's controller behind mocked usbfs.

#include <gtest/gtest.h>
#include <libusb.h>

#include <cmath>
#include <numbers>
#include <optional>
#include <thread>
#include <vector>

#include "firmware_bridge/scanner_device.h"
#include "firmware_bridge/usb_url.h"
#include "tests/firmware_bridge/usb_testbed.h"

namespace celadon::test {
namespace {

using Kind = DeviceError::Kind;
constexpr double kDeg = std::numbers::pi / 180;
constexpr std::int64_t kMs = 1'000'000;

class Usb : public testing::Test {
 protected:
  static void SetUpTestSuite() { testbed_ = umockdev_testbed_new(); }
  static void TearDownTestSuite() { g_clear_object(&testbed_); }

  void open(const std::string& url = "usb:?timeout_ms=5000") {
    auto transport = open_transport(url);
    ASSERT_TRUE(transport) << transport.error().message();
    auto opened = ScannerDevice::open(std::move(*transport), clock);
    ASSERT_TRUE(opened) << opened.error().message();
    device = std::move(*opened);
  }
  void open_homed(const std::string& url = "usb:?timeout_ms=5000") {
    port.plug(machine);
    open(url);
    const auto homed = device->home();
    ASSERT_TRUE(homed) << homed.error().message();
  }
  /// Of the table, within half a turn of zero.
  double true_angle() {
    return machine.with([](sim::DeviceModel& m) { return std::remainder(m.state().angle_rad, 2 * std::numbers::pi); });
  }
  sim::DeviceState state() {
    return machine.with([](sim::DeviceModel& m) { return m.state(); });
  }

  static UMockdevTestbed* testbed_;
  UsbMachine machine;
  UsbMachineClock clock{machine};
  UsbPort port{testbed_, 1};
  std::unique_ptr<ScannerDevice> device;
};
UMockdevTestbed* Usb::testbed_ = nullptr;

TEST_F(Usb, IdentityCapabilitiesHomeSweepLeaseAndMakeSafe) {
  open_homed();
  EXPECT_EQ(device->identity().machine, "Celadon Virtual Scanner SIM-0001");
  EXPECT_TRUE(device->identity().simulated);
  EXPECT_EQ(device->capabilities().lease_ms, 500);
  EXPECT_NEAR(true_angle(), 0, 0.01 * kDeg);
  ASSERT_TRUE(device->start_sweep(360 * kDeg, 90 * kDeg));
  ASSERT_TRUE(device->renew_laser(0, 300));
  const auto status = device->poll();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->motion, MotionState::moving);
  EXPECT_EQ(status->lasers_on, 1);
  EXPECT_EQ(state().lasers_on, 1);
  machine.advance_ms(301);
  EXPECT_EQ(state().lasers_on, 0) << "the lease ran out";
  ASSERT_TRUE(device->renew_laser(0, 300));
  const SafeReport report = device->make_safe();
  EXPECT_TRUE(report.lasers_off && report.motor_stopped) << report.text;
  EXPECT_EQ(state().lasers_on, 0);
  EXPECT_EQ(state().motor_speed_rad_per_s, 0);
  const auto turned = device->rotate_to(20 * kDeg, 90 * kDeg);
  ASSERT_TRUE(turned) << turned.error().message();
  EXPECT_NEAR(true_angle(), 20 * kDeg, 0.02 * kDeg);
}

TEST_F(Usb, ARefusalIsAStallWithItsReason) {
  open_homed();
  machine.with([](sim::DeviceModel& m) { m.inject(*sim::make_fault("interlock-open", {})); });
  const auto refused = device->renew_laser(0, 100);
  // The newest poll did not know: the controller itself refused.
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, Kind::interlock);
  EXPECT_NE(refused.error().cause.find("the interlock is open"), std::string::npos) << refused.error().message();
  auto transport = open_transport("usb:SIM-0001");
  ASSERT_TRUE(transport);
  std::uint16_t word = 0;
  const auto absent = (*transport)->read_inputs(0x4000, std::span(&word, 1));
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().kind, Kind::refused);
  EXPECT_EQ(absent.error().code, 2);
  EXPECT_FALSE(absent.error().retry_may_help);
}

TEST_F(Usb, ShortAndBrokenTransfersAreRepeatedThenNamed) {
  open_homed();
  for (const UsbMishap mishap : {UsbMishap::shorten, UsbMishap::break_off}) {
    port.mishap(mishap, 2);
    EXPECT_TRUE(device->poll()) << "two of three attempts";
    port.mishap(mishap, 3);
    const auto status = device->poll();
    ASSERT_FALSE(status);
    EXPECT_EQ(status.error().kind, Kind::broken_reply) << status.error().message();
    EXPECT_TRUE(device->poll());
  }
  const LinkQuality& quality = device->link_quality();
  EXPECT_EQ(quality.broken_replies, 10u) << "two times two, and two times three";
  EXPECT_EQ(quality.retries, 8u) << "two times two, and two times two";
  EXPECT_EQ(quality.time_outs, 0u);
  // A command whose acknowledgement broke is sent again with its number, and done once.
  port.mishap(UsbMishap::shorten, 1);
  const int before = machine.writes;
  ASSERT_TRUE(device->renew_laser(0, 100));
  EXPECT_EQ(machine.writes - before, 2);
}

// Axes besides the table: through the same requests; their motion is told by an event, and stopped by make_safe.
TEST_F(Usb, ElevationAndLiftHomeMoveAndStop) {
  UsbMachine other("SIM-0007", true);
  UsbMachineClock its_clock(other);
  UsbPort second(testbed_, 2);
  second.plug(other);
  auto transport = open_transport("usb:SIM-0007?timeout_ms=5000");
  ASSERT_TRUE(transport) << transport.error().message();
  auto opened = ScannerDevice::open(std::move(*transport), its_clock);
  ASSERT_TRUE(opened) << opened.error().message();
  ScannerDevice& scanner = **opened;
  for (const AxisKind kind : {AxisKind::elevation, AxisKind::lift}) {
    const auto homed = scanner.home_axis(kind);
    ASSERT_TRUE(homed) << homed.error().message();
  }
  ASSERT_TRUE(scanner.move_axis(AxisKind::elevation, 25 * kDeg));
  ASSERT_TRUE(scanner.move_axis(AxisKind::lift, -12.5));
  const auto status = scanner.poll();
  ASSERT_TRUE(status && status->elevation && status->lift);
  EXPECT_NEAR(status->elevation->position, 25 * kDeg, 1e-9);
  EXPECT_NEAR(status->lift->position, -12.5, 1e-9);
  const auto truth = other.with([](sim::DeviceModel& m) { return m.state(); });
  EXPECT_NEAR(truth.elevation->position, 25 * kDeg, 25 * kDeg * 1.01e-3);
  EXPECT_NEAR(truth.lift->position, -12.5, 12.5 * 5.1e-4);
  EXPECT_EQ(scanner.move_axis(AxisKind::lift, 151).error().kind, Kind::refused);
}

TEST_F(Usb, SilenceIsATimeOutThatSaysHowLong) {
  open_homed("usb:?timeout_ms=300");
  port.mishap(UsbMishap::ignore, 3);
  auto status = device->poll();
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().kind, Kind::timed_out);
  EXPECT_NE(status.error().cause.find("300 ms"), std::string::npos) << status.error().message();
  EXPECT_EQ(device->link_quality().time_outs, 3u);
  for (int i = 0; i < 5 && !status; ++i) status = device->poll();
  EXPECT_TRUE(status) << status.error().message();
}

TEST_F(Usb, APressIsAnEventAndCountedOnce) {
  port.plug(machine);
  auto owned = open_transport("usb:?timeout_ms=5000");
  ASSERT_TRUE(owned) << owned.error().message();
  Transport& transport = **owned;
  auto opened = ScannerDevice::open(std::move(*owned), clock);
  ASSERT_TRUE(opened) << opened.error().message();
  device = std::move(*opened);
  ASSERT_TRUE(transport.has_events());
  while (transport.wait_for_event(20 * kMs)) {  // what opening has changed
  }
  machine.press();
  EXPECT_TRUE(transport.wait_for_event(60'000 * kMs));
  ASSERT_TRUE(device->poll());
  EXPECT_EQ(device->take_button_presses(), 1);
  // A halted endpoint is cleared, and nothing is lost meanwhile.
  while (transport.wait_for_event(20 * kMs)) {
  }
  machine.with([&](sim::DeviceModel&) { machine.device().halt(0x81); });
  machine.press();
  machine.press();
  EXPECT_TRUE(transport.wait_for_event(60'000 * kMs));
  ASSERT_TRUE(device->poll());
  EXPECT_EQ(device->take_button_presses(), 2);
  while (device->changed()) {
  }
  EXPECT_TRUE(device->tells_changes());
  machine.press();
  bool changed = false;
  while (!changed) changed = device->changed();
  ASSERT_TRUE(device->poll());
  EXPECT_EQ(device->take_button_presses(), 1);
}

TEST_F(Usb, TheTraceHasEverySampleOfASweep) {
  open_homed();
  std::vector<TraceSample> samples(1000);
  (void)device->take_trace(samples);  // starts it
  ASSERT_TRUE(device->start_sweep(90 * kDeg, 90 * kDeg));
  std::size_t count = 0;
  for (int i = 0; i < 10; ++i) {
    machine.advance_ms(50);
    // Two transfers of up to 170 samples wait; more than one call may be needed to see them end.
    for (int looks = 0; looks < 50; ++looks) count += device->take_trace(std::span(samples).subspan(count));
  }
  ASSERT_GE(count, 490u);
  for (std::size_t i = 1; i < count; ++i) {
    ASSERT_EQ(samples[i].counter, samples[i - 1].counter + 1);
    ASSERT_EQ(samples[i].time_us, samples[i - 1].time_us + 1000);
  }
  const TraceSample& last = samples[count - 1];
  EXPECT_NEAR(static_cast<double>(last.position_udeg) * 1e-6 * kDeg, true_angle(), 0.2 * kDeg);
  EXPECT_GT(last.speed_udeg_per_s, 20'000'000);
}

TEST_F(Usb, DepartureIsNamedAndAReturnGoesOnWithoutALostPress) {
  open_homed("usb:?timeout_ms=300");
  ASSERT_TRUE(device->renew_laser(0, 500));
  port.unplug();
  const auto gone = device->poll();
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, Kind::lost);
  EXPECT_NE(gone.error().cause.find("unplugged"), std::string::npos) << gone.error().message();
  EXPECT_NE(gone.error().cause.find("LIBUSB_ERROR_NO_DEVICE"), std::string::npos);
  EXPECT_NE(gone.error().left.find("500 ms"), std::string::npos) << gone.error().left;
  machine.advance_ms(501);
  EXPECT_EQ(state().lasers_on, 0) << "the lease is the controller's";
  machine.press();
  port.plug(machine);
  const auto back = device->poll();
  ASSERT_TRUE(back) << back.error().message();
  EXPECT_EQ(back->lasers_on, 0);
  EXPECT_EQ(device->take_button_presses(), 1);
  EXPECT_GE(device->link_quality().reconnects, 1u);
}

// Without the news of its arrival a lost controller would be looked for after twelve seconds.
TEST_F(Usb, AnArrivalEndsTheWaitForALostController) {
  open_homed("usb:?timeout_ms=60000");
  port.unplug();
  MonotonicClock real;
  const std::int64_t begun_ns = real.now_ns();
  std::thread returns([this] { port.plug(machine); });
  const auto back = device->poll();
  returns.join();
  ASSERT_TRUE(back) << back.error().message();
  EXPECT_LT(real.now_ns() - begun_ns, 11'000 * kMs);
}

TEST_F(Usb, TheOneThatIsMeantIsOpened) {
  const auto absent = open_transport("usb:");
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().kind, Kind::not_found);
  port.plug(machine);
  UsbMachine other("SIM-0002");
  UsbPort second(testbed_, 2);
  second.plug(other);
  const auto either = open_transport("usb:1209:0001");
  ASSERT_FALSE(either);
  EXPECT_EQ(either.error().kind, Kind::refused);
  EXPECT_NE(either.error().cause.find("usb:1209:0001/SIM-0002"), std::string::npos) << either.error().cause;
  EXPECT_TRUE(open_transport("usb:SIM-0001"));
  EXPECT_TRUE(open_transport("usb:1209:0001/SIM-0002"));
  const auto foreign = open_transport("usb:1234:5678");
  ASSERT_FALSE(foreign);
  EXPECT_EQ(foreign.error().message(),
            "connect on usb:1234:5678 failed: no controller with VID:PID 1234:5678 is on USB; the machine was left "
            "with its state unknown and untouched; plug it in and switch it on.");
}

TEST(UsbUrl, SaysWhichControllerIsMeant) {
  const auto any = parse_usb_url("usb:");
  ASSERT_TRUE(any);
  EXPECT_FALSE(any->pair);
  EXPECT_EQ(any->serial, "");
  EXPECT_EQ(any->timeout_ms, 500);
  const auto both = parse_usb_url("usb:1209:00aF/A 7?timeout_ms=90");
  ASSERT_TRUE(both) << both.error();
  EXPECT_EQ(both->pair->vendor, 0x1209);
  EXPECT_EQ(both->pair->product, 0x00AF);
  EXPECT_EQ(both->serial, "A 7");
  EXPECT_EQ(both->timeout_ms, 90);
  EXPECT_EQ(parse_usb_url("usb:SIM-0001")->serial, "SIM-0001");
  EXPECT_EQ(parse_usb_url("usb:/1209:0001")->serial, "1209:0001") << "a serial number that looks like a pair";
  for (const char* bad : {"usb", "usb:1209:0001/", "usb:12:34/X", "usb:?timeout_ms=5", "usb:?timeout_ms=", "usb:?x=1"})
    EXPECT_FALSE(parse_usb_url(bad)) << bad;
}

}  // namespace
}  // namespace celadon::test
