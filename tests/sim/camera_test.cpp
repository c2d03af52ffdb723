#include "sim/camera.h"

#include <gtest/gtest.h>

namespace celadon::sim {
namespace {

constexpr std::int64_t kMs = 1'000'000;

CameraConfig config() {
  CameraConfig c;
  c.width_px = 64;
  c.height_px = 64;
  c.period_ns = 20 * kMs;
  c.readout_ns = 16 * kMs;
  c.delay_ns = 8 * kMs;
  c.slots = 3;
  return c;
}

void run(CameraTimeline& camera, std::int64_t until) {
  camera.advance(until);
  while (FrameTicket* t = camera.take_to_render(until)) camera.mark_rendered(t->number);
}

TEST(Camera, FreeRunsFillsSlotsOldestFirstAndLosesTheRest) {
  CameraTimeline camera(config(), 0);
  camera.start(0);
  run(camera, 400 * kMs);
  // The first three frames hold all slots; later ones are lost while nobody takes them.
  for (std::uint64_t k = 0; k < 3; ++k) {
    const auto frame = camera.take(400 * kMs);
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->sequence, k);
    EXPECT_EQ(frame->slot, k);
    EXPECT_EQ(frame->first_row_end_ns, static_cast<std::int64_t>(k + 1) * 20 * kMs);
    camera.give_back(frame->slot);
  }
  EXPECT_FALSE(camera.take(400 * kMs));
  run(camera, 450 * kMs);
  const auto next = camera.take(450 * kMs);
  ASSERT_TRUE(next);
  EXPECT_EQ(next->sequence, 20U);  // the sensor's count went on
}

TEST(Camera, FramesArriveAfterReadOutAndDelay) {
  CameraTimeline camera(config(), 0);
  camera.start(0);
  run(camera, 20 * kMs + 24 * kMs - 1);
  EXPECT_FALSE(camera.take(20 * kMs + 24 * kMs - 1));
  run(camera, 44 * kMs);
  const auto frame = camera.take(44 * kMs);
  ASSERT_TRUE(frame);
  EXPECT_EQ(frame->stamp_ns, 20 * kMs + config().stamp_latency_ns);
}

TEST(Camera, AFrameThatIsNotRenderedIsNotDelivered) {
  CameraTimeline camera(config(), 0);
  camera.start(0);
  camera.advance(100 * kMs);
  EXPECT_FALSE(camera.take(100 * kMs));
  FrameTicket* ticket = camera.take_to_render(100 * kMs);
  ASSERT_NE(ticket, nullptr);
  camera.mark_rendered(ticket->number);
  EXPECT_TRUE(camera.take(100 * kMs));
}

TEST(Camera, ExposureChangesOnlyFramesNotYetBegun) {
  CameraTimeline camera(config(), 0);
  camera.start(0);
  camera.advance(10 * kMs);
  EXPECT_EQ(camera.set_exposure(15 * kMs, 18 * kMs), 15 * kMs);
  run(camera, 100 * kMs);
  EXPECT_EQ(camera.take(100 * kMs)->exposure_ns, 4 * kMs);   // exposed from 16 ms
  EXPECT_EQ(camera.take(100 * kMs)->exposure_ns, 15 * kMs);  // from 25 ms
  EXPECT_EQ(camera.set_exposure(INT64_MAX, 0), 20 * kMs - kMs / 10);
  EXPECT_EQ(camera.set_exposure(-1, 0), 20'000);
}

TEST(Camera, GivingBackWhatWasNotTakenIsHarmless) {
  CameraTimeline camera(config(), 0);
  camera.give_back(77);
  camera.start(0);
  camera.advance(25 * kMs);
  camera.give_back(0);  // being filled
  run(camera, 100 * kMs);
  EXPECT_EQ(camera.take(100 * kMs)->slot, 0U);
}

TEST(Camera, LostFramesLeaveAGap) {
  CameraTimeline camera(config(), 0);
  camera.start(0);
  camera.lose_next(2);
  run(camera, 90 * kMs);
  EXPECT_EQ(camera.take(90 * kMs)->sequence, 2U);
}

}  // namespace
}  // namespace celadon::sim
