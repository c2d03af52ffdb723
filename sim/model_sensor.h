#pragma once
// The virtual scanner's camera as a USB camera's sensor: a frame's first data are there at its time stamp, its pixels
// when it is read out and rendered. The sensor's memory holds one picture: a frame that begins before the one ahead has
// left is lost, as with a real camera on a slow bus, and so is one whose beginning the host would hear of too late.

#include <optional>

#include "sim/camera_sensor.h"
#include "sim/frame_store.h"
#include "sim/usb_bytes.h"

namespace celadon::sim {

class ModelSensor final : public CameraSensor {
 public:
  /// @pre both outlive it @param client its number among the store's clients
  ModelSensor(DeviceModel& model, FrameStore& store, std::uint64_t client);

  int width_px() const override { return model_.config().camera.width_px; }
  int height_px() const override { return model_.config().camera.height_px; }
  std::int64_t period_ns() const override { return model_.config().camera.period_ns; }
  std::int64_t longest_exposure_ns() const override { return period_ns() - 100'000; }
  bool start() override;
  void stop() override;
  bool begin_picture() override;
  Picture picture() override;
  void end_picture() override;
  void set_exposure(std::int64_t exposure_ns) override;

 private:
  DeviceModel& model_;
  FrameStore& store_;
  const std::uint64_t client_;
  std::optional<std::uint64_t> under_way_;  ///< frame number
  std::optional<FrameTicket> shown_;
  Bytes luma_, chroma_;
};

}  // namespace celadon::sim
