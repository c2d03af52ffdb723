// Whatever is written, pressed, opened or cut, and in whatever order: no light without a lease, none with the interlock
// open, and nothing starts but by a command. The truth is kept here, from the accepted requests alone.

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <array>
#include <memory>

#include "tests/firmware_bridge/core_bench.h"

namespace celadon::test {
namespace {

using protocol::Exception;
namespace reg = protocol::reg;

class Witness {
 public:
  explicit Witness(bool locked_at_start) {
    config_ = test_config();
    config_.locked_at_start = locked_at_start;
    core_ = std::make_unique<ControllerCore>(config_, plant_, 1, 0);
    needs_press_ = locked_at_start;
  }

  // How often the checks saw each state: a property that never gets there proves nothing.
  static inline std::array<long, 7> seen_states{};
  static inline long seen_light = 0, seen_light_in_motion = 0, seen_session_starts = 0;

  void random_event() {
    switch (*rc::gen::inRange(0, 18)) {
      case 17:
        session();
        break;
      case 0:
        plant_.interlock_closed = *rc::gen::weightedElement<bool>({{3, true}, {1, false}});
        break;
      case 1:
        plant_.emergency_stop = *rc::gen::weightedElement<bool>({{3, false}, {1, true}});
        break;
      case 2:
        plant_.button = *rc::gen::arbitrary<bool>();
        break;
      case 3:
        write_random();
        break;
      case 4:
        restart();
        break;
      case 5:
      case 6:
        grant();
        break;
      case 7:
      case 8:
        command();
        break;
      case 9:
        control();
        break;
      case 10:
        plant_.stuck_lasers = *rc::gen::weightedElement<std::uint16_t>({{5, 0}, {1, 1}, {1, 2}});
        break;
      case 11:
        plant_.axis_fault = *rc::gen::weightedElement<FaultCode>({{5, FaultCode::none}, {1, FaultCode::motor_stalled}});
        break;
      case 12:
        read_random();
        break;
      case 13:
        make_ready();
        break;
      case 14:
        move_somewhere();
        break;
      case 15:
        advance_polling(*rc::gen::inRange(1, 8));
        break;
      default:
        advance(*rc::gen::element<std::uint64_t>(1, 100, 20'000, 30'000, 99'000, 400'000, 1'000'000, 6'000'000));
    }
    check();
  }

