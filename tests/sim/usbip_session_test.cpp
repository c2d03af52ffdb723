// USB/IP byte by byte, as the kernel's documentation prints it, and what clients do that are none.

#include "sim/usbip_session.h"

#include <gtest/gtest.h>

#include <cerrno>
#include <random>

#include "sim/usb_controller.h"
#include "sim/uvc_camera.h"
#include "tests/sim/pattern_sensor.h"

namespace celadon::sim {
namespace {

using Offer = UsbipSession::Offer;

void put_big(Bytes& out, std::uint32_t value, int count) {
  for (int i = count - 1; i >= 0; --i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}
std::uint32_t big(const Bytes& b, std::size_t at) {
  return (std::uint32_t{b[at]} << 24) | (std::uint32_t{b[at + 1]} << 16) | (std::uint32_t{b[at + 2]} << 8) | b[at + 3];
}

Bytes list_request() {
  return {0x01, 0x11, 0x80, 0x05, 0, 0, 0, 0};
}
Bytes import_request(const std::string& bus_id = "1-1") {
  Bytes out{0x01, 0x11, 0x80, 0x03, 0, 0, 0, 0};
  for (std::size_t i = 0; i < 32; ++i) out.push_back(i < bus_id.size() ? static_cast<std::uint8_t>(bus_id[i]) : 0);
  return out;
}
Bytes submit(std::uint32_t number, bool in, std::uint32_t endpoint, std::uint32_t length, const Bytes& setup = Bytes(8),
             const Bytes& data = {}) {
  Bytes out;
  for (const std::uint32_t word :
       {1U, number, UsbipSession::kDeviceId, in ? 1U : 0U, endpoint, 0U, length, 0U, 0xffffffffU, 0U})
    put_big(out, word, 4);
  put(out, setup);
  put(out, data);
  return out;
}
Bytes unlink(std::uint32_t number, std::uint32_t unlinked) {
  Bytes out;
  for (const std::uint32_t word : {2U, number, UsbipSession::kDeviceId, 0U, 0U, unlinked}) put_big(out, word, 4);
  out.resize(48);
  return out;
}

struct Rig {
  Rig() : model(default_device(small())) {}
  static CameraConfig small() {
    CameraConfig camera;
    camera.width_px = 64;
    camera.height_px = 64;
    return camera;
  }
  /// The client says it; @returns the answers
  Bytes say(const Bytes& bytes, Offer offer = Offer::free) {
    session.receive(bytes, offer);
    return std::exchange(session.output(), {});
  }
  DeviceModel model;
  PatternSensor sensor{40, 24};
  UsbController controller{model};
  UvcCamera camera{sensor, 4'000'000};
  UsbDevice device{{0x1209, 1, "Celadon", "Camera", "S1"}, {&controller, &camera}};
  UsbipSession session{device, UsbipSession::Beginning::request};
};

TEST(Usbip, ListsTheDeviceAndItsInterfaces) {
  Rig rig;
  const Bytes list = rig.say(list_request());
  ASSERT_EQ(list.size(), 12u + 312 + 3 * 4);
  EXPECT_EQ(big(list, 0), 0x01110005u);
  EXPECT_EQ(big(list, 8), 1u);
  EXPECT_EQ(std::string(list.begin() + 12 + 256, list.begin() + 12 + 259), "1-1");
  EXPECT_EQ(big(list, 12 + 256 + 32 + 12), 0x12090001u);
  EXPECT_EQ(list[list.size() - 12], 0xff);
  EXPECT_EQ(list[list.size() - 8], 0x0e);
  EXPECT_TRUE(rig.session.finished());
  Rig taken;
  EXPECT_EQ(big(taken.say(list_request(), Offer::taken), 8), 0u);
}

TEST(Usbip, OneHostHasTheDevice) {
  for (const auto& [offer, name, status] :
       {std::tuple{Offer::taken, "1-1", 2U}, {Offer::absent, "1-1", 4U}, {Offer::free, "1-2", 1U}}) {
    Rig rig;
    const Bytes answer = rig.say(import_request(name), offer);
    EXPECT_EQ(answer.size(), 8u);
    EXPECT_EQ(big(answer, 4), status);
    EXPECT_TRUE(rig.session.finished());
    EXPECT_FALSE(rig.session.imported());
  }
  Rig rig;
  EXPECT_EQ(rig.say(import_request()).size(), 8u + 312);
  EXPECT_TRUE(rig.session.imported());
}

TEST(Usbip, TransfersAreAnsweredWhenTheDeviceHasSomething) {
  Rig rig;
  (void)rig.say(import_request());
  // A control request in two pieces, with its refusal after it.
  const Bytes ask = submit(7, true, 0, 18, {0x80, 6, 0, 1, 0, 0, 18, 0});
  EXPECT_TRUE(rig.say(Bytes(ask.begin(), ask.begin() + 20)).empty());
  const Bytes descriptor = rig.say(Bytes(ask.begin() + 20, ask.end()));
  ASSERT_EQ(descriptor.size(), 48u + 18);
  EXPECT_EQ(big(descriptor, 0), 3u);
  EXPECT_EQ(big(descriptor, 4), 7u);
  EXPECT_EQ(big(descriptor, 24), 18u);
  EXPECT_EQ(Bytes(descriptor.begin() + 48, descriptor.end()), rig.device.device_descriptor());
  const Bytes stall = rig.say(submit(8, true, 0, 2, {0xc1, 99, 0, 0, 0, 0, 2, 0}));
  EXPECT_EQ(static_cast<int>(big(stall, 20)), -EPIPE);
  const Bytes written = rig.say(submit(9, false, 0, 2, {0x41, 3, 0, 0, 0, 0, 2, 0}, {0, 1}));  // make_safe
  EXPECT_EQ(big(written, 20), 0u);
  EXPECT_EQ(big(written, 24), 2u);
  // The event endpoint: the first state at once, the next when something changes.
  EXPECT_TRUE(rig.say(submit(10, true, 1, 64)).empty());
  rig.session.advance();
  EXPECT_EQ(std::exchange(rig.session.output(), {}).size(), 48u + protocol::usb::kEventBytes);
  EXPECT_TRUE(rig.say(submit(11, true, 1, 64)).empty());
  rig.session.advance();
  EXPECT_TRUE(rig.session.output().empty());
  rig.model.press(100'000'000);
  rig.model.advance_to(rig.model.now_ns() + 50'000'000);
  rig.session.advance();
  EXPECT_EQ(big(std::exchange(rig.session.output(), {}), 4), 11u);
  // What is given up is not answered.
  EXPECT_TRUE(rig.say(submit(12, true, 1, 64)).empty());
  const Bytes gone = rig.say(unlink(13, 12));
  ASSERT_EQ(gone.size(), 48u);
  EXPECT_EQ(big(gone, 0), 4u);
  EXPECT_EQ(static_cast<int>(big(gone, 20)), -ECONNRESET);
  EXPECT_EQ(big(rig.say(unlink(14, 12)), 20), 0u) << "it is no longer there";
}

TEST(Usbip, ClientsThatAreNoneAreSentAway) {
  Bytes isochronous = submit(1, true, 3, 64);
  isochronous[35] = 4;  // number of packets
  isochronous[32] = isochronous[33] = isochronous[34] = 0;
  Bytes command = submit(1, true, 1, 64);
  command[3] = 9;
  for (const Bytes& bad : {isochronous, command, submit(1, true, 1, 0x7fffffff), submit(1, false, 0, 0xffffffff)}) {
    Rig rig;
    (void)rig.say(import_request());
    EXPECT_TRUE(rig.say(bad).empty());
    EXPECT_TRUE(rig.session.finished());
  }
  Rig http;
  (void)http.say({'G', 'E', 'T', ' ', '/', ' ', 'H', 'T'});
  EXPECT_TRUE(http.session.finished());
  Rig flood;
  (void)flood.say(import_request());
  for (std::uint32_t i = 0; i < 300; ++i) (void)flood.say(submit(i, true, 1, 64));
  EXPECT_TRUE(flood.session.finished()) << "more transfers than any driver keeps";
}

// A seeded sample of what the fuzzer does at length: valid messages with bytes changed, cut and repeated.
TEST(Usbip, MutatedStreamsNeverGetMoreThanTheyMay) {
  std::mt19937 random(11);
  const auto draw = [&random](int below) { return static_cast<int>(random() % static_cast<unsigned>(below)); };
  Rig rig;
  for (int run = 0; run < 3000; ++run) {
    UsbipSession session(rig.device,
                         run % 8 == 0 ? UsbipSession::Beginning::request : UsbipSession::Beginning::attached);
    Bytes stream = run % 8 == 0 ? import_request() : Bytes();
    for (int k = draw(6); k >= 0; --k) {
      Bytes setup(8);
      for (std::uint8_t& b : setup) b = static_cast<std::uint8_t>(draw(4) == 0 ? draw(256) : draw(8));
      setup[0] = std::array<std::uint8_t, 6>{0x80, 0x00, 0xc1, 0x41, 0xa1, 0x21}[static_cast<std::size_t>(draw(6))];
      const bool in = (setup[0] & 0x80) != 0;
      const auto length = static_cast<std::uint32_t>(draw(64));
      put(stream, submit(static_cast<std::uint32_t>(k), in, 0, length, setup, Bytes(in ? 0 : length, 1)));
      put(stream, submit(100, true, static_cast<std::uint32_t>(draw(5)), static_cast<std::uint32_t>(draw(20000))));
      if (draw(4) == 0) put(stream, unlink(200, 100));
    }
    for (int k = draw(4); k > 0; --k) stream[static_cast<std::size_t>(draw(static_cast<int>(stream.size())))] ^= 0x40;
    for (std::size_t at = 0; at < stream.size() && !session.finished();) {
      const std::size_t count = std::min(stream.size() - at, static_cast<std::size_t>(1 + draw(200)));
      session.receive(std::span(stream).subspan(at, count), Offer::free);
      session.advance();
      ASSERT_LT(session.output().size(), std::size_t{8} << 20);
      at += count;
    }
    rig.device.reset();
  }
}

}  // namespace
}  // namespace celadon::sim
