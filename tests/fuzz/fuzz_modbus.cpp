// libFuzzer target: any bytes from a Modbus client, to the virtual scanner's server and to the firmware example's,
// before the same controller core. Build and run: README.md of this folder. The first byte says which framing, and
// whether each piece is completed to a request of the serial line with the right checksum; the second how the bytes are
// cut into pieces.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <vector>

#include "firmware_bridge/controller_core.h"
#include "firmware_bridge/firmware_example/modbus_slave.h"
#include "sim/modbus_port.h"
#include "tests/firmware_bridge/test_plant.h"

using namespace celadon;

namespace {

constexpr std::size_t kLongestAnswer = 260;

class CoreRegisters final : public sim::Registers {
 public:
  CoreRegisters(ControllerCore& core, std::uint64_t& now_us) : core_(core), now_us_(now_us) {}
  protocol::Exception read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override {
    return core_.read_input(now_us_, address, count, words);
  }
  protocol::Exception read_holding(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override {
    return core_.read_holding(now_us_, address, count, words);
  }
  protocol::Exception write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override {
    return core_.write_holding(now_us_, address, count, words);
  }

 private:
  ControllerCore& core_;
  std::uint64_t& now_us_;
};

void require(bool holds) {
  if (!holds) std::abort();
}

/// Nobody guesses checksums: a piece becomes a frame for unit 1.
std::vector<std::uint8_t> as_frame(std::span<const std::uint8_t> piece) {
  std::vector<std::uint8_t> frame = {1};
  frame.insert(frame.end(), piece.begin(), piece.end());
  const std::uint16_t crc = sim::modbus_crc(frame);
  frame.push_back(static_cast<std::uint8_t>(crc));
  frame.push_back(static_cast<std::uint8_t>(crc >> 8));
  return frame;
}

void serve_by_simulator(ControllerCore& core, sim::ModbusFraming framing, std::span<const std::uint8_t> bytes,
                        std::size_t piece, bool framed) {
  std::uint64_t now_us = 1;
  CoreRegisters registers(core, now_us);
  sim::ModbusReader reader(framing);
  for (std::size_t at = 0; at < bytes.size() && !reader.broken(); at += piece) {
    const auto part = bytes.subspan(at, std::min(piece, bytes.size() - at));
    if (framed) {
      reader.append(as_frame(part));
    } else {
      reader.append(part);
    }
    while (const auto request = reader.next()) {
      now_us += 500;
      const auto pdu = sim::answer_modbus(request->pdu, registers);
      const auto answer = sim::frame_modbus(framing, *request, pdu);
      require(!pdu.empty() && answer.size() <= kLongestAnswer);
      require((pdu[0] & 0x7F) == (request->pdu[0] & 0x7F));
      if (framing == sim::ModbusFraming::rtu) require(sim::modbus_crc(answer) == 0);  // over its own checksum
    }
  }
}

void serve_by_firmware(ControllerCore& core, std::span<const std::uint8_t> bytes, std::size_t piece, bool framed) {
  std::uint64_t now_us = 1;
  example::ModbusSlave slave(core, 1);
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    const auto part = bytes.subspan(at, std::min(piece, bytes.size() - at));
    const auto frame = framed ? as_frame(part) : std::vector<std::uint8_t>(part.begin(), part.end());
    for (const std::uint8_t byte : frame) slave.receive(byte, now_us += 87);
    slave.advance(now_us += 2'000);
    std::size_t answered = 0;
    for (; slave.next_byte() >= 0; slave.sent()) require(++answered <= kLongestAnswer);
    require(answered == 0 || answered >= 5);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  test::TestPlant plant;
  plant.inside_write = true;  // whatever starts is asked for here
  ControllerConfig config = test::test_config();
  config.locked_at_start = (data[0] & 4) != 0;
  ControllerCore core(config, plant, 1, 0);
  const std::span bytes = std::span(data, size).subspan(2);
  const std::size_t piece = 1 + data[1];
  const bool framed = (data[0] & 8) != 0;
  switch (data[0] % 4) {
    case 0:
      serve_by_simulator(core, sim::ModbusFraming::tcp, bytes, piece, false);
      break;
    case 1:
      serve_by_simulator(core, sim::ModbusFraming::rtu, bytes, piece, framed);
      break;
    default:
      serve_by_firmware(core, bytes, piece, framed);
  }
  // No light without a lease, whatever was written.
  core.step(3'600'000'000ull);
  require(plant.lasers == 0);
  return 0;
}
