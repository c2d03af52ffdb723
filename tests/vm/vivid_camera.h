#pragma once
// A camera of the kernel's vivid driver through the source under test, and what its frames have to say.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <map>
#include <memory>
#include <string>

#include "acquisition/frame.h"
#include "tests/vm/kernel_record.h"

namespace celadon {

constexpr std::int64_t kSecond = 1'000'000'000;
/// The watchdog of a stream that is alive: emulation is slow, and no test measures time.
constexpr std::int64_t kPatience = 60 * kSecond;

inline std::unique_ptr<FrameSource> open_vivid(const std::string& device,
                                               const std::string& options = "?width=640&height=360") {
  auto source = open_frame_source("v4l2:" + device + options);
  EXPECT_TRUE(source) << source.error().message;
  return source ? std::move(*source) : nullptr;
}

/// Mappings of the device in this process.
inline int mappings_of(const std::string& device) {
  std::ifstream maps("/proc/self/maps");
  int count = 0;
  for (std::string line; std::getline(maps, line);) count += line.find(device) != std::string::npos;
  return count;
}

/// The newest frame is the driver's own memory: the picture begins where the kernel said in a mapping of the device.
inline bool is_in_place(const std::string& device, const Frame& frame) {
  return is_mapping(device, frame.bytes().data() - dequeued_buffers().back().data_offset);
}

/// Says of each frame what the kernel said of its buffer, number by number. vivid counts the frames that ought to have
/// been by rounding the time since the start to whole periods, and waits from before it drew the last picture: one that
/// took longer to draw than half a period, as happens under emulation, brings the same number twice
/// (vivid-kthread-cap.c; seen at any place of a stream by a program that only dequeues). The source has to tell just
/// that.
class FrameCheck {
 public:
  explicit FrameCheck(std::string device) : device_(std::move(device)) {}

  void check(const Frame& frame) {
    ASSERT_FALSE(dequeued_buffers().empty());
    const v4l2_buffer said = dequeued_buffers().back();
    EXPECT_EQ(frame.info.sequence, said.sequence);
    EXPECT_EQ(frame.info.stamp_ns, said.timestamp.tv_sec * kSecond + said.timestamp.tv_usec * 1000);
    EXPECT_EQ(frame.info.corrupt, (said.flags & V4L2_BUF_FLAG_ERROR) != 0);
    // The frame is the driver's own memory, of this buffer and no other.
    EXPECT_TRUE(is_in_place(device_, frame));
    const std::uint8_t*& place = places_[said.index];
    if (place == nullptr) place = frame.bytes().data();
    EXPECT_EQ(frame.bytes().data(), place);
    EXPECT_EQ(std::count_if(places_.begin(), places_.end(), [&](const auto& p) { return p.second == place; }), 1);
    const bool follows = has_last_ && said.sequence > last_.sequence;
    EXPECT_EQ(frame.info.lost_before, follows ? said.sequence - last_.sequence - 1 : 0);
    if (has_last_) {
      EXPECT_GE(frame.info.sequence, last_.sequence);
      EXPECT_GT(frame.info.stamp_ns, last_stamp_ns_);
    }
    last_ = said;
    last_stamp_ns_ = frame.info.stamp_ns;
    has_last_ = true;
  }

 private:
  const std::string device_;
  v4l2_buffer last_{};
  std::int64_t last_stamp_ns_ = 0;
  bool has_last_ = false;
  std::map<std::uint32_t, const std::uint8_t*> places_;
};

/// Luma in the middle of each of the eight bars (white, yellow, cyan, green, magenta, red, blue, black of 75 %), below
/// the text that vivid writes.
inline std::array<int, 8> bars(const CameraMode& mode, const Frame& frame) {
  std::array<int, 8> out{};
  const auto row = static_cast<std::size_t>(mode.height_px) * 3 / 4;
  for (std::size_t bar = 0; bar < out.size(); ++bar) {
    const std::size_t x = (2 * bar + 1) * static_cast<std::size_t>(mode.width_px) / (2 * out.size());
    out[bar] = frame.bytes()[row * mode.stride_bytes + x * bytes_per_pixel(mode.format)];
  }
  return out;
}

}  // namespace celadon
