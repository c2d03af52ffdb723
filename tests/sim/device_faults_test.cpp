// What each fault does to the machine, in device time.
#include <nlohmann/json.hpp>
#include <set>

#include "tests/sim/device_rig.h"

namespace celadon::sim {
namespace {

using protocol::Exception;
constexpr double kDegree = std::numbers::pi / 180;

TEST(DeviceFaults, FaultsOfTheCamera) {
  Rig rig;
  CameraTimeline& camera = rig.model.camera();
  camera.start(rig.model.now_ns());
  const auto next = [&] {
    auto t = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
    EXPECT_TRUE(t);
    if (t) camera.give_back(t->slot);
    return t.value_or(FrameTicket{});
  };
  const std::uint64_t first = next().sequence;
  rig.inject("drop-frame", {"3"});
  std::uint64_t last = first, widest = 0;
  for (int i = 0; i < 5; ++i) {
    const std::uint64_t s = next().sequence;
    widest = std::max(widest, s - last);
    last = s;
  }
  EXPECT_EQ(widest, 4U);

  rig.inject("corrupt-frame", {"2"});
  int corrupt = 0;
  for (int i = 0; i < 6; ++i) corrupt += next().corrupt ? 1 : 0;
  EXPECT_EQ(corrupt, 2);
  rig.inject("short-frame");
  int halves = 0;
  for (int i = 0; i < 6; ++i) halves += next().bytes_used == 160 * 128 / 2 ? 1 : 0;
  EXPECT_EQ(halves, 1);

  const auto last_picture = rig.picture(next());
  std::vector<std::uint8_t> before(last_picture.begin(), last_picture.end());
  rig.inject("stale-frame");
  int same = 0;
  for (int i = 0; i < 6; ++i) {
    const FrameTicket t = next();
    const auto p = rig.picture(t);
    const std::vector<std::uint8_t> now(p.begin(), p.end());
    same += now == before ? 1 : 0;
    before = now;
  }
  EXPECT_EQ(same, 1);

  rig.inject("camera-unplug");
  EXPECT_TRUE(rig.model.camera_unplugged());
  EXPECT_FALSE(rig.model.advance_to_frame(rig.model.now_ns() + kSecond));
  rig.model.clear_fault("camera-unplug");
  camera.start(rig.model.now_ns());
  EXPECT_EQ(next().sequence, 0U);
}

TEST(DeviceFaults, FaultsOfTheMachine) {
  {
    Rig rig;
    rig.home();
    rig.lease(400);
    rig.live(100 * kMs);
    rig.inject("interlock-open");
    rig.live(20 * kMs);
    EXPECT_EQ(rig.model.state().lasers_on, 0);
    EXPECT_EQ(rig.model.state().fault, FaultCode::interlock_opened);
    EXPECT_EQ(rig.lease(400), Exception::refused);
  }
  {
    Rig rig;
    rig.inject("laser-stuck-on");
    rig.live(500 * kMs);
    EXPECT_EQ(rig.model.state().lasers_on, 1);
    EXPECT_EQ(rig.model.state().fault, FaultCode::laser_stuck_on);
  }
  {
    Rig rig;
    rig.inject("laser-dead");
    rig.lease(400);
    rig.live(100 * kMs);
    EXPECT_EQ(rig.model.state().lasers_on, 0);
  }
  {
    Rig rig;
    rig.home();
    rig.command(protocol::kMove, 3);
    rig.live(300 * kMs);
    rig.inject("motor-stall");
    rig.live(100 * kMs);
    EXPECT_EQ(rig.model.state().fault, FaultCode::motor_stalled);
    rig.model.clear_fault("motor-stall");
    rig.live(100 * kMs);
    EXPECT_EQ(rig.write(protocol::reg::control::clear_fault, {1}), Exception::none);
  }
  {
    Rig rig;
    rig.home();
    rig.inject("emergency-stop");
    rig.live(20 * kMs);
    EXPECT_EQ(rig.model.state().fault, FaultCode::emergency_stop);
  }
  {
    Rig rig;
    rig.home();
    rig.lease(500);
    const std::uint16_t before = rig.status(protocol::reg::status::boot_id);
    rig.inject("controller-reset");
    rig.live(10 * kMs);
    EXPECT_NE(rig.status(protocol::reg::status::boot_id), before);
    EXPECT_EQ(rig.model.state().motion, MotionState::unhomed);
    EXPECT_EQ(rig.model.state().lasers_on, 0);
  }
}

// Faults that only a measurement reveals: the encoder says one thing, the table does another.
TEST(DeviceFaults, FaultsThatTheControllerCanNotSee) {
  Rig rig;
  rig.home();
  rig.inject("encoder-slip", {"2"});
  ASSERT_EQ(rig.command(protocol::kMove, 0), Exception::none);
  rig.live(20 * kMs);
  rig.stand();
  EXPECT_NEAR(std::remainder(rig.model.state().angle_rad, 2 * std::numbers::pi), -2 * std::numbers::pi / 180, 1e-4);
  rig.inject("object-slip", {"10"});
  const Scene plain = *Scene::make("humidifier");
  EXPECT_NEAR(rig.model.scene().truth_r_mm(1, 40), plain.truth_r_mm(1 - 10 * std::numbers::pi / 180, 40), 1e-12);
  rig.inject("steps-wrong", {"1.1"});
  const double from = rig.model.state().angle_rad;
  ASSERT_EQ(rig.command(protocol::kMove, 1), Exception::none);
  rig.live(20 * kMs);
  rig.stand();
  EXPECT_NEAR(rig.model.state().angle_rad - from, 1.1, 1e-3);
}

TEST(DeviceFaults, FaultsOfTheLight) {
  Rig rig("cylinder");
  CameraTimeline& camera = rig.model.camera();
  camera.start(rig.model.now_ns());
  const auto brightest = [&] {
    int level = 0;
    for (int i = 0; i < 6; ++i) {
      const auto t = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
      EXPECT_TRUE(t);
      if (!t) return 0;
      level = rig.brightest(*t);
      camera.give_back(t->slot);
    }
    return level;
  };
  const int dark = brightest();
  rig.inject("lights-on");
  EXPECT_GT(brightest(), 2 * dark);
  rig.model.clear_fault("lights-on");
  EXPECT_LT(brightest(), dark + 10);
  rig.lease(500);
  EXPECT_GT(brightest(), dark + 30);
}

TEST(DeviceFaults, ScheduledFaultsStrikeAtTheirTime) {
  Rig rig;
  rig.model.inject(*parse_fault_option("interlock-open@0.5", rig.model.now_ns()));
  const std::int64_t start = rig.model.now_ns();
  rig.model.advance_to(start + 499 * kMs);
  EXPECT_TRUE(rig.model.state().interlock_closed);
  rig.model.advance_to(start + 501 * kMs);
  EXPECT_FALSE(rig.model.state().interlock_closed);
}

TEST(DeviceFaults, APlansOrdersStrikeAtTimeAngleAndFrameAndEnd) {
  Rig rig;
  const auto plan = parse_fault_plan(
      "# what happens\n"
      "seed 5\n"
      "interlock-open at 0.5 for 0.2\n"
      "lights-on 3 angle 30 for 1\n"
      "corrupt-frame 1 frame 4\n",
      {rig.model.now_ns(), 1, 0});
  ASSERT_TRUE(plan) << plan.error();
  for (const FaultOrder& order : *plan) rig.model.inject(order);
  const std::int64_t start = rig.model.now_ns();
  rig.model.advance_to(start + 499 * kMs);
  EXPECT_TRUE(rig.model.state().interlock_closed);
  rig.model.advance_to(start + 501 * kMs);
  EXPECT_FALSE(rig.model.state().interlock_closed);
  rig.model.advance_to(start + 701 * kMs);
  EXPECT_TRUE(rig.model.state().interlock_closed);
  rig.model.press(100 * kMs);
  rig.live(300 * kMs);

  const auto armed = [&](const std::string& name) {
    const auto names = rig.model.state().faults;
    return std::find(names.begin(), names.end(), name) != names.end();
  };
  rig.home();  // passes every angle: not counted
  EXPECT_FALSE(armed("lights-on"));
  ASSERT_EQ(rig.command(protocol::kMove, 60 * kDegree, 30 * kDegree), Exception::none);
  while (!armed("lights-on") && rig.model.state().motion == MotionState::moving) rig.live(kMs);
  EXPECT_NEAR(std::remainder(rig.model.state().angle_rad / kDegree, 360), 30, 0.1);
  rig.live(1001 * kMs);
  EXPECT_FALSE(armed("lights-on"));

  rig.model.camera().start(rig.model.now_ns());
  for (std::uint64_t k = 0; k < 7; ++k) {
    const auto frame = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->sequence, k);
    EXPECT_EQ(frame->corrupt, k == 4) << k;
    rig.model.camera().give_back(frame->slot);
  }
}

TEST(DeviceFaults, DrawnNumbersBelongToTheSeed) {
  const auto at = [](std::uint64_t seed) {
    return parse_fault_plan("\nmotor-slip -3..3 at 1..9\n", {0, seed, 0}).value().front();
  };
  EXPECT_EQ(at(1).at_ns, at(1).at_ns);
  EXPECT_EQ(at(1).value, at(1).value);
  std::set<std::int64_t> times;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    const FaultOrder order = at(seed);
    EXPECT_GE(order.at_ns, kSecond);
    EXPECT_LE(order.at_ns, 9 * kSecond);
    EXPECT_LE(std::abs(order.value), 3);
    times.insert(order.at_ns / kSecond);
  }
  EXPECT_EQ(times.size(), 8U);  // every second of the span is met
}

