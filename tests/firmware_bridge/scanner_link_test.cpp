// The device front over real Modbus links that fail, and controllers that restart.

#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <utility>

#include "tests/firmware_bridge/scanner_rig.h"

namespace celadon::test {
namespace {

using Rig = ScannerRig;

class FailuresOnBothLinks : public OnALink {};
INSTANTIATE_ON_BOTH_LINKS(FailuresOnBothLinks);

TEST(LinkQuality, CountsWhatHappenedOnTheWire) {
  Rig s(Link::rtu);
  s.open("timeout_ms=60");
  const LinkQuality before = s.device->link_quality();
  EXPECT_EQ(before.retries + before.time_outs + before.broken_replies, 0u);
  s.server.mishap(Mishap::drop);
  ASSERT_TRUE(s.device->poll());
  s.server.mishap(Mishap::garble);
  ASSERT_TRUE(s.device->poll());
  s.server.mishap(Mishap::busy);
  ASSERT_TRUE(s.device->poll());
  const LinkQuality& after = s.device->link_quality();
  EXPECT_EQ(after.requests - before.requests, 6u);
  EXPECT_EQ(after.retries, 3u);
  EXPECT_EQ(after.time_outs, 1u);
  EXPECT_EQ(after.broken_replies, 1u);
  EXPECT_EQ(after.exceptions, 1u);
  EXPECT_EQ(after.reconnects, 0u);
  EXPECT_GT(after.round_trip_ns, 0);
  EXPECT_GE(after.longest_round_trip_ns, after.round_trip_ns);
}

/// The machine's clock, on which something happens at a time.
class EventClock final : public Clock {
 public:
  EventClock(Machine& machine, std::function<void()> event) : clock_(machine), event_(std::move(event)) {}
  std::int64_t now_ns() override { return clock_.now_ns(); }
  void sleep_until(std::int64_t time_ns) override {
    clock_.sleep_until(time_ns);
    if (armed_ns > 0 && clock_.now_ns() >= armed_ns) {
      armed_ns = 0;
      event_();
    }
  }
  std::int64_t armed_ns = 0;

 private:
  MachineClock clock_;
  std::function<void()> event_;
};

// A cable that was out for a moment: connections are tried with growing pauses.
TEST(LinkQuality, ALinkThatComesBackWithinHalfASecondIsMadeGood) {
  Machine machine;
  ModbusServer server(machine, Link::tcp);
  EventClock clock(machine, [&] { server.start(); });
  auto transport = open_transport(server.url("timeout_ms=2000"));
  ASSERT_TRUE(transport);
  auto device = ScannerDevice::open(std::move(*transport), clock);
  ASSERT_TRUE(device) << device.error().message();
  server.stop();
  clock.armed_ns = clock.now_ns() + 250'000'000;
  const auto polled = (*device)->poll();
  ASSERT_TRUE(polled) << polled.error().message();
  EXPECT_GE((*device)->link_quality().reconnects, 1u);
  server.stop();
  clock.armed_ns = clock.now_ns() + 1'000'000'000;  // too late: the controller has stopped by itself
  const auto lost = (*device)->poll();
  ASSERT_FALSE(lost);
  EXPECT_EQ(lost.error().kind, Kind::lost);
  server.start();
}

// ---- broken links ----

TEST_P(FailuresOnBothLinks, MishapsOfOneReplyAreRetriedUnseen) {
  s.open("timeout_ms=200");
  for (const Mishap m :
       {Mishap::drop, Mishap::ignore, Mishap::truncate, Mishap::garble, Mishap::busy, Mishap::close_link}) {
    s.server.mishap(m);
    const auto status = s.device->poll();
    EXPECT_TRUE(status) << static_cast<int>(m) << ": " << status.error().message();
  }
}

TEST_P(FailuresOnBothLinks, CommandWhoseReplyIsLostIsExecutedOnce) {
  s.open("timeout_ms=200");
  s.home();
  ASSERT_TRUE(s.device->poll());
  s.server.mishap(Mishap::none);  // the poll before the command
  s.server.mishap(Mishap::drop);
  const auto moved = s.device->rotate_to(45 * kDeg, 90 * kDeg);
  ASSERT_TRUE(moved) << moved.error().message();
  s.machine.with([](TestPlant& p, ControllerCore&) { EXPECT_EQ(p.moves, 1); });
}

TEST_P(FailuresOnBothLinks, RetriesAreBounded) {
  s.open("timeout_ms=50");
  s.server.mishap(Mishap::ignore, 3);
  const auto status = s.device->poll();
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().kind, Kind::timed_out);
  EXPECT_NE(status.error().left.find("the link is down; the controller turns the lasers off within 500 ms"),
            std::string::npos)
      << status.error().message();
  tl::expected<DeviceStatus, DeviceError> again = s.device->poll();
  for (int i = 0; i < 20 && !again; ++i) again = s.device->poll();
  EXPECT_TRUE(again);
}

TEST(BrokenLink, ServerVanishingInAMoveIsALostLinkAndTheDeviceComesBack) {
  Rig s;
  s.open("timeout_ms=500");
  s.home();
  ASSERT_TRUE(s.device->start_sweep(3600 * kDeg, 36 * kDeg));
  ASSERT_TRUE(s.device->renew_laser(0, 500));
  s.server.stop();
  const auto gone = s.device->poll();
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, Kind::lost);
  EXPECT_NE(gone.error().message().find("its state unknown: the link is down"), std::string::npos);
  const SafeReport unsafe = s.device->make_safe();
  EXPECT_FALSE(unsafe.lasers_off);
  EXPECT_FALSE(unsafe.motor_stopped);
  EXPECT_EQ(unsafe.lasers_were_on, 0);  // as last polled, before the grant
  s.machine.advance_ms(2000);
  s.server.start();
  const SafeReport safe = s.device->make_safe();
  EXPECT_TRUE(safe.lasers_off) << safe.text;
  EXPECT_TRUE(safe.motor_stopped) << safe.text;
  EXPECT_EQ(s.device->poll()->motion, MotionState::stopped);
  EXPECT_TRUE(s.device->home());
}