 private:
  // The deep states need luck otherwise: everything in order, homed and standing.
  void make_ready() {
    plant_.interlock_closed = true;
    plant_.emergency_stop = false;
    plant_.stuck_lasers = 0;
    plant_.axis_fault = FaultCode::none;
    for (const bool down : {false, true, false}) {
      plant_.button = down;
      check();
      advance(30'000);
    }
    advance(2'100'000);
    write(reg::control::clear_fault.address(), {1});
    std::vector<std::uint16_t> home(11);
    home[9] = protocol::kHome;
    home[10] = session_;
    write(protocol::groups::axis_command.base, home);
    advance_polling(10);
  }
  void move_somewhere() {
    std::vector<std::uint16_t> words(11);
    words[10] = *rc::gen::weightedElement<std::uint16_t>({{3, session_}, {1, 9}});
    protocol::put_s32(&words[0], *rc::gen::inRange(-60, 60) * 1'000'000);
    protocol::put_s32(&words[2], *rc::gen::weightedElement<std::int32_t>({{3, 0}, {1, -3}, {1, 3}}));
    protocol::put_u32(&words[4], *rc::gen::element<std::uint32_t>(20'000'000, 180'000'000));
    words[9] = protocol::kMove;
    write(protocol::groups::axis_command.base, words);
    if (*rc::gen::arbitrary<bool>()) advance_polling(15);
  }
  void advance_polling(int polls) {
    for (int i = 0; i < polls; ++i) {
      std::uint16_t word = 0;
      (void)core_->read_input(now_us_, 0, 1, &word);
      advance(400'000);
    }
  }

  void restart() {
    core_ = std::make_unique<ControllerCore>(config_, plant_, ++boots_, now_us_);
    for (std::uint64_t& until : lit_until_us_) until = 0;
    session_ = 0;
    needs_press_ = config_.locked_at_start;
    released_before_ = core_->button_presses();
    quiet_from_us_ = now_us_ + 2'000'000;  // from the highest speed at the test plant's deceleration
    RC_ASSERT(plant_.lasers == 0);
  }

  void grant() {
    const int laser = *rc::gen::inRange(0, 3);
    const std::uint16_t lease = *rc::gen::element<std::uint16_t>(0, 1, 20, 499, 500, 501, 65535);
    if (*rc::gen::arbitrary<bool>()) {
      std::vector<std::uint16_t> words(static_cast<std::size_t>(laser) + 2, protocol::kLeaseUnchanged);
      words.front() = any_token();
      words.back() = lease;
      return write(reg::control::lease_session.address(), words);
    }
    write(static_cast<std::uint16_t>(reg::control::laser_lease.address() + laser), {lease});
  }
  void command() {
    std::vector<std::uint16_t> words(11);
    words[10] = any_token();
    protocol::put_s32(&words[0], *rc::gen::element<std::int32_t>(0, 1, -90'000'000, 359'999'999, 2'000'000'000));
    protocol::put_u32(&words[4], *rc::gen::element<std::uint32_t>(0, 1'000'000, 180'000'000, 180'000'001));
    words[8] = *rc::gen::inRange<std::uint16_t>(0, 4);
    words[9] = *rc::gen::inRange<std::uint16_t>(0, 5);
    write(protocol::groups::axis_command.base, words);
  }
  static std::uint16_t any_token() { return *rc::gen::element<std::uint16_t>(0, 7, 7, 9); }
  void session() {
    write(*rc::gen::element(reg::control::session.address(), reg::control::session_end.address()), {any_token()});
  }
  void control() { write(*rc::gen::inRange<std::uint16_t>(0, 3), {*rc::gen::inRange<std::uint16_t>(0, 3)}); }
  void write_random() {
    const auto count = *rc::gen::inRange<std::size_t>(0, 20);
    const auto words = *rc::gen::container<std::vector<std::uint16_t>>(count, rc::gen::arbitrary<std::uint16_t>());
    write(*rc::gen::inRange<std::uint16_t>(0, 0x60), words);
  }
  void read_random() {
    std::uint16_t words[125];
    const auto address = *rc::gen::element<std::uint16_t>(0, 1, 24, 0x100, 0x140, 0x200, 0xFFFF);
    const auto count = *rc::gen::inRange<std::uint16_t>(0, 125);
    (void)core_->read_input(now_us_, address, count, words);
    (void)core_->read_holding(now_us_, address, count, words);
  }

  void write(std::uint16_t address, const std::vector<std::uint16_t>& words) {
    const std::uint16_t lit = plant_.lasers;
    plant_.inside_write = true;
    const int started = plant_.moves + plant_.homes;
    const auto result = core_->write_holding(now_us_, address, static_cast<std::uint16_t>(words.size()), words.data());
    plant_.inside_write = false;
    note_inputs();
    const bool something_started = plant_.moves + plant_.homes != started || (plant_.lasers & ~lit);
    if (result != Exception::none) RC_ASSERT(!something_started);
    if (something_started) RC_ASSERT(!needs_press_ && plant_.interlock_closed && !plant_.emergency_stop);
    const int first = address - reg::control::laser_lease.address();
    if (result == Exception::none && first >= -1 && address < protocol::groups::control.words) {
      for (std::size_t i = first < 0 ? 1 : 0; i < words.size(); ++i) {
        if (first >= 0 || words[i] != protocol::kLeaseUnchanged)
          lit_until_us_[static_cast<std::size_t>(first + static_cast<int>(i))] = now_us_ + words[i] * 1000u;
      }
    }
    note_session(address, words, result, something_started);
  }

  // Kept from the accepted requests alone: while a session is held, nothing starts without its token.
  void note_session(std::uint16_t address, const std::vector<std::uint16_t>& words, Exception result, bool started) {
    if (now_us_ >= session_until_us_) session_ = 0;
    std::uint16_t token = 0;
    if (address == reg::control::lease_session.address() && !words.empty()) token = words[0];
    const std::size_t place = reg::axis_command::session.address() - std::size_t{address};
    if (address >= protocol::groups::axis_command.base && place < words.size()) token = words[place];
    if (started && session_ != 0) {
      RC_ASSERT(token == session_);
      ++seen_session_starts;
    }
    if (result != Exception::none) return;
    if (address == reg::control::session.address()) {
      RC_ASSERT(session_ == 0 || session_ == words[0]);
      session_ = words[0];
    }
    if (address == reg::control::session_end.address()) session_ = 0;
    // Any accepted command or grant may have kept it: later is safe for the check above only if it really was kept.
    const bool keeps = address == reg::control::session.address() || (started && token == session_);
    if (session_ != 0 && keeps) session_until_us_ = now_us_ + config_.session_timeout_ms * std::uint64_t{1000};
  }

  void advance(std::uint64_t us) {
    const std::uint64_t end = now_us_ + us;
    while (now_us_ < end) {
      std::uint64_t next = std::min(end, now_us_ + 20'000);
      if (core_->next_deadline_us() > now_us_) next = std::min(next, core_->next_deadline_us());
      now_us_ = next;
      core_->step(now_us_);
      check();
    }
  }

  // Opening the lock takes a counted press while interlock and emergency stop allow it.
  void note_inputs() {
    if (core_->button_presses() != released_before_ && plant_.interlock_closed && !plant_.emergency_stop)
      needs_press_ = false;
    released_before_ = core_->button_presses();
    if (!plant_.interlock_closed || plant_.emergency_stop) needs_press_ = true;
  }

  void check() {
    core_->step(now_us_);
    note_inputs();
    for (int laser = 0; laser < 4; ++laser) {
      if (plant_.lasers & (1 << laser)) RC_ASSERT(now_us_ < lit_until_us_[laser]);
    }
    if (!plant_.interlock_closed || plant_.emergency_stop || needs_press_) RC_ASSERT(plant_.lasers == 0);
    if (core_->motion(0) == MotionState::fault) RC_ASSERT(plant_.lasers == 0);
    if (plant_.emergency_stop) RC_ASSERT(plant_.speed_udeg(now_us_) == 0.0);
    RC_ASSERT(plant_.starts_outside_write == 0);
    RC_ASSERT(core_->lasers_enabled() == plant_.lasers);
    const MotionState state = core_->motion(0);
    ++seen_states[static_cast<std::size_t>(state)];
    seen_light += plant_.lasers != 0;
    seen_light_in_motion += plant_.lasers != 0 && state == MotionState::moving;
    // Interlock and emergency stop: no way out of `stopped` while they last.
    if (was_stopped_ && boots_ == boots_then_ && (!plant_.interlock_closed || plant_.emergency_stop))
      RC_ASSERT(state == MotionState::stopped || state == MotionState::fault);
    was_stopped_ = state == MotionState::stopped;
    boots_then_ = boots_;
    const bool expects_motion = state == MotionState::homing || state == MotionState::moving ||
                                state == MotionState::stopped || state == MotionState::fault ||
                                state == MotionState::settling;
    if (!expects_motion && now_us_ >= quiet_from_us_) RC_ASSERT(plant_.speed_udeg(now_us_) == 0.0);
  }

  ControllerConfig config_;
  TestPlant plant_;
  std::unique_ptr<ControllerCore> core_;
  std::uint64_t now_us_ = 0;
  std::uint16_t boots_ = 1;
  std::uint64_t quiet_from_us_ = 0;
  std::uint64_t lit_until_us_[32] = {};
  std::uint16_t session_ = 0;
  std::uint64_t session_until_us_ = 0;
  bool needs_press_ = false;
  bool was_stopped_ = false;
  std::uint16_t boots_then_ = 1;
  std::uint16_t released_before_ = 0;
};

TEST(ControllerCoreProperty, NoLightWithoutLeaseAndNothingStartsByItself) {
  EXPECT_TRUE(rc::check([] {
    Witness witness(*rc::gen::arbitrary<bool>());
    for (int i = 0; i < 500; ++i) witness.random_event();
  }));
  for (const long seen : Witness::seen_states) EXPECT_GT(seen, 0);
  EXPECT_GT(Witness::seen_light, 10);
  EXPECT_GT(Witness::seen_session_starts, 0);
  EXPECT_GT(Witness::seen_light_in_motion, 0);
}

}  // namespace
}  // namespace celadon::test