TEST(DeviceFaults, WrongPlansNameTheLine) {
  for (const char* bad :
       {"\nno-such-fault\n", "\ninterlock-open at\n", "\ninterlock-open at soon\n", "\nmotor-slip 2 for 3\n",
        "\ninterlock-open at 3..1\n", "\ninterlock-open when 3\n", "\nseed -1\n", "\nvibration 99\n"}) {
    const auto plan = parse_fault_plan(bad, {});
    ASSERT_FALSE(plan) << bad;
    EXPECT_NE(plan.error().find("line 2"), std::string::npos) << plan.error();
  }
}

// Every press is counted once however its contact bounces, and none without a press.
TEST(DeviceFaults, ChatterIsOnePress) {
  Rig rig;
  rig.inject("button-chatter", {"15"});
  rig.live(kSecond);
  EXPECT_EQ(rig.status(protocol::reg::status::button_presses), 1);
  for (int k = 2; k <= 20; ++k) {
    rig.model.press(100 * kMs);
    rig.live(300 * kMs);
    EXPECT_EQ(rig.status(protocol::reg::status::button_presses), k);
  }
}

TEST(DeviceFaults, FlickerIsAShareOfTheTime) {
  Rig rig;
  rig.inject("laser-flicker", {"0.3"});
  int lit = 0;
  constexpr int kLooks = 4000;
  for (int k = 0; k < kLooks; ++k) {
    if (k % 10 == 0) rig.lease(500);
    rig.model.advance_to(rig.model.now_ns() + 8 * kMs);
    lit += rig.model.state().lasers_on;
  }
  EXPECT_NEAR(static_cast<double>(lit) / kLooks, 0.7, 4 * std::sqrt(0.21 / kLooks));
  EXPECT_EQ(rig.model.state().fault, FaultCode::none);
  rig.lease(0);
  rig.live(200 * kMs);
  EXPECT_EQ(rig.model.state().lasers_on, 0);
}

