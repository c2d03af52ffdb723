// The transport on real sockets and ptys, with a libmodbus server at the other end.

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <array>
#include <cerrno>

#include "firmware_bridge/transport.h"
#include "tests/firmware_bridge/modbus_machine.h"

namespace celadon::test {
namespace {

using Kind = DeviceError::Kind;
using Link = ModbusServer::Link;

class BothLinks : public testing::TestWithParam<Link> {
 protected:
  std::unique_ptr<Transport> connect(const std::string& options = "timeout_ms=2000") {
    auto transport = open_transport(server.url(options));
    EXPECT_TRUE(transport) << (transport ? "" : transport.error().message());
    return transport ? std::move(*transport) : nullptr;
  }
  Machine machine;
  ModbusServer server{machine, GetParam()};
  std::array<std::uint16_t, 48> words{};
};

TEST_P(BothLinks, ReadsAndWritesBlocks) {
  auto t = connect();
  ASSERT_TRUE(t->read_inputs(0x0100, std::span(words).first(2)));
  EXPECT_EQ(words[0], 0x4345);
  EXPECT_EQ(words[1], 0x4C41);
  const std::array<std::uint16_t, 2> goal{0xFFFF, 0xFF00};
  ASSERT_TRUE(t->write_holding(0x0020, goal));
  ASSERT_TRUE(t->read_holding(0x0020, std::span(words).first(2)));
  EXPECT_EQ(words[0], 0xFFFF);
  EXPECT_EQ(words[1], 0xFF00);
  EXPECT_EQ(t->warning(), "");
}

TEST_P(BothLinks, ExceptionsComeBackWithTheirNumber) {
  auto t = connect();
  const auto unmapped = t->read_inputs(0x01F0, words);
  ASSERT_FALSE(unmapped);
  EXPECT_EQ(unmapped.error().kind, Kind::refused);
  EXPECT_EQ(unmapped.error().code, 2);
  EXPECT_FALSE(unmapped.error().retry_may_help);
  const std::array<std::uint16_t, 1> seven{7};
  EXPECT_EQ(t->write_holding(0x0002, seven).error().code, 3);
  server.mishap(Mishap::busy);
  const auto busy = t->read_inputs(0, words);
  EXPECT_EQ(busy.error().code, 6);
  EXPECT_TRUE(busy.error().retry_may_help);
  EXPECT_TRUE(t->read_inputs(0, words));  // an exception is no reason to distrust the link
}

TEST_P(BothLinks, BlocksBeyondTheLimitsNeverReachTheLink) {
  auto t = connect();
  std::array<std::uint16_t, 126> many{};
  EXPECT_EQ(t->read_inputs(0, many).error().kind, Kind::refused);
  EXPECT_EQ(t->read_holding(0, std::span(many).first(0)).error().kind, Kind::refused);
  EXPECT_EQ(t->write_holding(0, std::span(many).first(124)).error().kind, Kind::refused);
  EXPECT_EQ(machine.reads + machine.writes, 0);
}

TEST_P(BothLinks, SilenceTimesOutAndTheNextExchangeIsSound) {
  auto t = connect("timeout_ms=60");
  for (const Mishap m : {Mishap::drop, Mishap::ignore, Mishap::truncate}) {
    server.mishap(m);
    const auto silent = t->read_inputs(0x0100, words);
    ASSERT_FALSE(silent);
    EXPECT_EQ(silent.error().kind, Kind::timed_out);
    EXPECT_TRUE(silent.error().retry_may_help);
    EXPECT_NE(silent.error().cause.find("60 ms"), std::string::npos) << silent.error().cause;
    tl::expected<void, LinkError> again;
    for (int i = 0; i < 50 && !(again = t->read_inputs(0x0100, words)); ++i) {  // a busy machine may miss 60 ms
    }
    ASSERT_TRUE(again) << again.error().cause;
    EXPECT_EQ(words[0], 0x4345);
  }
}

TEST_P(BothLinks, GarbledRepliesAreToldAndTheNextExchangeIsSound) {
  auto t = connect();
  server.mishap(Mishap::garble);
  const auto garbled = t->read_inputs(0x0100, words);
  ASSERT_FALSE(garbled);
  EXPECT_EQ(garbled.error().kind, Kind::broken_reply);
  EXPECT_TRUE(garbled.error().retry_may_help);
  ASSERT_TRUE(t->read_inputs(0x0100, words));
  EXPECT_EQ(words[0], 0x4345);
}

TEST_P(BothLinks, VanishedServerIsALostLinkAndItsReturnIsFound) {
  auto t = connect("timeout_ms=300");
  ASSERT_TRUE(t->read_inputs(0x0100, words));
  server.stop();
  const auto gone = t->read_inputs(0x0100, words);
  ASSERT_FALSE(gone);
  EXPECT_NE(gone.error().cause, "");
  EXPECT_TRUE(gone.error().kind == Kind::lost || gone.error().kind == Kind::not_found) << gone.error().cause;
  EXPECT_FALSE(t->reconnect());
  server.start();
  if (GetParam() == Link::rtu) t = connect();  // a new pty has a new name
  EXPECT_TRUE(t->read_inputs(0x0100, words));
}

INSTANTIATE_TEST_SUITE_P(Modbus, BothLinks, testing::Values(Link::tcp, Link::rtu),
                         [](const auto& p) { return p.param == Link::tcp ? "Tcp" : "Rtu"; });

TEST(ModbusTcp, ShorterReplyThanAskedForIsBroken) {
  Machine machine;
  ModbusServer server(machine, Link::tcp);
  auto t = open_transport(server.url());
  ASSERT_TRUE(t);
  std::array<std::uint16_t, 8> words{};
  server.mishap(Mishap::wrong_count);
  EXPECT_EQ((*t)->read_inputs(0x0100, words).error().kind, Kind::broken_reply);
  EXPECT_TRUE((*t)->read_inputs(0x0100, words));
}

TEST(ModbusTcp, ClosedConnectionIsReopenedByTheNextExchange) {
  Machine machine;
  ModbusServer server(machine, Link::tcp);
  auto t = open_transport(server.url());
  ASSERT_TRUE(t);
  std::array<std::uint16_t, 8> words{};
  server.mishap(Mishap::close_link);
  EXPECT_EQ((*t)->read_inputs(0x0100, words).error().kind, Kind::lost);
  EXPECT_TRUE((*t)->read_inputs(0x0100, words));
}

TEST(ModbusRtu, AnotherUnitDoesNotAnswer) {
  Machine machine;
  ModbusServer server(machine, Link::rtu, 1);
  auto t = open_transport(server.url("unit=9&timeout_ms=50"));
  ASSERT_TRUE(t);
  std::array<std::uint16_t, 2> words{};
  const auto silent = (*t)->read_inputs(0x0100, words);
  ASSERT_FALSE(silent);
  EXPECT_EQ(silent.error().kind, Kind::timed_out);
  EXPECT_EQ(machine.reads, 0);
}

// Serial replies carry no number: one that comes after its time-out looks like the answer to the next request.
TEST(ModbusRtu, LateReplyIsNotTakenForTheNextOnes) {
  Machine machine;
  ModbusServer server(machine, Link::rtu);
  auto t = open_transport(server.url("timeout_ms=100"));
  ASSERT_TRUE(t);
  std::array<std::uint16_t, 2> words{};
  server.mishap(Mishap::withhold);
  const auto silent = (*t)->read_inputs(0x0100, words);
  ASSERT_FALSE(silent);
  ASSERT_EQ(silent.error().kind, Kind::timed_out);
  server.release_withheld();
  tl::expected<void, LinkError> version;
  for (int i = 0; i < 50 && !(version = (*t)->read_inputs(0x0102, words)); ++i) {  // a busy machine may miss 100 ms
  }
  ASSERT_TRUE(version) << version.error().cause;
  EXPECT_EQ(words[0], 1);
  EXPECT_EQ(words[1], protocol::kMinor);
}

TEST(ModbusRtu, DriverWithoutRs485IsAWarning) {
  Machine machine;
  ModbusServer server(machine, Link::rtu);
  auto t = open_transport(server.url("rs485=1"));
  ASSERT_TRUE(t) << t.error().message();
  EXPECT_NE((*t)->warning().find("RS-485"), std::string::npos);
  EXPECT_NE((*t)->warning().find("Inappropriate ioctl"), std::string::npos) << (*t)->warning();
  std::array<std::uint16_t, 2> words{};
  EXPECT_TRUE((*t)->read_inputs(0x0100, words));
}

TEST(OpenTransport, NobodyThereIsNotFound) {
  std::string url;
  {
    Machine machine;
    ModbusServer server(machine, Link::tcp);
    url = server.url();
  }
  EXPECT_EQ(open_transport(url).error().kind, Kind::not_found);
  const auto serial = open_transport("modbus-rtu:/dev/does-not-exist");
  ASSERT_FALSE(serial);
  EXPECT_EQ(serial.error().kind, Kind::not_found);
  EXPECT_NE(serial.error().cause.find("No such file"), std::string::npos) << serial.error().cause;
  EXPECT_EQ(open_transport("modbus-tcp://h?unit=x").error().kind, Kind::refused);
  // Something that opens but is no serial line.
  EXPECT_FALSE(open_transport("modbus-rtu:/dev/does-not-exist/x"));
}

}  // namespace
}  // namespace celadon::test
