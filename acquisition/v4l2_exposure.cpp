#include "acquisition/v4l2_exposure.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <utility>

#include "acquisition/camera_fault.h"
#include "acquisition/v4l2_fault.h"
#include "acquisition/v4l2_ioctl.h"

namespace celadon {
namespace {

using Kind = CameraError::Kind;

constexpr std::int64_t kUnitNs = 100'000;  // of V4L2_CID_EXPOSURE_ABSOLUTE
constexpr const char* kAutoName = "auto_exposure (V4L2_CID_EXPOSURE_AUTO)";
constexpr const char* kTimeName = "exposure_time_absolute (V4L2_CID_EXPOSURE_ABSOLUTE)";

std::optional<std::int32_t> get(int fd, std::uint32_t id) {
  v4l2_control control{.id = id, .value = 0};
  if (v4l2_ioctl(fd, VIDIOC_G_CTRL, &control) != 0) return std::nullopt;
  return control.value;
}

int put(int fd, std::uint32_t id, std::int32_t value) {
  v4l2_control control{.id = id, .value = value};
  return v4l2_ioctl(fd, VIDIOC_S_CTRL, &control);
}

bool is_automatic(std::optional<std::int32_t> mode) {
  return mode && *mode != V4L2_EXPOSURE_MANUAL && *mode != V4L2_EXPOSURE_SHUTTER_PRIORITY;
}

}  // namespace

std::int64_t V4l2Exposure::in_force_ns() const {
  const auto time = get(fd_, V4L2_CID_EXPOSURE_ABSOLUTE);
  if (!time || is_automatic(get(fd_, V4L2_CID_EXPOSURE_AUTO))) return 0;
  return *time * kUnitNs;
}

tl::expected<std::int64_t, CameraError> V4l2Exposure::set(std::int64_t exposure_ns) {
  const std::string operation = "setting the exposure to " + std::to_string(exposure_ns) + " ns";
  const auto fail = [&](const char* control, int code) {
    return tl::unexpected(v4l2_fault(device_, operation + " by its control " + control, code,
                                     "the camera itself works: try another exposure, or set this control by v4l2-ctl "
                                     "to see whether it can be set"));
  };
  v4l2_queryctrl range{};
  range.id = V4L2_CID_EXPOSURE_ABSOLUTE;
  const int code = v4l2_ioctl(fd_, VIDIOC_QUERYCTRL, &range);
  if (code == ENODEV) return fail(kTimeName, code);
  if (code != 0 || (range.flags & V4L2_CTRL_FLAG_DISABLED) != 0) {
    return tl::unexpected(camera_fault(Kind::unsupported, device_, operation,
                                       std::string("the camera has no control ") + kTimeName,
                                       "set the exposure on the camera itself or use one that has this control", code));
  }
  const auto mode = get(fd_, V4L2_CID_EXPOSURE_AUTO);
  if (!std::exchange(touched_, true)) {
    found_time_ = get(fd_, V4L2_CID_EXPOSURE_ABSOLUTE);
    found_auto_ = mode;
  }
  if (is_automatic(mode)) {
    if (const int fault = put(fd_, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL); fault != 0) {
      return fail(kAutoName, fault);
    }
  }
  const std::int64_t units =
      std::clamp<std::int64_t>((exposure_ns + kUnitNs / 2) / kUnitNs, range.minimum, range.maximum);
  if (const int fault = put(fd_, V4L2_CID_EXPOSURE_ABSOLUTE, static_cast<std::int32_t>(units)); fault != 0) {
    return fail(kTimeName, fault);
  }
  const auto in_force = get(fd_, V4L2_CID_EXPOSURE_ABSOLUTE);
  if (!in_force) return fail(kTimeName, errno);
  return *in_force * kUnitNs;
}

bool V4l2Exposure::restore() noexcept {
  // The time first: a device in automatic refuses it.
  if (found_time_) put(fd_, V4L2_CID_EXPOSURE_ABSOLUTE, *found_time_);
  if (found_auto_) put(fd_, V4L2_CID_EXPOSURE_AUTO, *found_auto_);
  found_time_.reset();
  found_auto_.reset();
  return std::exchange(touched_, false);
}

}  // namespace celadon