TEST(BrokenLink, MakeSafeIsTriedAgainUntilItGetsThrough) {
  for (const Mishap m : {Mishap::ignore, Mishap::drop, Mishap::garble, Mishap::close_link, Mishap::busy}) {
    Rig s;
    s.open("timeout_ms=100");
    s.home();
    ASSERT_TRUE(s.device->start_sweep(3600 * kDeg, 36 * kDeg));
    ASSERT_TRUE(s.device->renew_laser(0, 500));
    s.server.mishap(m, 2);
    const SafeReport report = s.device->make_safe();
    EXPECT_TRUE(report.lasers_off && report.motor_stopped) << static_cast<int>(m) << ": " << report.text;
    s.machine.with([](TestPlant& p, ControllerCore& core) {
      EXPECT_EQ(p.lasers, 0);
      EXPECT_EQ(core.motion(0), MotionState::standstill);
    });
  }
}

TEST(BrokenLink, DestroyingTheDeviceMakesSafe) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(3600 * kDeg, 36 * kDeg));
  ASSERT_TRUE(s.device->renew_laser(0, 500));
  s.device.reset();
  s.machine.with([](TestPlant& p, ControllerCore& core) {
    EXPECT_EQ(p.lasers, 0);
    EXPECT_EQ(core.motion(0), MotionState::standstill);
  });
}

TEST(Restart, OfTheControllerIsToldOnceAndResumesNothing) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(3600 * kDeg, 36 * kDeg));
  s.machine.restart();
  const auto told = s.device->poll();
  ASSERT_FALSE(told);
  EXPECT_EQ(told.error().kind, Kind::fault);
  EXPECT_NE(told.error().cause.find("restarted"), std::string::npos);
  const auto after = s.device->poll();
  ASSERT_TRUE(after);
  EXPECT_EQ(after->motion, MotionState::unhomed);
  EXPECT_EQ(after->speed_rad_per_s, 0);
  EXPECT_FALSE(after->homed);
  EXPECT_TRUE(s.device->home());
}

TEST(Restart, InARotationEndsTheCall) {
  Rig s;
  s.open();
  s.home();
  ASSERT_TRUE(s.device->start_sweep(30 * kDeg, 36 * kDeg));
  s.machine.restart();
  const auto stopped = s.device->stop();
  ASSERT_FALSE(stopped);
  EXPECT_NE(stopped.error().cause.find("restarted"), std::string::npos);
}

}  // namespace
}  // namespace celadon::test
