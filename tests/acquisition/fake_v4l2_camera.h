#pragma once
// A V4L2 camera behind an ioctl() of our own: controls as uvcvideo has them (time in 100 us, refused while the
// automatic is on), streaming from a file, single-planar or multi-planar.

#include <linux/videodev2.h>

#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "acquisition/frame.h"

namespace celadon {

/// One at a time. Frame n has the byte n in every pixel, and the byte 255 - n in whatever else the driver fills.
class FakeCamera {
 public:
  static constexpr std::uint32_t kWidth = 64, kHeight = 64, kFrameBytes = kWidth * kHeight;

  FakeCamera();
  ~FakeCamera();
  FakeCamera(const FakeCamera&) = delete;
  FakeCamera& operator=(const FakeCamera&) = delete;

  std::string address() const { return "v4l2:" + name_; }
  /// Adds a failure to the test where it cannot be opened.
  std::unique_ptr<FrameSource> open(const std::string& options = "") const;

  bool is(int fd) const;
  /// @returns 0 or an errno
  int answer(unsigned long request, void* argument);

  static FakeCamera* present;
  std::map<std::uint32_t, std::int32_t> controls = {{V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_APERTURE_PRIORITY},
                                                    {V4L2_CID_EXPOSURE_ABSOLUTE, 156}};
  std::map<std::uint32_t, const char*> names = {{V4L2_CID_GAIN, "Gain"},
                                                {V4L2_CID_AUTO_WHITE_BALANCE, "White Balance, Automatic"},
                                                {V4L2_CID_WHITE_BALANCE_TEMPERATURE, "White Balance Temperature"},
                                                {V4L2_CID_FOCUS_AUTO, "Focus, Automatic Continuous"},
                                                {V4L2_CID_FOCUS_ABSOLUTE, "Focus, Absolute"},
                                                {V4L2_CID_POWER_LINE_FREQUENCY, "Power Line Frequency"}};
  std::vector<std::uint32_t> order;  ///< of the controls that were set, or tried to
  std::set<unsigned long> failing;   ///< requests
  std::uint32_t unreadable = 0, unwritable = 0;
  std::int32_t step = 1;  ///< values are rounded down to it
  bool unplugged = false;
  std::int64_t stamp_ns = 0;  ///< of the frames to come
  bool maps_nothing = false;  ///< frames only into memory of the program's

  /// At most, of a plane of a picture: GREY, NV12 in one plane, two bytes a pixel, or the planes of NM12.
  std::uint32_t plane_bytes(std::uint32_t plane) const;

  std::uint32_t fourcc = V4L2_PIX_FMT_GREY;
  std::uint32_t planes = 0;           ///< of the multi-planar interface; 0: the single-planar one
  std::uint32_t data_offset = 0;      ///< of the first plane
  std::vector<std::uint8_t> content;  ///< of each frame's first plane instead, as many as plane_bytes(0)
  // Lies of the driver.
  std::uint32_t told_planes = 0;                ///< of a buffer; 0: the truth
  std::uint32_t told_index = 0, told_used = 0;  ///< of the frames to come; 0: the truth

 private:
  struct Place {
    unsigned long address;
    std::uint32_t bytes;
  };
  v4l2_buf_type type() const;
  std::uint32_t plane_count() const { return planes == 0 ? 1 : planes; }
  int answer_control(unsigned long request, void* argument);
  int answer_stream(unsigned long request, void* argument);
  void describe(v4l2_format& format) const;
  void describe(v4l2_buffer& buffer) const;
  int take(const v4l2_buffer& buffer);
  int fill(v4l2_buffer& buffer);
  bool is_automatic() const;

  std::string name_;
  int fd_ = -1;
  std::vector<std::uint32_t> queued_;
  std::map<std::uint32_t, std::vector<Place>> places_;  ///< in the program, of each buffer's planes
  std::uint32_t sequence_ = 0;
};

}  // namespace celadon
