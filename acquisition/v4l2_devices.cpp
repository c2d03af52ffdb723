#include "acquisition/v4l2_devices.h"

#include <fcntl.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <charconv>
#include <cstring>
#include <system_error>

#include "acquisition/camera_fault.h"
#include "acquisition/file_descriptor.h"
#include "acquisition/v4l2_address.h"
#include "acquisition/v4l2_capture.h"
#include "acquisition/v4l2_ioctl.h"
#include "acquisition/v4l2_text.h"

namespace celadon {
namespace {

using Kind = CameraError::Kind;

// More of anything than any driver has: an enumeration that does not end is a driver's fault.
constexpr std::uint32_t kMostFormats = 256, kMostSizes = 1024, kMostRates = 256;

double rate_of(const v4l2_fract& period) {
  return period.numerator == 0 ? 0 : static_cast<double>(period.denominator) / period.numerator;
}

std::vector<double> rates_of(int fd, std::uint32_t fourcc, std::uint32_t width, std::uint32_t height) {
  std::vector<double> rates;
  for (std::uint32_t i = 0; i < kMostRates; ++i) {
    v4l2_frmivalenum interval{};
    interval.index = i;
    interval.pixel_format = fourcc;
    interval.width = width;
    interval.height = height;
    if (v4l2_ioctl(fd, VIDIOC_ENUM_FRAMEINTERVALS, &interval) != 0) break;
    if (interval.type == V4L2_FRMIVAL_TYPE_DISCRETE) {
      rates.push_back(rate_of(interval.discrete));
      continue;
    }
    rates.push_back(rate_of(interval.stepwise.min));
    rates.push_back(rate_of(interval.stepwise.max));
    break;
  }
  std::sort(rates.rbegin(), rates.rend());
  return rates;
}

std::vector<V4l2Size> sizes_of(int fd, std::uint32_t fourcc) {
  std::vector<V4l2Size> sizes;
  const auto add = [&](std::uint32_t width, std::uint32_t height) {
    sizes.push_back({width, height, rates_of(fd, fourcc, width, height)});
  };
  for (std::uint32_t i = 0; i < kMostSizes; ++i) {
    v4l2_frmsizeenum size{};
    size.index = i;
    size.pixel_format = fourcc;
    if (v4l2_ioctl(fd, VIDIOC_ENUM_FRAMESIZES, &size) != 0) break;
    if (size.type == V4L2_FRMSIZE_TYPE_DISCRETE) {
      add(size.discrete.width, size.discrete.height);
      continue;
    }
    add(size.stepwise.min_width, size.stepwise.min_height);
    add(size.stepwise.max_width, size.stepwise.max_height);
    break;
  }
  return sizes;
}

std::vector<V4l2Format> formats_of(int fd, v4l2_buf_type type) {
  std::vector<V4l2Format> formats;
  for (std::uint32_t i = 0; i < kMostFormats; ++i) {
    v4l2_fmtdesc format{};
    format.type = type;
    format.index = i;
    if (v4l2_ioctl(fd, VIDIOC_ENUM_FMT, &format) != 0) break;
    const std::uint32_t fourcc = format.pixelformat;
    formats.push_back({fourcc, printable(format.description, sizeof format.description), usable_fourcc(fourcc),
                       sizes_of(fd, fourcc)});
  }
  return formats;
}

/// The device of a node; nothing if it captures no video.
std::optional<V4l2Device> device_of(const std::string& path) {
  V4l2Device device;
  device.path = path;
  const FileDescriptor file(::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
  if (file.get() < 0) {
    const int code = errno;
    device.problem = path + " cannot be opened: " + std::strerror(code) +
                     (code == EACCES ? "; add yourself to the group video" : "; connect the camera again") + ".";
    return device;
  }
  v4l2_capability capability{};
  if (v4l2_ioctl(file.get(), VIDIOC_QUERYCAP, &capability) != 0) return std::nullopt;
  const auto type = capture_type_of(capability);
  if (!type) return std::nullopt;
  device.name = printable(capability.card, sizeof capability.card);
  device.driver = printable(capability.driver, sizeof capability.driver);
  device.bus = printable(capability.bus_info, sizeof capability.bus_info);
  device.serial = usb_serial_of(path);
  device.formats = formats_of(file.get(), *type);
  device.controls = list_v4l2_controls(file.get());
  return device;
}

/// Of the nodes there, in their order.
std::vector<int> video_numbers(const std::filesystem::path& nodes) {
  std::vector<int> numbers;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(nodes, error)) {
    const std::string name = entry.path().filename().string();
    constexpr std::string_view kPrefix = "video";
    int number = 0;
    if (!name.starts_with(kPrefix)) continue;
    const auto parsed = std::from_chars(name.data() + kPrefix.size(), name.data() + name.size(), number);
    if (parsed.ec == std::errc{} && parsed.ptr == name.data() + name.size()) numbers.push_back(number);
  }
  std::sort(numbers.begin(), numbers.end());
  return numbers;
}

std::string node_of(int number) {
  return "/dev/video" + std::to_string(number);
}

}  // namespace

std::vector<V4l2Device> list_v4l2_devices(const std::filesystem::path& nodes) {
  std::vector<V4l2Device> devices;
  for (const int number : video_numbers(nodes))
    if (auto device = device_of(node_of(number))) devices.push_back(std::move(*device));
  return devices;
}

tl::expected<std::string, CameraError> find_v4l2_device(const std::string& serial, const std::filesystem::path& nodes) {
  std::vector<std::string> found;
  for (const int number : video_numbers(nodes)) {
    if (usb_serial_at(nodes / ("video" + std::to_string(number))) != serial) continue;
    // One that cannot be opened is taken for the camera: opening it says why.
    const FileDescriptor file(::open(node_of(number).c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
    v4l2_capability capability{};
    if (!file || (v4l2_ioctl(file.get(), VIDIOC_QUERYCAP, &capability) == 0 && capture_type_of(capability)))
      found.push_back(node_of(number));
  }
  if (found.size() == 1) return found.front();
  const std::string device = "v4l2:serial=" + serial, operation = "looking for it";
  if (found.empty()) {
    return tl::unexpected(camera_fault(Kind::not_found, device, operation,
                                       "no camera with this serial number is on USB",
                                       "connect it; `celadon cameras` lists those that are there"));
  }
  std::string names;
  for (const std::string& name : found) names += (names.empty() ? "" : ", ") + name;
  return tl::unexpected(camera_fault(Kind::unsupported, device, operation, "several have this serial number: " + names,
                                     "give one by its place, v4l2:/dev/v4l/by-path/NAME"));
}

std::string address_of(const V4l2Device& device, std::span<const V4l2Device> listed) {
  const auto same = std::count_if(listed.begin(), listed.end(),
                                  [&](const V4l2Device& other) { return other.serial == device.serial; });
  // What parts an address from its options cannot be in it.
  const bool named = !device.serial.empty() && same == 1 && device.serial.find('?') == std::string::npos;
  return "v4l2:" + (named ? "serial=" + device.serial : device.path);
}

const V4l2Format* preferred_format(const V4l2Device& device) {
  std::vector<std::uint32_t> delivered;
  for (const V4l2Format& format : device.formats) delivered.push_back(format.fourcc);
  const auto preferred = preferred_fourcc(delivered);
  for (const V4l2Format& format : device.formats)
    if (format.fourcc == preferred) return &format;
  return nullptr;
}

}  // namespace celadon
