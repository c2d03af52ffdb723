#include "acquisition/v4l2_controls.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <cctype>

#include "acquisition/camera_fault.h"
#include "acquisition/v4l2_fault.h"
#include "acquisition/v4l2_ioctl.h"
#include "acquisition/v4l2_text.h"

namespace celadon {
namespace {

using Kind = CameraError::Kind;

constexpr std::uint32_t kMostControls = 1024;  // an enumeration that does not end is a driver's fault

/// What changes pictures by itself, and is off at 0.
constexpr std::uint32_t kAutomatics[] = {V4L2_CID_AUTO_WHITE_BALANCE, V4L2_CID_AUTOGAIN,
                                         V4L2_CID_FOCUS_AUTO,         V4L2_CID_AUTOBRIGHTNESS,
                                         V4L2_CID_HUE_AUTO,           V4L2_CID_EXPOSURE_AUTO_PRIORITY};

std::vector<std::string> menu_of(int fd, const v4l2_query_ext_ctrl& control) {
  std::vector<std::string> menu;
  for (std::int64_t i = 0; i <= std::min<std::int64_t>(control.maximum, 255); ++i) {
    v4l2_querymenu entry{};
    entry.id = control.id;
    entry.index = static_cast<std::uint32_t>(i);
    const bool there = i >= control.minimum && v4l2_ioctl(fd, VIDIOC_QUERYMENU, &entry) == 0;
    menu.push_back(there ? control.type == V4L2_CTRL_TYPE_INTEGER_MENU ? std::to_string(entry.value)
                                                                       : printable(entry.name, sizeof entry.name)
                         : std::string());
  }
  return menu;
}

std::optional<std::int32_t> value_of(int fd, std::uint32_t id) {
  v4l2_control control{};
  control.id = id;
  if (v4l2_ioctl(fd, VIDIOC_G_CTRL, &control) != 0) return std::nullopt;
  return control.value;
}

}  // namespace

std::vector<V4l2Control> list_v4l2_controls(int fd) {
  std::vector<V4l2Control> controls;
  v4l2_query_ext_ctrl control{};
  for (std::uint32_t i = 0; i < kMostControls; ++i) {
    control.id |= V4L2_CTRL_FLAG_NEXT_CTRL;
    if (v4l2_ioctl(fd, VIDIOC_QUERY_EXT_CTRL, &control) != 0) break;
    const bool menu = control.type == V4L2_CTRL_TYPE_MENU || control.type == V4L2_CTRL_TYPE_INTEGER_MENU;
    const bool number = control.type == V4L2_CTRL_TYPE_INTEGER || control.type == V4L2_CTRL_TYPE_BOOLEAN;
    if ((!menu && !number) || (control.flags & V4L2_CTRL_FLAG_DISABLED) != 0) continue;
    controls.push_back({printable(reinterpret_cast<const std::uint8_t*>(control.name), sizeof control.name), control.id,
                        control.minimum, control.maximum, static_cast<std::int64_t>(control.step),
                        control.default_value, std::optional<std::int64_t>(value_of(fd, control.id)),
                        (control.flags & V4L2_CTRL_FLAG_INACTIVE) != 0, (control.flags & V4L2_CTRL_FLAG_READ_ONLY) != 0,
                        menu ? menu_of(fd, control) : std::vector<std::string>()});
  }
  return controls;
}

std::string V4l2Control::key() const {
  std::string key;
  for (const char c : name) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0) {
      key += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    } else if (!key.empty() && key.back() != '_') {
      key += '_';
    }
  }
  key.erase(key.find_last_not_of('_') + 1);
  return key;
}

tl::expected<void, CameraError> V4l2Controls::set(const V4l2Control& control, std::int64_t value) {
  const std::string operation = "setting its control " + control.key() + " to " + std::to_string(value);
  if (value < control.minimum || value > control.maximum) {
    return tl::unexpected(
        camera_fault(Kind::unsupported, device_, operation,
                     "it goes from " + std::to_string(control.minimum) + " to " + std::to_string(control.maximum),
                     "give a value in that range"));
  }
  const auto found = value_of(fd_, control.id);
  if (found == value) return {};
  v4l2_control wanted{.id = control.id, .value = static_cast<std::int32_t>(value)};
  if (const int code = v4l2_ioctl(fd_, VIDIOC_S_CTRL, &wanted); code != 0) {
    return tl::unexpected(
        v4l2_fault(device_, operation, code,
                   code == EACCES ? "an automatic holds it or it can only be read: name the automatic with 0 before it"
                                  : "leave it as it is by giving the value that `celadon cameras` shows"));
  }
  if (found) found_.emplace_back(control.id, *found);
  if (const auto now = value_of(fd_, control.id); now != value) {
    return tl::unexpected(camera_fault(Kind::unsupported, device_, operation,
                                       now ? "the camera took " + std::to_string(*now) : "it cannot be read back",
                                       "give a value that the camera takes"));
  }
  return {};
}

tl::expected<void, CameraError> V4l2Controls::apply(std::span<const ControlSetting> settings) {
  const std::vector<V4l2Control> controls = list_v4l2_controls(fd_);
  const auto named = [&](const V4l2Control& control) {
    return std::any_of(settings.begin(), settings.end(), [&](const auto& s) { return s.first == control.key(); });
  };
  for (const std::uint32_t id : kAutomatics) {
    for (const V4l2Control& control : controls) {
      if (control.id != id || control.inactive || control.read_only || named(control)) continue;
      if (auto off = set(control, 0); !off) return off;
    }
  }
  for (const ControlSetting& setting : settings) {
    const std::string& key = setting.first;
    const auto control = std::find_if(controls.begin(), controls.end(), [&](const auto& c) { return c.key() == key; });
    if (control != controls.end()) {
      if (auto done = set(*control, setting.second); !done) return done;
      continue;
    }
    std::string known;
    for (const V4l2Control& c : controls) known += (known.empty() ? "" : ", ") + c.key();
    return tl::unexpected(camera_fault(Kind::unsupported, device_, "setting its control " + key,
                                       "it has no such control", known.empty() ? "it has none" : "it has " + known,
                                       EINVAL));
  }
  return {};
}

void V4l2Controls::restore() noexcept {
  for (; !found_.empty(); found_.pop_back()) {
    v4l2_control back{.id = found_.back().first, .value = found_.back().second};
    static_cast<void>(v4l2_ioctl(fd_, VIDIOC_S_CTRL, &back));
  }
}

}  // namespace celadon
