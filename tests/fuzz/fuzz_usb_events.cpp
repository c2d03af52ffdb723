// libFuzzer target: USB both ways without a bus. Any control requests to the controller's side, whose events and trace
// are taken in any order and have to be what the registers say; any bytes as a trace to the client's side. Build and
// run: README.md of this folder.

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "firmware_bridge/controller_core.h"
#include "firmware_bridge/controller_usb.h"
#include "firmware_bridge/usb_trace.h"
#include "tests/firmware_bridge/test_plant.h"

using namespace celadon;
namespace usb = protocol::usb;

namespace {

class CoreUsbRegisters final : public UsbRegisters {
 public:
  explicit CoreUsbRegisters(ControllerCore& core) : core_(core) {}
  protocol::Exception read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override {
    return core_.read_input(now_us, address, count, words);
  }
  protocol::Exception read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override {
    return core_.read_holding(now_us, address, count, words);
  }
  protocol::Exception write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override {
    return core_.write_holding(now_us, address, count, words);
  }
  std::uint64_t now_us = 0;

 private:
  ControllerCore& core_;
};

void require(bool holds) {
  if (!holds) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  test::TestPlant plant;
  plant.inside_write = true;  // whatever starts is asked for here
  ControllerCore core(test::test_config(), plant, 1, 0);
  CoreUsbRegisters registers(core);
  ControllerUsb controller(registers);
  UsbTrace trace;
  std::array<std::uint8_t, 2 * usb::kMaxRegisters> buffer{};
  std::uint64_t newest_us = 0;
  for (std::size_t at = 0; at < size;) {
    const std::uint8_t what = data[at++];
    registers.now_us += 1'000 + 100ull * what;
    plant.button = (what & 64) != 0;
    if (what % 8 < 3 && at + 8 <= size) {
      UsbSetup setup = UsbSetup::from_bytes(data + at);
      at += 8;
      if (what % 8 == 0) {
        const int count = controller.control_in(setup, buffer.data());
        require(count == ControllerUsb::kStall || (count >= 0 && count <= static_cast<int>(buffer.size())));
      } else {
        const std::size_t count = std::min<std::size_t>({setup.length, size - at, buffer.size()});
        (void)controller.control_out(setup, data + at, static_cast<int>(count));
        at += count;
      }
    } else if (what % 8 == 3) {
      controller.sample();
    } else if (what % 8 == 4) {
      const int count = controller.take_event(buffer.data());
      require(count == 0 || count == usb::kEventBytes);
    } else if (what % 8 == 5) {
      const int capacity = std::min<int>(4 * what, static_cast<int>(buffer.size()));
      const int count = controller.take_trace(buffer.data(), capacity);
      require(count >= 0 && count <= capacity && count % usb::kTraceBytes == 0);
      trace.receive(std::span(buffer).first(static_cast<std::size_t>(count)));
      std::array<TraceSample, 128> samples{};
      const std::size_t taken = trace.take(samples);
      require(taken == static_cast<std::size_t>(count / usb::kTraceBytes));
      for (std::size_t i = 0; i < taken; ++i) {
        require(samples[i].time_us >= newest_us && samples[i].time_us <= registers.now_us);
        newest_us = samples[i].time_us;
      }
    } else if (what % 8 == 6) {
      controller.reset();
    } else {
      // A controller that sends anything.
      UsbTrace foreign;
      const std::size_t count = std::min<std::size_t>(size - at, what);
      foreign.receive(std::span(data, size).subspan(at, count));
      at += count;
      std::array<TraceSample, 16> samples{};
      require(foreign.take(samples) == std::min<std::size_t>(count / usb::kTraceBytes, samples.size()));
    }
  }
  return 0;
}
