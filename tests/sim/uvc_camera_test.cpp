// The USB camera as its host sees it: descriptors, negotiation, payloads in all formats, controls that change the
// picture.

#include "sim/uvc_camera.h"

#include <gtest/gtest.h>
#include <turbojpeg.h>

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <set>

#include "sim/frame_store.h"
#include "sim/model_sensor.h"
#include "sim/usb_controller.h"
#include "tests/sim/pattern_sensor.h"

namespace celadon::sim {
namespace {

constexpr int kWidth = 40, kHeight = 24;
constexpr std::size_t kPixels = kWidth * kHeight;
constexpr std::uint8_t kProbe = 1, kCommit = 2, kToInterface = 0x21, kFromInterface = 0xa1;

/// A host that does what a video driver does.
struct Host {
  explicit Host(CameraSensor& sensor) : camera(sensor, 4'000'000), device({1, 2, "m", "n", "s"}, {&camera}) {}

  std::optional<Bytes> get(std::uint8_t request, int selector, int index, int length) {
    return device.control({kFromInterface, request, static_cast<std::uint16_t>(selector << 8),
                           static_cast<std::uint16_t>(index), static_cast<std::uint16_t>(length)},
                          {});
  }
  bool set(int selector, int index, const Bytes& data) {
    return device
        .control({kToInterface, 1, static_cast<std::uint16_t>(selector << 8), static_cast<std::uint16_t>(index),
                  static_cast<std::uint16_t>(data.size())},
                 data)
        .has_value();
  }
  void negotiate(VideoFormat format) {
    Bytes wanted(26);
    wanted[2] = static_cast<std::uint8_t>(format);
    ASSERT_TRUE(set(kProbe, 1, wanted));
    const auto offered = get(0x81, kProbe, 1, 26);
    ASSERT_TRUE(offered);
    EXPECT_EQ((*offered)[2], wanted[2]);
    most = get_number(std::span(*offered).subspan(22));
    ASSERT_TRUE(set(kCommit, 1, *offered));
  }
  /// One payload, put together from transfers; its first two bytes are the header.
  Bytes payload() {
    Bytes out;
    while (true) {
      UsbIn in = device.read(0x81, transfer);
      EXPECT_EQ(in.status, UsbIn::Status::data);
      if (in.status != UsbIn::Status::data) return out;
      put(out, in.data);
      if (in.data.size() < transfer || out.size() == most) return out;
    }
  }
  /// The pixels of the next frame, after the payload that only begins it.
  Bytes frame() {
    const Bytes begin = payload();
    EXPECT_EQ(begin.size(), 2u);
    Bytes all = payload();
    if (begin.size() != 2 || all.size() < 2) return {};
    EXPECT_NE(begin[1] & 1, toggle) << "a new frame";
    toggle = begin[1] & 1;
    EXPECT_EQ(all[1] & 1, toggle);
    EXPECT_TRUE(all[1] & 2) << "the end";
    error = (all[1] & 0x40) != 0;
    return {all.begin() + 2, all.end()};
  }

  UvcCamera camera;
  UsbDevice device;
  std::size_t transfer = 256, most = 0;
  int toggle = 0;
  bool error = false;
};

TEST(UvcCamera, DescriptorsAreWhole) {
  DeviceModel model(default_device({}));
  PatternSensor sensor(kWidth, kHeight);
  UsbController controller(model);
  UvcCamera camera(sensor, 4'000'000);
  const UsbDevice device({1, 2, "m", "n", "s"}, {&controller, &camera});
  const Bytes all = device.configuration();
  EXPECT_EQ(get_number(std::span(all).subspan(2, 2)), all.size());
  std::set<int> interfaces, endpoints;
  std::size_t at = 0;
  for (; at < all.size() && all[at] >= 2; at += all[at]) {
    if (all[at + 1] == 4) {
      EXPECT_TRUE(interfaces.insert(all[at + 2]).second);
    }
    if (all[at + 1] == 5) {
      EXPECT_TRUE(endpoints.insert(all[at + 2]).second);
    }
  }
  EXPECT_EQ(at, all.size());
  EXPECT_EQ(interfaces, (std::set<int>{0, 1, 2}));
  EXPECT_EQ(endpoints, (std::set<int>{0x81, 0x82, 0x83}));
  EXPECT_EQ(all[4], 3);
}

TEST(UvcCamera, GreyComesBitForBit) {
  PatternSensor sensor(kWidth, kHeight);
  Host host(sensor);
  EXPECT_EQ(host.device.read(0x81, 256).status, UsbIn::Status::nothing_yet) << "not committed";
  host.negotiate(VideoFormat::grey);
  EXPECT_EQ(host.most, kPixels + 2);
  for (int number = 0; number < 5; ++number) {
    const Bytes pixels = host.frame();
    ASSERT_EQ(pixels.size(), kPixels);
    EXPECT_FALSE(host.error);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x)
        ASSERT_EQ(pixels[static_cast<std::size_t>(y * kWidth + x)], PatternSensor::level(number, x, y));
    }
  }
  sensor.corrupt = true;
  (void)host.frame();
  EXPECT_TRUE(host.error);
  // A frame may begin and its pixels come later.
  sensor.waits = 1;
  (void)host.payload();
  EXPECT_EQ(host.device.read(0x81, 256).status, UsbIn::Status::nothing_yet);
  EXPECT_EQ(host.payload().size(), kPixels + 2);
  // The host stops by clearing the halt of the endpoint.
  EXPECT_EQ(sensor.stops, 0);
  ASSERT_TRUE(host.device.control({0x02, 1, 0, 0x81, 0}, {}));
  EXPECT_EQ(sensor.stops, 1);
}

