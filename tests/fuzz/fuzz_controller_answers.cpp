// libFuzzer target: any registers as a controller's answers to the scanner's client: identity, capabilities, status,
// refusals, and answers that fail. (Bytes to registers is libmodbus's and libusb's part.) Build and run: README.md of
// this folder.

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <span>
#include <string>

#include "firmware_bridge/scanner_device.h"

using namespace celadon;

namespace {

/// What is left of the input: one byte says how an exchange ends, then come its registers. Afterwards all fails.
class Answers final : public Transport {
 public:
  Answers(const std::uint8_t* data, std::size_t size) : data_(data), left_(size) {}
  tl::expected<void, LinkError> read_inputs(std::uint16_t address, std::span<std::uint16_t> to) override {
    if (auto ended = exchange(); !ended) return ended;
    for (std::uint16_t& word : to) word = next_word();
    // Most inputs would end at the first check otherwise.
    if (address == 0x0100 && to.size() > 3 && (to[0] & 1) == 0) {
      to[0] = 0x4345;
      to[1] = 0x4C41;
      to[2] = 1;
    }
    return {};
  }
  tl::expected<void, LinkError> read_holding(std::uint16_t address, std::span<std::uint16_t> to) override {
    return read_inputs(address, to);
  }
  tl::expected<void, LinkError> write_holding(std::uint16_t, std::span<const std::uint16_t>) override {
    return exchange();
  }
  tl::expected<void, LinkError> reconnect() override { return exchange(); }
  const std::string& url() const override { return url_; }

 private:
  tl::expected<void, LinkError> exchange() {
    using Kind = DeviceError::Kind;
    if (left_ == 0) return tl::make_unexpected(LinkError{Kind::lost, EPIPE, "over", false});
    const std::uint8_t how = next();
    if (how < 240) return {};
    if (how < 246) return tl::make_unexpected(LinkError{Kind::refused, how - 240, "refused", false});
    if (how < 250) return tl::make_unexpected(LinkError{Kind::broken_reply, EIO, "broken", true});
    return tl::make_unexpected(LinkError{how < 253 ? Kind::timed_out : Kind::lost, ETIMEDOUT, "silent", true});
  }
  std::uint8_t next() {
    if (left_ == 0) return 0;
    --left_;
    return *data_++;
  }
  std::uint16_t next_word() {
    const std::uint8_t high = next();
    return static_cast<std::uint16_t>(high << 8 | next());
  }
  const std::uint8_t* data_;
  std::size_t left_;
  const std::string url_ = "fuzz:";
};

class FuzzClock final : public Clock {
 public:
  std::int64_t now_ns() override { return now_ns_ += 1'000'000; }
  void sleep_until(std::int64_t time_ns) override { now_ns_ = std::max(now_ns_, time_ns); }

 private:
  std::int64_t now_ns_ = 0;
};

template <class T>
void look(const tl::expected<T, DeviceError>& result) {
  if (!result && result.error().cause.empty()) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzClock clock;
  auto device = ScannerDevice::open(std::make_unique<Answers>(data, size), clock);
  look(device);
  if (!device) return 0;
  ScannerDevice& d = **device;
  if (d.identity().machine.find('\0') != std::string::npos) std::abort();
  for (int i = 0; i < 4; ++i) {
    const auto status = d.poll();
    look(status);
    if (status && !std::isfinite(status->angle_rad + status->speed_rad_per_s + status->target_rad)) std::abort();
    (void)d.take_button_presses();
  }
  look(d.home());
  look(d.rotate_to(1, 0.5));
  look(d.start_sweep(7, 0.5));
  look(d.renew_laser(0, 100));
  look(d.clear_fault());
  look(d.stop());
  return 0;
}
