// Another object on the table while the camera runs.
#include <gtest/gtest.h>

#include <map>

#include "tests/sim/device_rig.h"

namespace celadon::sim {
namespace {

struct Taken {
  std::int64_t middle_ns = 0;
  std::vector<std::uint8_t> bytes;
};

// Frames by number; what is on the table changes after so many nanoseconds.
std::map<std::uint64_t, Taken> film(const std::string& scene, const std::string& later, std::int64_t after_ns,
                                    std::int64_t& changed_ns) {
  Rig rig(scene);
  std::map<std::uint64_t, Taken> frames;
  CameraTimeline& camera = rig.model.camera();
  camera.start(rig.model.now_ns());
  changed_ns = rig.model.now_ns() + after_ns;
  const std::int64_t end_ns = rig.model.now_ns() + kSecond / 4;
  const auto take_until = [&](std::int64_t time_ns) {
    while (const auto ticket = rig.model.advance_to_frame(time_ns)) {
      const auto slot = rig.slots.begin() + static_cast<std::ptrdiff_t>(ticket->slot) * 160 * 128;
      frames[ticket->number] = {ticket->first_row_end_ns - ticket->exposure_ns / 2, {slot, slot + 160 * 128}};
      camera.give_back(ticket->slot);
    }
  };
  take_until(changed_ns);
  EXPECT_TRUE(later.empty() || rig.model.put(later));
  take_until(end_ns);
  return frames;
}

TEST(SceneChange, StrikesBetweenTwoFrames) {
  const std::string before = "cylinder-off", after = "board:tags:6x5x9@held:0,0,60,8,-10,30";
  for (const std::int64_t after_ns : {100 * kMs, 107 * kMs, 113 * kMs}) {
    std::int64_t changed = 0, ignored = 0;
    const auto mixed = film(before, after, after_ns, changed), old = film(before, "", after_ns, ignored),
               young = film(after, "", after_ns, ignored);
    ASSERT_GE(mixed.size(), 10u);
    int shown_old = 0, shown_young = 0;
    for (const auto& [number, frame] : mixed) {
      const bool is_old = frame.middle_ns < changed;
      const auto& source = is_old ? old : young;
      ASSERT_TRUE(source.contains(number));
      EXPECT_EQ(frame.bytes, source.at(number).bytes) << "frame " << number;
      ++(is_old ? shown_old : shown_young);
    }
    EXPECT_GE(shown_old, 4);
    EXPECT_GE(shown_young, 4);
    EXPECT_NE(old.begin()->second.bytes, young.begin()->second.bytes);
  }
}

TEST(SceneChange, ThatIsRefusedChangesNothing) {
  Rig rig("cylinder");
  const auto put = rig.model.put("board:tags@nowhere");
  ASSERT_FALSE(put);
  EXPECT_NE(put.error().find("X,Y,Z"), std::string::npos);
  EXPECT_EQ(rig.model.scene().name(), "cylinder");
  EXPECT_EQ(rig.model.scene().truth_r_mm(1, 50), 30);
}

}  // namespace
}  // namespace celadon::sim