TEST(UvcCamera, YuyvCarriesTheLuma) {
  PatternSensor sensor(kWidth, kHeight);
  Host host(sensor);
  host.negotiate(VideoFormat::yuyv);
  const Bytes pixels = host.frame();
  ASSERT_EQ(pixels.size(), 2 * kPixels);
  for (std::size_t i = 0; i < kPixels; ++i) {
    ASSERT_EQ(pixels[2 * i], PatternSensor::level(0, static_cast<int>(i % kWidth), static_cast<int>(i / kWidth)));
    ASSERT_EQ(pixels[2 * i + 1], 128);
  }
}

TEST(UvcCamera, MjpegIsAPictureThatOthersDecode) {
  PatternSensor sensor(kWidth, kHeight);
  for (const std::size_t transfer : {std::size_t{256}, std::size_t{1}}) {
    Host host(sensor);
    host.negotiate(VideoFormat::mjpeg);
    // A transfer as long as the payload must be followed by an empty one.
    (void)host.frame();
    const int number = sensor.number;
    host.transfer = transfer == 1 ? host.frame().size() + 2 : transfer;
    const int shown = transfer == 1 ? number + 1 : number;
    const Bytes jpeg = host.frame();
    const std::unique_ptr<void, int (*)(tjhandle)> decoder(tjInitDecompress(), tjDestroy);
    int width = 0, height = 0, sampling = 0, colours = 0;
    ASSERT_EQ(tjDecompressHeader3(decoder.get(), jpeg.data(), jpeg.size(), &width, &height, &sampling, &colours), 0);
    EXPECT_EQ(width, kWidth);
    EXPECT_EQ(height, kHeight);
    EXPECT_EQ(sampling, TJSAMP_422);
    Bytes grey(kPixels);
    ASSERT_EQ(tjDecompress2(decoder.get(), jpeg.data(), jpeg.size(), grey.data(), width, 0, height, TJPF_GRAY, 0), 0);
    double off = 0;
    for (std::size_t i = 0; i < kPixels; ++i)
      off +=
          std::abs(grey[i] - PatternSensor::level(shown, static_cast<int>(i % kWidth), static_cast<int>(i / kWidth)));
    EXPECT_LT(off / kPixels, 6) << "mean difference in levels, of a pattern that wraps";
  }
}

TEST(UvcCamera, ColoursComeWithYuyvAndMjpegAndNotWithGrey) {
  PatternSensor sensor(kWidth, kHeight);
  sensor.coloured = true;
  Host host(sensor);
  host.negotiate(VideoFormat::yuyv);
  const Bytes pixels = host.frame();
  ASSERT_EQ(pixels.size(), 2 * kPixels);
  for (std::size_t i = 0; i < kPixels; ++i) ASSERT_EQ(pixels[2 * i + 1], PatternSensor::chroma(static_cast<int>(i)));

  Host jpeg_host(sensor);
  jpeg_host.negotiate(VideoFormat::mjpeg);
  const Bytes jpeg = jpeg_host.frame();
  const std::unique_ptr<void, int (*)(tjhandle)> decoder(tjInitDecompress(), tjDestroy);
  Bytes y(kPixels), u(kPixels / 2), v(kPixels / 2);
  unsigned char* planes[] = {y.data(), u.data(), v.data()};
  ASSERT_EQ(tjDecompressToYUVPlanes(decoder.get(), jpeg.data(), jpeg.size(), planes, kWidth, nullptr, kHeight, 0), 0);
  for (std::size_t i = 0; i < kPixels; i += 2) {
    EXPECT_NEAR(u[i / 2], PatternSensor::chroma(static_cast<int>(i)), 5) << i;
    EXPECT_NEAR(v[i / 2], PatternSensor::chroma(static_cast<int>(i) + 1), 5) << i;
  }

  Host grey_host(sensor);
  grey_host.negotiate(VideoFormat::grey);
  EXPECT_EQ(grey_host.frame().size(), kPixels);
  // Twice the gain is twice as far from grey.
  ASSERT_TRUE(host.set(4, 2 << 8, number(32, 2)));
  const Bytes gained = host.frame();
  ASSERT_EQ(gained.size(), 2 * kPixels);
  for (std::size_t i = 0; i < kPixels; ++i)
    ASSERT_EQ(gained[2 * i + 1], std::clamp(128 + 2 * (PatternSensor::chroma(static_cast<int>(i)) - 128), 0, 255));
}

