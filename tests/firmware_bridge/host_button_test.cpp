// A button at the computer that comes and goes, as a fake stream of edges.

#include "firmware_bridge/host_button.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware_bridge/button_url.h"

namespace celadon {
namespace {

using ::testing::HasSubstr;

constexpr std::int64_t kMs = 1'000'000;

/// What stands before the computer.
struct Contact {
  bool plugged = true, down = false;
  int openings = 0;
  std::vector<ButtonEdge> waiting;

  void edge(bool to, std::int64_t time_ns) {
    down = to;
    if (plugged) waiting.push_back({to, time_ns});
  }
  HostButton::Open opener() {
    return [this]() -> tl::expected<std::unique_ptr<ButtonSource>, ButtonError> {
      ++openings;
      if (!plugged) return tl::unexpected(ButtonError{"there is none", false});
      waiting.clear();
      return std::make_unique<Source>(*this);
    };
  }

  class Source final : public ButtonSource {
   public:
    explicit Source(Contact& contact) : contact_(contact), down_(contact.down) {}
    bool down_at_open() const override { return down_; }
    tl::expected<void, ButtonError> read(std::vector<ButtonEdge>& edges) override {
      edges.insert(edges.end(), contact_.waiting.begin(), contact_.waiting.end());
      contact_.waiting.clear();
      if (!contact_.plugged) return tl::unexpected(ButtonError{"it was unplugged", false});
      return {};
    }

   private:
    Contact& contact_;
    const bool down_;
  };
};

TEST(HostButton, ItsDepartureIsToldOnceAndSoIsItsReturn) {
  Contact contact;
  HostButton button(contact.opener(), {});
  EXPECT_FALSE(button.look(0));
  contact.plugged = false;
  EXPECT_EQ(button.look(10 * kMs), "it was unplugged");
  EXPECT_EQ(button.problem(), "it was unplugged");
  EXPECT_FALSE(button.look(500 * kMs));
  EXPECT_EQ(contact.openings, 1) << "it is looked for once a second";
  EXPECT_EQ(button.look(1'100 * kMs), "there is none");
  EXPECT_FALSE(button.look(2'200 * kMs)) << "the same once more";
  contact.plugged = true;
  EXPECT_TRUE(button.look(3'300 * kMs));
  EXPECT_EQ(button.problem(), "");
  EXPECT_FALSE(button.look(3'310 * kMs));
}

TEST(HostButton, PressesAroundADepartureAreToldOnce) {
  Contact contact;
  HostButton button(contact.opener(), {});
  button.look(0);
  // Pressed and unplugged before anybody looked.
  contact.edge(true, 100 * kMs);
  contact.edge(false, 200 * kMs);
  contact.edge(true, 300 * kMs);  // this one is cut off
  contact.plugged = false;
  button.look(400 * kMs);
  EXPECT_EQ(button.presses().take(), PressLength::brief);
  EXPECT_FALSE(button.presses().take());
  // Held when it comes back: no press, neither short nor long.
  contact.plugged = true;
  button.look(1'500 * kMs);
  contact.edge(false, 9'000 * kMs);
  button.look(9'100 * kMs);
  EXPECT_FALSE(button.presses().take());
  contact.edge(true, 9'200 * kMs);
  button.look(11'300 * kMs);
  EXPECT_EQ(button.presses().take(), PressLength::lasting);
}

TEST(HostButton, AnEdgeThatReachesTheQueueLateIsNotOvertaken) {
  Contact contact;
  HostButton button(contact.opener(), {});
  button.look(0);
  contact.edge(true, 100 * kMs);
  button.look(121 * kMs);
  contact.edge(false, 117 * kMs);  // a bounce, read after its time
  button.look(125 * kMs);
  EXPECT_FALSE(button.presses().use_begun());
}

TEST(ButtonUrl, PartsAreFound) {
  const auto any = parse_button_url("evdev:/dev/input/by-path/pci-0000:00:14.0-usb-0:1:1.0-event-kbd");
  ASSERT_TRUE(any) << any.error();
  EXPECT_EQ(std::get<EvdevPlace>(*any).path, "/dev/input/by-path/pci-0000:00:14.0-usb-0:1:1.0-event-kbd");
  EXPECT_EQ(std::get<EvdevPlace>(*any).key, -1);
  const auto key = parse_button_url("evdev:/dev/input/event3:KEY_PROG1");
  ASSERT_TRUE(key) << key.error();
  EXPECT_EQ(std::get<EvdevPlace>(*key).path, "/dev/input/event3");
  EXPECT_EQ(std::get<EvdevPlace>(*key).key, 148);  // linux/input-event-codes.h
  const auto line = parse_button_url("gpio:gpiochip0:17?active=high");
  ASSERT_TRUE(line) << line.error();
  EXPECT_EQ(std::get<GpioPlace>(*line).chip, "gpiochip0");
  EXPECT_EQ(std::get<GpioPlace>(*line).line, "17");
  EXPECT_FALSE(std::get<GpioPlace>(*line).active_low);
  EXPECT_TRUE(std::get<GpioPlace>(*parse_button_url("gpio:0:START")).active_low);
}

TEST(ButtonUrl, WhatIsWrongIsNamed) {
  for (const auto& [url, word] :
       std::vector<std::pair<const char*, const char*>>{{"joystick:0", "neither evdev: nor gpio:"},
                                                        {"evdev:", "path"},
                                                        {"evdev:event3", "\"event3\" is not the path"},
                                                        {"evdev:/dev/input/event3:KEY_NONSENSE", "KEY_NONSENSE"},
                                                        {"gpio:gpiochip0", "\"gpiochip0\" is not CHIP:LINE"},
                                                        {"gpio::3", "CHIP:LINE"},
                                                        {"gpio:gpiochip0:", "CHIP:LINE"},
                                                        {"gpio:gpiochip0:3?pull=up", "\"pull=up\" is not active="}}) {
    const auto checked = check_button_url(url);
    ASSERT_FALSE(checked) << url;
    EXPECT_TRUE(checked.error().wrong_address);
    EXPECT_THAT(checked.error().message, HasSubstr(word)) << url;
    EXPECT_THAT(checked.error().message, HasSubstr("give evdev:")) << url;
    EXPECT_FALSE(open_button(url));
  }
}

TEST(ButtonSource, AnAbsentDeviceIsNamedWithARemedy) {
  const auto key = open_button("evdev:/dev/input/by-id/absent");
  ASSERT_FALSE(key);
  EXPECT_FALSE(key.error().wrong_address);
  EXPECT_EQ(
      key.error().message,
      "The button evdev:/dev/input/by-id/absent cannot be used: there is no /dev/input/by-id/absent; plug it in, or "
      "name another.");
  const auto file = open_button("evdev:/dev/null");
  ASSERT_FALSE(file);
  EXPECT_THAT(file.error().message, HasSubstr("it is no input device"));
  const auto line = open_button("gpio:absent:3");
  ASSERT_FALSE(line);
  EXPECT_THAT(line.error().message, HasSubstr("there is no GPIO chip absent; gpiodetect lists the chips."));
}

}  // namespace
}  // namespace celadon
