// A line of a GPIO chip.
#include <fcntl.h>
#include <gpiod.h>
#include <poll.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>

#include "firmware_bridge/button_open.h"

namespace celadon {
namespace {

constexpr const char* kConsumer = "celadon button";

struct CloseChip {
  void operator()(gpiod_chip* chip) const { gpiod_chip_close(chip); }  // releases its lines
};
using Chip = std::unique_ptr<gpiod_chip, CloseChip>;

class GpioButton final : public ButtonSource {
 public:
  GpioButton(std::string url, Chip chip, int fd, bool down)
      : url_(std::move(url)), chip_(std::move(chip)), fd_(fd), down_at_open_(down) {}

  bool down_at_open() const override { return down_at_open_; }

  tl::expected<void, ButtonError> read(std::vector<ButtonEdge>& edges) override {
    for (;;) {
      pollfd ready{fd_, POLLIN, 0};
      const int polled = ::poll(&ready, 1, 0);
      if (polled < 0 && errno != EINTR) return lost(errno);
      if (polled > 0 && (ready.revents & POLLIN) == 0) return lost(ENODEV);
      if (polled <= 0) return {};
      std::array<gpiod_line_event, 16> events{};
      const int count = gpiod_line_event_read_fd_multiple(fd_, events.data(), events.size());
      if (count < 0 && errno == EAGAIN) return {};
      if (count <= 0) return lost(errno);
      for (std::size_t i = 0; i < static_cast<std::size_t>(count); ++i) {
        edges.push_back({events[i].event_type == GPIOD_LINE_EVENT_RISING_EDGE,
                         std::int64_t{events[i].ts.tv_sec} * 1'000'000'000 + events[i].ts.tv_nsec});
      }
    }
  }

 private:
  tl::unexpected<ButtonError> lost(int error) const {
    return unusable_button(url_, "its chip is gone (" + std::string(std::strerror(error)) + ")", "plug it in");
  }

  const std::string url_;
  const Chip chip_;
  const int fd_;  ///< the line's
  const bool down_at_open_;
};

gpiod_line* line_of(gpiod_chip* chip, const std::string& name) {
  unsigned offset = 0;
  const auto [end, error] = std::from_chars(name.data(), name.data() + name.size(), offset);
  if (error == std::errc() && end == name.data() + name.size())
    return offset < gpiod_chip_num_lines(chip) ? gpiod_chip_get_line(chip, offset) : nullptr;
  return gpiod_chip_find_line(chip, name.c_str());
}

}  // namespace

tl::expected<std::unique_ptr<ButtonSource>, ButtonError> open_gpio_button(const std::string& url,
                                                                          const GpioPlace& place) {
  Chip chip(gpiod_chip_open_lookup(place.chip.c_str()));
  if (!chip) {
    const int error = errno;
    if (error == EACCES || error == EPERM) {
      return unusable_button(url, "this user may not open the chip " + place.chip,
                             "add the user to the group gpio and start the daemon again");
    }
    return unusable_button(url, "there is no GPIO chip " + place.chip, "gpiodetect lists the chips");
  }
  gpiod_line* const line = line_of(chip.get(), place.line);
  if (line == nullptr) {
    return unusable_button(url,
                           "the chip " + place.chip + " has no line " + place.line + " among its " +
                               std::to_string(gpiod_chip_num_lines(chip.get())),
                           "gpioinfo lists the lines");
  }
  gpiod_line_request_config config{};
  config.consumer = kConsumer;
  config.request_type = GPIOD_LINE_REQUEST_EVENT_BOTH_EDGES;
  config.flags = place.active_low ? GPIOD_LINE_REQUEST_FLAG_ACTIVE_LOW | GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_UP
                                  : GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_DOWN;
  if (gpiod_line_request(line, &config, 0) != 0) {
    const int error = errno;
    const char* const user = gpiod_line_consumer(line);
    if (error == EBUSY) {
      return unusable_button(url, "the line is used by " + std::string(user != nullptr ? user : "the kernel"),
                             "free it, or name another line");
    }
    return unusable_button(url, "the line tells no edges (" + std::string(std::strerror(error)) + ")",
                           "name a line with interrupts");
  }
  const int fd = gpiod_line_event_get_fd(line);
  const int level = gpiod_line_get_value(line);
  if (level < 0 || ::fcntl(fd, F_SETFL, O_NONBLOCK) != 0)
    return unusable_button(url, "its level cannot be read (" + std::string(std::strerror(errno)) + ")",
                           "check the chip");
  return std::make_unique<GpioButton>(url, std::move(chip), fd, level == 1);
}

}  // namespace celadon