TEST(UvcCamera, ControlsChangeThePictureAndTellTheirRange) {
  PatternSensor sensor(kWidth, kHeight);
  Host host(sensor);
  constexpr int kExposure = 4, kMode = 2, kTerminal = 1 << 8, kUnit = 2 << 8, kGain = 4;
  EXPECT_EQ(get_number(*host.get(0x81, kExposure, kTerminal, 4)), 40u);
  EXPECT_FALSE(host.set(kExposure, kTerminal, number(100, 4))) << "the automatic has it";
  ASSERT_TRUE(host.set(kMode, kTerminal, {UvcCamera::kManual}));
  EXPECT_FALSE(host.set(kMode, kTerminal, {2}));
  ASSERT_TRUE(host.set(kExposure, kTerminal, number(100, 4)));
  EXPECT_EQ(sensor.exposure_ns, 10'000'000);
  ASSERT_TRUE(host.set(kExposure, kTerminal, number(1'000'000, 4)));
  EXPECT_EQ(sensor.exposure_ns, 204'700'000) << "limited";
  EXPECT_EQ(get_number(*host.get(0x83, kExposure, kTerminal, 4)), 2047u);
  ASSERT_TRUE(host.set(kGain, kUnit, number(40, 2)));
  EXPECT_EQ(get_number(*host.get(0x81, kGain, kUnit, 2)), 40u);
  host.negotiate(VideoFormat::grey);
  const Bytes pixels = host.frame();
  ASSERT_EQ(pixels.size(), kPixels);
  for (std::size_t i = 0; i < kPixels; ++i) {
    const int level = PatternSensor::level(0, static_cast<int>(i % kWidth), static_cast<int>(i / kWidth));
    ASSERT_EQ(pixels[i], std::min(255, (level * 40 + 8) / 16)) << "2.5 times as bright";
  }
  EXPECT_FALSE(host.get(0x81, 9, kUnit, 2)) << "a control that is not there";
  EXPECT_FALSE(host.device.control({0x21, 0x81, 0x400, kUnit, 2}, {})) << "a question sent as an order";
}

// A host notes the time of a frame at its first payload: that must go out at the frame's time stamp, of frames in
// order.
TEST(ModelSensor, AFrameBeginsAtItsStampAndALateOneIsLost) {
  CameraConfig config;
  config.width_px = 64;
  config.height_px = 64;
  DeviceModel model(default_device(config));
  const auto store = *FrameStore::open(model, true);
  ModelSensor sensor(model, *store, 1);
  ASSERT_TRUE(sensor.start());
  EXPECT_FALSE(store->start(2)) << "one client";
  const auto step = [&] { model.advance_to(model.now_ns() + 100'000); };
  const auto begin = [&] {
    for (int i = 0; i < 2000 && !sensor.begin_picture(); ++i) step();
    return model.now_ns();
  };
  const std::int64_t first_ns = begin();
  const FrameTicket* ticket = model.camera().oldest();
  ASSERT_NE(ticket, nullptr);
  EXPECT_GE(first_ns, ticket->stamp_ns);
  EXPECT_LT(first_ns, ticket->stamp_ns + 200'000);
  const std::uint64_t number = ticket->number;
  while (sensor.picture().luma.empty()) step();
  EXPECT_EQ(sensor.picture().luma.size(), 64u * 64u);
  EXPECT_LT(model.now_ns(), first_ns + config.period_ns) << "before the next one begins";
  sensor.end_picture();
  EXPECT_NEAR(static_cast<double>(begin() - first_ns), static_cast<double>(config.period_ns), 2e5);
  EXPECT_EQ(model.camera().oldest()->number, number + 1);
  while (sensor.picture().luma.empty()) step();
  sensor.end_picture();
  // A host that looks away for three frames gets the one that begins then, not an old one.
  model.advance_to(model.now_ns() + 3 * config.period_ns);
  const std::int64_t later_ns = begin();
  EXPECT_LT(later_ns - model.camera().oldest()->stamp_ns, 5'100'000);
  EXPECT_GE(model.camera().oldest()->number, number + 4);
}

}  // namespace
}  // namespace celadon::sim
