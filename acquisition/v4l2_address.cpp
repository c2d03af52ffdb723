#include "acquisition/v4l2_address.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <charconv>

#include "acquisition/camera_fault.h"

namespace celadon {

namespace {

// The better one first.
constexpr std::uint32_t kUsable[] = {
    V4L2_PIX_FMT_GREY,   V4L2_PIX_FMT_Y10,    V4L2_PIX_FMT_Y12,     V4L2_PIX_FMT_Y16,
    V4L2_PIX_FMT_NV12,   V4L2_PIX_FMT_NV12M,  V4L2_PIX_FMT_YUV420M, V4L2_PIX_FMT_YUYV,
    V4L2_PIX_FMT_UYVY,   V4L2_PIX_FMT_NV16M,  V4L2_PIX_FMT_SBGGR8,  V4L2_PIX_FMT_SGBRG8,
    V4L2_PIX_FMT_SGRBG8, V4L2_PIX_FMT_SRGGB8, V4L2_PIX_FMT_MJPEG,   V4L2_PIX_FMT_JPEG};

}  // namespace

std::optional<std::uint32_t> preferred_fourcc(std::span<const std::uint32_t> delivered) {
  for (const std::uint32_t fourcc : kUsable)
    if (std::find(delivered.begin(), delivered.end(), fourcc) != delivered.end()) return fourcc;
  return std::nullopt;
}

bool usable_fourcc(std::uint32_t fourcc) {
  return std::find(std::begin(kUsable), std::end(kUsable), fourcc) != std::end(kUsable);
}

std::string fourcc_text(std::uint32_t fourcc) {
  std::string text;
  for (int i = 0; i < 4; ++i) {
    const char c = static_cast<char>((fourcc >> (8 * i)) & 0x7f);
    text += c >= ' ' && c < 0x7f ? c : '?';
  }
  text.erase(text.find_last_not_of(' ') + 1);
  return text.empty() ? "?" : text;
}

std::string usable_formats() {
  std::string text;
  for (const std::uint32_t fourcc : kUsable) text += (text.empty() ? "" : ", ") + fourcc_text(fourcc);
  return text;
}

tl::expected<V4l2Address, CameraError> parse_v4l2_address(const std::string& text) {
  const std::size_t question = text.find('?');
  const std::string camera = text.substr(0, question);
  constexpr std::string_view kSerial = "serial=";
  const bool by_serial = camera.starts_with(kSerial) && camera.size() > kSerial.size();
  V4l2Address address{.path = by_serial ? "" : camera,
                      .serial = by_serial ? camera.substr(kSerial.size()) : "",
                      .width = {},
                      .height = {},
                      .fourcc = {},
                      .controls = {}};
  std::string rest = question == std::string::npos ? "" : text.substr(question + 1);
  while (!rest.empty()) {
    const std::string option = rest.substr(0, rest.find('&'));
    rest.erase(0, std::min(rest.size(), option.size() + 1));
    const std::size_t equals = std::min(option.find('='), option.size());
    const std::string key = option.substr(0, equals), value = option.substr(std::min(equals + 1, option.size()));
    std::int32_t number = 0;
    const auto parsed = std::from_chars(value.data(), value.data() + value.size(), number);
    const bool whole = parsed.ec == std::errc{} && parsed.ptr == value.data() + value.size();
    const bool size = whole && number >= 1 && number <= 65535;
    const bool own = key.empty() || key == "width" || key == "height" || key == "format";
    if (key == "width" && size) {
      address.width = static_cast<std::uint32_t>(number);
    } else if (key == "height" && size) {
      address.height = static_cast<std::uint32_t>(number);
    } else if (whole && !own) {
      address.controls.emplace_back(key, number);
    } else if (const auto* const named =
                   std::find_if(std::begin(kUsable), std::end(kUsable),
                                [&](std::uint32_t fourcc) { return key == "format" && fourcc_text(fourcc) == value; });
               named != std::end(kUsable)) {
      address.fourcc = *named;
    } else {
      return tl::unexpected(
          camera_fault(CameraError::Kind::unsupported, "v4l2:" + camera, "opening",
                       "the option \"" + option + "\" is not understood",
                       "use width=PIXELS, height=PIXELS, format=FORMAT and CONTROL=NUMBER, joined by &; formats are " +
                           usable_formats()));
    }
  }
  return address;
}

}  // namespace celadon
