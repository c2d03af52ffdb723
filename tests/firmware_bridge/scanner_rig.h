#pragma once
// A scanner's device code over a real Modbus link to a controller in this process, in device time.

#include <gtest/gtest.h>

#include <memory>
#include <numbers>
#include <string>
#include <utility>

#include "firmware_bridge/scanner_device.h"
#include "tests/firmware_bridge/modbus_machine.h"

namespace celadon::test {

using Kind = DeviceError::Kind;
using Link = ModbusServer::Link;
inline constexpr double kDeg = std::numbers::pi / 180;

struct ScannerRig {
  explicit ScannerRig(Link link = Link::tcp, const ControllerConfig& config = test_config())
      : machine(config), server(machine, link), clock(machine) {}

  tl::expected<std::unique_ptr<ScannerDevice>, DeviceError> try_open(const std::string& options = "timeout_ms=2000") {
    auto transport = open_transport(server.url(options));
    if (!transport) return tl::unexpected(transport.error());
    return ScannerDevice::open(std::move(*transport), clock);
  }
  void open(const std::string& options = "timeout_ms=2000") {
    auto opened = try_open(options);
    ASSERT_TRUE(opened) << opened.error().message();
    device = std::move(*opened);
  }
  void home() {
    const auto homed = device->home();
    ASSERT_TRUE(homed) << homed.error().message();
  }

  Machine machine;
  ModbusServer server;
  MachineClock clock;
  std::unique_ptr<ScannerDevice> device;
};

/// Tests that run over TCP and over RTU: INSTANTIATE_ON_BOTH_LINKS(Fixture), then TEST_P(Fixture, ...).
class OnALink : public testing::TestWithParam<Link> {
 protected:
  ScannerRig s{GetParam()};
};
inline std::string link_name(const testing::TestParamInfo<Link>& link) {
  return link.param == Link::tcp ? "Tcp" : "Rtu";
}
#define INSTANTIATE_ON_BOTH_LINKS(Fixture) \
  INSTANTIATE_TEST_SUITE_P(Modbus, Fixture, testing::Values(Link::tcp, Link::rtu), link_name)

}  // namespace celadon::test
