#pragma once
// Renders frames in a thread of its own, so that a poll of the controller is never held up by a picture.

#include <cstdint>
#include <deque>
#include <span>
#include <thread>
#include <vector>

#include "sim/device_model.h"
#include "sim/file_descriptor.h"
#include "sim/renderer.h"
#include "sim/thread_annotations.h"

namespace celadon::sim {

/// Fills the slots of the frame ring.
class SlotPainter {
 public:
  /// @pre `slots` outlives it
  SlotPainter(const Scene& scene, const OpticsConfig& optics, const CameraConfig& camera, std::span<std::uint8_t> slots,
              std::size_t slot_bytes);
  void paint(const DeviceModel::RenderOrder& order);

 private:
  Renderer renderer_;
  std::shared_ptr<const Scene> shown_;  ///< by the renderer; none before the first frame
  CameraConfig camera_;
  std::span<std::uint8_t> slots_;
  std::size_t slot_bytes_;
  std::vector<std::uint8_t> last_;  ///< the picture before, for stale frames
};

class RenderWorker {
 public:
  explicit RenderWorker(SlotPainter& painter);
  ~RenderWorker();
  RenderWorker(const RenderWorker&) = delete;
  RenderWorker& operator=(const RenderWorker&) = delete;

  void submit(const DeviceModel::RenderOrder& order);
  /// Numbers of the frames done since the last call.
  std::vector<std::uint64_t> finished();
  /// Readable when there are some.
  int ready_fd() const { return ready_.get(); }

 private:
  void work();

  SlotPainter& painter_;  // used by the thread alone
  FileDescriptor ready_;
  Mutex mutex_;
  std::condition_variable_any wake_;
  std::deque<DeviceModel::RenderOrder> orders_ SIM_GUARDED_BY(mutex_);
  std::vector<std::uint64_t> done_ SIM_GUARDED_BY(mutex_);
  bool stop_ SIM_GUARDED_BY(mutex_) = false;
  std::thread thread_;
};

}  // namespace celadon::sim
