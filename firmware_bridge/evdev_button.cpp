// A key of a Linux input device.
#include <fcntl.h>
#include <libevdev/libevdev.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <ctime>
#include <set>

#include "firmware_bridge/button_open.h"

namespace celadon {
namespace {

class EvdevButton final : public ButtonSource {
 public:
  EvdevButton(std::string url, int key, int fd) : url_(std::move(url)), key_(key), fd_(fd) {}
  ~EvdevButton() override {
    libevdev_free(device_);  // lets go of the grab
    ::close(fd_);
  }
  EvdevButton(const EvdevButton&) = delete;
  EvdevButton& operator=(const EvdevButton&) = delete;

  tl::expected<void, ButtonError> take() {
    if (const int result = libevdev_new_from_fd(fd_, &device_); result != 0) {
      device_ = nullptr;
      return unusable_button(url_, "it is no input device (" + std::string(std::strerror(-result)) + ")",
                             "name one below /dev/input");
    }
    if (key_ >= 0 && libevdev_has_event_code(device_, EV_KEY, static_cast<unsigned>(key_)) == 0) {
      return unusable_button(url_, "\"" + std::string(libevdev_get_name(device_)) + "\" has no such key",
                             "look with evtest which keys it has");
    }
    if (libevdev_has_event_type(device_, EV_KEY) == 0) {
      return unusable_button(url_, "\"" + std::string(libevdev_get_name(device_)) + "\" has no keys",
                             "name another input device");
    }
    // Its presses shall type nowhere else.
    if (const int result = libevdev_grab(device_, LIBEVDEV_GRAB); result != 0) {
      return unusable_button(
          url_, result == -EBUSY ? "another program has taken it for itself" : std::string(std::strerror(-result)),
          "end that program");
    }
    libevdev_set_clock_id(device_, CLOCK_MONOTONIC);
    for (unsigned key = 0; key < KEY_CNT; ++key) {
      if (is_meant(key) && libevdev_get_event_value(device_, EV_KEY, key) != 0) keys_down_.insert(key);
    }
    down_at_open_ = !keys_down_.empty();
    return {};
  }

  bool down_at_open() const override { return down_at_open_; }

  tl::expected<void, ButtonError> read(std::vector<ButtonEdge>& edges) override {
    unsigned flag = LIBEVDEV_READ_FLAG_NORMAL;
    for (;;) {
      input_event event{};
      const int result = libevdev_next_event(device_, flag, &event);
      if (result == LIBEVDEV_READ_STATUS_SYNC) {
        // The kernel's buffer ran over: what follows is how the keys stand now.
        flag = LIBEVDEV_READ_FLAG_SYNC;
      } else if (result == -EAGAIN && flag == LIBEVDEV_READ_FLAG_SYNC) {
        flag = LIBEVDEV_READ_FLAG_NORMAL;
        continue;
      } else if (result == -EAGAIN) {
        return {};
      } else if (result != LIBEVDEV_READ_STATUS_SUCCESS) {
        return unusable_button(
            url_,
            result == -ENODEV ? "it was unplugged" : "reading it failed (" + std::string(std::strerror(-result)) + ")",
            "plug it in");
      }
      note(event, edges);
    }
  }

 private:
  bool is_meant(unsigned key) const { return key_ < 0 || key == static_cast<unsigned>(key_); }

  void note(const input_event& event, std::vector<ButtonEdge>& edges) {
    constexpr int kUp = 0, kDown = 1;  // 2: the key repeats
    if (event.type != EV_KEY || !is_meant(event.code) || (event.value != kUp && event.value != kDown)) return;
    const bool was_down = !keys_down_.empty();
    if (event.value == kDown) keys_down_.insert(event.code);
    if (event.value == kUp) keys_down_.erase(event.code);
    const bool is_down = !keys_down_.empty();
    if (is_down == was_down) return;
    edges.push_back(
        {is_down, std::int64_t{event.input_event_sec} * 1'000'000'000 + std::int64_t{event.input_event_usec} * 1000});
  }

  const std::string url_;
  const int key_, fd_;
  libevdev* device_ = nullptr;
  std::set<unsigned> keys_down_;
  bool down_at_open_ = false;
};

}  // namespace

tl::expected<std::unique_ptr<ButtonSource>, ButtonError> open_evdev_button(const std::string& url,
                                                                           const EvdevPlace& place) {
  const int fd = ::open(place.path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) {
    const int error = errno;
    if (error == ENOENT || error == ENODEV || error == ENXIO)
      return unusable_button(url, "there is no " + place.path, "plug it in, or name another");
    if (error == EACCES || error == EPERM) {
      return unusable_button(url, "this user may not read " + place.path,
                             "add the user to the group input and start the daemon again");
    }
    return unusable_button(url, std::strerror(error), "check " + place.path);
  }
  auto button = std::make_unique<EvdevButton>(url, place.key, fd);
  if (auto taken = button->take(); !taken) return tl::unexpected(taken.error());
  return button;
}

}  // namespace celadon