// The sensor says dark, the object is lit: only a picture tells.
TEST(DeviceFaults, AHiddenLaserIsSeenByTheCameraAlone) {
  Rig rig("cylinder");
  rig.model.camera().start(rig.model.now_ns());
  const auto brightest = [&] {
    int level = 0;
    for (int i = 0; i < 6; ++i) {
      const auto t = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
      if (!t) return -1;
      level = rig.brightest(*t);
      rig.model.camera().give_back(t->slot);
    }
    return level;
  };
  const int dark = brightest();
  rig.inject("laser-hidden");
  EXPECT_GT(brightest(), dark + 30);
  EXPECT_EQ(rig.status(protocol::reg::status::lasers_measured), 0);
  EXPECT_EQ(rig.model.state().lasers_on, 1);
  EXPECT_EQ(rig.model.state().fault, FaultCode::none);
}

TEST(DeviceFaults, SlipPlayAndWrongStepsMoveTheTableOnly) {
  Rig rig;
  rig.home();
  const auto encoder_deg = [&] {
    std::uint16_t words[4] = {};
    EXPECT_EQ(rig.model.read_input(protocol::reg::axis_status::angle.address(), 4, words), Exception::none);
    return static_cast<double>(protocol::join_turns(protocol::get_s32(words), protocol::get_s32(words + 2))) * 1e-6;
  };
  const auto table_deg = [&] { return rig.model.state().angle_rad / kDegree; };
  const auto go = [&](double deg) {
    ASSERT_EQ(rig.command(protocol::kMove, deg * kDegree), Exception::none);
    rig.live(20 * kMs);
    rig.stand();
    EXPECT_NEAR(encoder_deg(), deg, 0.003);
  };
  const double zero = table_deg();
  rig.inject("motor-slip", {"-2"});
  EXPECT_NEAR(encoder_deg(), 0, 0.003);
  EXPECT_NEAR(table_deg() - zero, -2, 1e-9);
  go(10);
  EXPECT_NEAR(table_deg() - zero, 8, 0.003);
  rig.inject("backlash", {"0.5"});
  go(20);
  EXPECT_NEAR(table_deg() - zero, 18 - 0.25, 0.003);  // dragged along half the play behind
  go(15);
  EXPECT_NEAR(table_deg() - zero, 13 + 0.25, 0.003);
  rig.model.clear_fault("backlash");
  rig.inject("steps-wrong", {"1.1"});
  EXPECT_NEAR(table_deg() - zero, 13, 0.003);  // what is turned already is not changed
  go(25);
  EXPECT_NEAR(table_deg() - zero, 13 + 11, 0.003);
}

