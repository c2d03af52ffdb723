#include "firmware_bridge/firmware_example/firmware.h"

#include "firmware_bridge/firmware_example/board.h"

namespace celadon::example {

ControllerConfig machine_config(bool simulated) {
  ControllerConfig config;
  config.vendor = "Celadon";
  config.model = "Firmware Example";
  config.serial = "0001";
  config.simulated = simulated;
  config.safety_hardware = protocol::kHasWatchdog | protocol::kHasInterlock | protocol::kHasEmergencyStop;
  ControllerConfig::Axis& table = config.axis[0];
  table.features = protocol::kEndless | protocol::kHasIndex;  // a stepper without an encoder: open loop
  table.encoder_resolution_ndeg = static_cast<std::uint32_t>(kUdegPerStep * 1'000);
  table.max_speed_udeg_per_s = 90'000'000;
  table.max_acceleration_udeg_per_s2 = 180'000'000;
  return config;
}

void Firmware::run_once(std::uint64_t now_us) {
  board::feed_watchdog();
  plant_.advance(now_us);
  for (int byte = board::receive_byte(); byte >= 0; byte = board::receive_byte())
    slave_.receive(static_cast<std::uint8_t>(byte), now_us);
  slave_.advance(now_us);
  if (const int byte = slave_.next_byte(); byte >= 0 && board::send_byte(static_cast<std::uint8_t>(byte)))
    slave_.sent();
  if (now_us < next_step_us_) return;
  next_step_us_ = now_us + 1'000;
  core_.step(now_us);
}

}  // namespace celadon::example
