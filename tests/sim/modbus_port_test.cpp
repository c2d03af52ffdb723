#include "sim/modbus_port.h"

#include <gtest/gtest.h>

#include <random>

namespace celadon::sim {
namespace {

using Bytes = std::vector<std::uint8_t>;

class Echo final : public Registers {
 public:
  protocol::Exception read_input(std::uint16_t address, std::uint16_t count, std::uint16_t* words) override {
    for (std::uint16_t i = 0; i < count; ++i) words[i] = static_cast<std::uint16_t>(address + i);
    return protocol::Exception::none;
  }
  protocol::Exception read_holding(std::uint16_t, std::uint16_t, std::uint16_t*) override {
    return protocol::Exception::illegal_address;
  }
  protocol::Exception write_holding(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) override {
    written_at = address;
    written.assign(words, words + count);
    return protocol::Exception::none;
  }
  std::uint16_t written_at = 0;
  std::vector<std::uint16_t> written;
};

// The examples of the Modbus application protocol specification V1.1b3, sections 6.4, 6.6 and 6.12, by their layout.
TEST(ModbusPort, AnswersAsTheSpecificationPrints) {
  Echo echo;
  EXPECT_EQ(answer_modbus(Bytes{4, 0x00, 0x08, 0x00, 0x01}, echo), (Bytes{4, 2, 0, 8}));
  EXPECT_EQ(answer_modbus(Bytes{3, 0x00, 0x6b, 0x00, 0x03}, echo), (Bytes{0x83, 2}));
  EXPECT_EQ(answer_modbus(Bytes{6, 0x00, 0x01, 0x00, 0x03}, echo), (Bytes{6, 0, 1, 0, 3}));
  EXPECT_EQ(echo.written, (std::vector<std::uint16_t>{3}));
  EXPECT_EQ(answer_modbus(Bytes{16, 0x00, 0x01, 0x00, 0x02, 4, 0x00, 0x0a, 0x01, 0x02}, echo), (Bytes{16, 0, 1, 0, 2}));
  EXPECT_EQ(echo.written, (std::vector<std::uint16_t>{0x000a, 0x0102}));
  EXPECT_EQ(answer_modbus(Bytes{0x2b, 0x0e}, echo), (Bytes{0xab, 1}));
  EXPECT_EQ(answer_modbus(Bytes{4, 0, 0, 0, 126}, echo), (Bytes{0x84, 3}));
  EXPECT_EQ(answer_modbus(Bytes{4, 0, 0, 0, 0}, echo), (Bytes{0x84, 3}));
  EXPECT_EQ(answer_modbus(Bytes{4, 0, 0}, echo), (Bytes{0x84, 3}));
  EXPECT_EQ(answer_modbus(Bytes{16, 0, 1, 0, 2, 4, 0, 1}, echo), (Bytes{0x90, 3}));
}

// "Modbus over serial line" V1.02, 6.2.2: the CRC of 02 07 is 0x1241, sent low byte first.
TEST(ModbusPort, CrcOfThePrintedExample) {
  EXPECT_EQ(modbus_crc(Bytes{0x02, 0x07}), 0x1241);
}

Bytes rtu(Bytes body) {
  const std::uint16_t crc = modbus_crc(body);
  body.push_back(static_cast<std::uint8_t>(crc));
  body.push_back(static_cast<std::uint8_t>(crc >> 8));
  return body;
}

TEST(ModbusPort, RtuFindsRequestsBehindRubbish) {
  const Bytes good = rtu({1, 4, 0, 0, 0, 48}), write = rtu({1, 16, 0, 2, 0, 1, 2, 0, 9});
  ModbusReader reader(ModbusFraming::rtu);
  Bytes stream{0xff, 0x00, 0x13};
  stream.insert(stream.end(), good.begin(), good.end());
  stream.insert(stream.end(), {0x55});
  stream.insert(stream.end(), write.begin(), write.end());
  std::vector<ModbusRequest> found;
  for (const std::uint8_t b : stream) {
    reader.append(std::span(&b, 1));
    while (auto r = reader.next()) found.push_back(*r);
  }
  ASSERT_EQ(found.size(), 2U);
  EXPECT_EQ(found[0].pdu, (Bytes{4, 0, 0, 0, 48}));
  EXPECT_EQ(found[1].pdu[0], 16);
}

TEST(ModbusPort, TcpTakesRequestsByteByByteAndRefusesOtherProtocols) {
  const Bytes request{0x12, 0x34, 0, 0, 0, 6, 1, 4, 0, 0, 0, 2};
  ModbusReader reader(ModbusFraming::tcp);
  int found = 0;
  for (int round = 0; round < 2; ++round) {
    for (const std::uint8_t b : request) {
      reader.append(std::span(&b, 1));
      if (auto r = reader.next()) {
        ++found;
        EXPECT_EQ(r->transaction, 0x1234);
        EXPECT_EQ(r->unit, 1);
        EXPECT_EQ(frame_modbus(ModbusFraming::tcp, *r, Bytes{4, 2, 7, 8}),
                  (Bytes{0x12, 0x34, 0, 0, 0, 5, 1, 4, 2, 7, 8}));
      }
    }
  }
  EXPECT_EQ(found, 2);
  for (const Bytes& bad : {Bytes{0, 1, 0, 9, 0, 6, 1}, Bytes{0, 1, 0, 0, 0, 1, 1}, Bytes{0, 1, 0, 0, 255, 255, 1}}) {
    ModbusReader other(ModbusFraming::tcp);
    other.append(bad);
    EXPECT_FALSE(other.next());
    EXPECT_TRUE(other.broken());
  }
}

TEST(ModbusPort, RandomBytesNeverHangOrCrash) {
  std::mt19937 random(3);
  Echo echo;
  for (const ModbusFraming framing : {ModbusFraming::tcp, ModbusFraming::rtu}) {
    for (int trial = 0; trial < 300; ++trial) {
      ModbusReader reader(framing);
      for (int i = 0; i < 60; ++i) {
        Bytes bytes(random() % 40);
        for (auto& b : bytes) b = static_cast<std::uint8_t>(random() % 3 == 0 ? random() % 20 : random());
        reader.append(bytes);
        while (auto r = reader.next()) EXPECT_GE(answer_modbus(r->pdu, echo).size(), 2U);
      }
    }
  }
}

}  // namespace
}  // namespace celadon::sim
