// celadon device probe and a daemon with a foreign drive, against simulated drives.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "tests/build_paths.h"
#include "tests/firmware_bridge/simulated_drives.h"
#include "tests/integration/process.h"

namespace celadon::testing {
namespace {

using test::ModbusServer;
using ::testing::AllOf;
using ::testing::HasSubstr;

const std::string kIoProfile = std::string(CELADON_SOURCE_DIR) + "/tests/firmware_bridge/io_module.toml";

TEST(DeviceProbe, ShowsRegistersDecodedAndWritesNothing) {
  test::DriveWorld world;
  test::IoModule io(world);
  test::LeadshineDrive drive(world, io);
  drive.alarm = 0x20;
  ModbusServer server(drive, ModbusServer::Link::tcp);
  const auto outcome = run({"celadon", "device", "probe", server.url(), "--profile", "leadshine-rs"});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_THAT(outcome.out, HasSubstr("position               0x602C  FFFF FCF7   -777 step"));
  EXPECT_THAT(outcome.out, HasSubstr("pr0_acceleration"));
  EXPECT_THAT(outcome.out, AllOf(HasSubstr("fault        yes"), HasSubstr("alarm        0x20: the position deviates")));
  EXPECT_THAT(outcome.out, HasSubstr("Pr8.10 homing mode"));
  EXPECT_EQ(drive.moves + drive.homings + drive.stops, 0);
}

TEST(DeviceProbe, AnIoDeviceToo) {
  test::DriveWorld world;
  test::IoModule io(world);
  ModbusServer server(io, ModbusServer::Link::tcp);
  const auto outcome = run({"celadon", "device", "probe", server.url(), "--profile", kIoProfile});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_THAT(outcome.out, HasSubstr("watchdog               0x1000  0005        500 ms"));
}

TEST(DeviceProbe, SaysWhatKeepsItFromReading) {
  const auto unknown = run({"celadon", "device", "probe", "modbus-tcp://127.0.0.1:1", "--profile", "abacus"});
  EXPECT_EQ(unknown.exit_code, 2);
  EXPECT_THAT(unknown.err, AllOf(HasSubstr("abacus.toml"), HasSubstr("cannot be opened")));
  const auto nobody = run({"celadon", "device", "probe", "modbus-tcp://127.0.0.1:1", "--profile", "leadshine-rs"});
  EXPECT_EQ(nobody.exit_code, 3) << nobody.err;
  test::DriveWorld world;
  test::IoModule io(world);
  test::AzDrive drive(world, io);
  ModbusServer server(drive, ModbusServer::Link::tcp);
  // Another drive answers there: every address is refused.
  const auto other = run({"celadon", "device", "probe", server.url(), "--profile", "leadshine-rs"});
  EXPECT_EQ(other.exit_code, 3) << other.out;
  EXPECT_THAT(other.err, HasSubstr("no register of leadshine-rs was answered"));
}

}  // namespace
}  // namespace celadon::testing