TEST(DeviceFaults, DuplicatesAndStepsOfStamps) {
  Rig rig;
  CameraTimeline& camera = rig.model.camera();
  camera.start(rig.model.now_ns());
  const auto next = [&] {
    auto t = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
    EXPECT_TRUE(t);
    if (t) camera.give_back(t->slot);
    return t.value_or(FrameTicket{});
  };
  const std::int64_t period = rig.model.config().camera.period_ns;
  FrameTicket last = next();
  rig.inject("duplicate-frame", {"2"});
  int twins = 0;
  for (int k = 0; k < 6; ++k) {
    const FrameTicket frame = next();
    EXPECT_EQ(frame.sequence, last.sequence + 1);
    twins += frame.stamp_ns == last.stamp_ns ? 1 : 0;
    last = frame;
  }
  EXPECT_EQ(twins, 2);
  rig.inject("stamp-step", {"-400"});
  std::int64_t jump = 0;
  for (int k = 0; k < 6; ++k) {
    const FrameTicket frame = next();
    jump += frame.stamp_ns - last.stamp_ns - period;
    last = frame;
  }
  EXPECT_EQ(jump, -400 * kMs);
}

// A clock that jumps ahead ends leases early; one that goes back must not lengthen them.
TEST(DeviceFaults, AControllerWhoseClockJumpsGoesDark) {
  for (const char* step : {"600", "-2000"}) {
    Rig rig;
    rig.live(3 * kSecond);
    ASSERT_EQ(rig.lease(500), Exception::none);
    rig.live(50 * kMs);
    EXPECT_EQ(rig.model.state().lasers_on, 1);
    rig.inject("clock-step", {step});
    rig.live(10 * kMs);
    EXPECT_EQ(rig.model.state().lasers_on, 0) << step;
    EXPECT_EQ(rig.model.state().fault, step[0] == '-' ? FaultCode::controller_fault : FaultCode::none);
  }
}

TEST(DeviceFaults, AnObjectThatFellIsNotSeenAndOneThatWobblesMoves) {
  Rig rig("cylinder");
  rig.model.camera().start(rig.model.now_ns());
  std::vector<DeviceModel::RenderOrder> orders;
  rig.model.set_render([&](const DeviceModel::RenderOrder& o) {
    rig.painter.paint(o);
    orders.push_back(o);
    return true;
  });
  const auto frames = [&](int count) {
    FrameTicket last;
    for (int k = 0; k < count; ++k) {
      rig.lease(500);
      const auto t = rig.model.advance_to_frame(rig.model.now_ns() + kSecond);
      if (!t) return last;
      last = *t;
      rig.model.camera().give_back(t->slot);
    }
    return last;
  };
  const int lit = rig.brightest(frames(6));
  rig.inject("object-wobble", {"2"});
  rig.inject("vibration", {"0.1"});
  frames(80);
  double farthest = 0, shake = 0;
  for (const auto& order : orders) {
    farthest = std::max(farthest, std::abs(order.pose.x_mm));
    shake = std::max(shake, std::abs(order.camera_turn_rad));
  }
  EXPECT_NEAR(farthest, 2, 0.1);
  EXPECT_NEAR(shake, 0.1 * kDegree, 0.01 * kDegree);
  rig.model.clear_fault("object-wobble");
  rig.model.clear_fault("vibration");
  rig.inject("object-fall");
  EXPECT_LT(rig.brightest(frames(6)), lit - 50);
}

}  // namespace
}  // namespace celadon::sim
