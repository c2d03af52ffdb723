#include "firmware_bridge/modbus_url.h"

#include <gtest/gtest.h>

namespace celadon {
namespace {

TEST(ModbusUrl, TcpWithDefaultsAndOptions) {
  const auto plain = parse_modbus_url("modbus-tcp://scanner.local");
  ASSERT_TRUE(plain);
  EXPECT_EQ(std::get<ModbusTcpPlace>(plain->link).host, "scanner.local");
  EXPECT_EQ(std::get<ModbusTcpPlace>(plain->link).port, 502);
  EXPECT_EQ(plain->unit, 255);
  EXPECT_EQ(plain->timeout_ms, 500);
  const auto full = parse_modbus_url("modbus-tcp://[fe80::1]:1502?unit=3&timeout_ms=80");
  ASSERT_TRUE(full);
  EXPECT_EQ(std::get<ModbusTcpPlace>(full->link).host, "fe80::1");
  EXPECT_EQ(std::get<ModbusTcpPlace>(full->link).port, 1502);
  EXPECT_EQ(full->unit, 3);
  EXPECT_EQ(full->timeout_ms, 80);
}

TEST(ModbusUrl, RtuWithDefaultsAndOptions) {
  const auto plain = parse_modbus_url("modbus-rtu:/dev/ttyUSB0");
  ASSERT_TRUE(plain);
  const auto& rtu = std::get<ModbusRtuPlace>(plain->link);
  EXPECT_EQ(rtu.device, "/dev/ttyUSB0");
  EXPECT_EQ(rtu.baud, 115200);
  EXPECT_EQ(rtu.parity, 'E');
  EXPECT_EQ(rtu.stop_bits, 1);
  EXPECT_FALSE(rtu.rs485);
  EXPECT_EQ(plain->unit, 1);
  const auto full = parse_modbus_url("modbus-rtu:/dev/ttyS1?baud=19200&parity=N&stop=2&unit=247&rs485=1");
  ASSERT_TRUE(full);
  const auto& other = std::get<ModbusRtuPlace>(full->link);
  EXPECT_EQ(other.baud, 19200);
  EXPECT_EQ(other.parity, 'N');
  EXPECT_EQ(other.stop_bits, 2);
  EXPECT_TRUE(other.rs485);
  EXPECT_EQ(full->unit, 247);
}

TEST(ModbusUrl, EachMistakeIsNamed) {
  const struct {
    const char* url;
    const char* says;
  } cases[] = {
      {"", "modbus-tcp://"},
      {"http://x", "modbus-tcp://"},
      {"modbus-tcp://", "host is missing"},
      {"modbus-tcp://:502", "host is missing"},
      {"modbus-tcp://[::1", "bracket"},
      {"modbus-tcp://[::1]502", "PORT"},
      {"modbus-tcp://h:0", "port \"0\""},
      {"modbus-tcp://h:65536", "port \"65536\""},
      {"modbus-tcp://h:5x", "port \"5x\""},
      {"modbus-tcp://h:", "port \"\""},
      {"modbus-tcp://h?unit=256", "unit=256"},
      {"modbus-tcp://h?unit", "KEY=VALUE"},
      {"modbus-tcp://h?baud=9600", "\"baud\" is no option"},
      {"modbus-tcp://h?timeout_ms=1", "timeout_ms=1"},
      {"modbus-rtu:", "serial device is missing"},
      {"modbus-rtu:/dev/t?baud=12345", "baud=12345"},
      {"modbus-rtu:/dev/t?parity=X", "parity=X"},
      {"modbus-rtu:/dev/t?stop=3", "stop=3"},
      {"modbus-rtu:/dev/t?unit=0", "unit=0"},
      {"modbus-rtu:/dev/t?rs485=yes", "rs485=yes"},
      {"modbus-rtu:/dev/t?unit=99999999999999999999", "unit=99999999999999999999"},
  };
  for (const auto& c : cases) {
    const auto place = parse_modbus_url(c.url);
    ASSERT_FALSE(place) << c.url;
    EXPECT_NE(place.error().find(c.says), std::string::npos) << c.url << ": " << place.error();
  }
}

}  // namespace
}  // namespace celadon
