#include "sim/render_worker.h"

#include <sys/eventfd.h>

#include <algorithm>
#include <cstring>
#include <system_error>
#include <utility>

namespace celadon::sim {

SlotPainter::SlotPainter(const Scene& scene, const OpticsConfig& optics, const CameraConfig& camera,
                         std::span<std::uint8_t> slots, std::size_t slot_bytes)
    : renderer_(scene, optics),
      camera_(camera),
      slots_(slots),
      slot_bytes_(slot_bytes),
      last_(camera.frame_bytes(), 0) {}

void SlotPainter::paint(const DeviceModel::RenderOrder& order) {
  const std::span<std::uint8_t> slot = slots_.subspan(order.slot * slot_bytes_, camera_.frame_bytes());
  if (order.stale) {
    std::copy(last_.begin(), last_.end(), slot.begin());
    return;
  }
  if (order.scene && order.scene != shown_) {
    renderer_.put(*order.scene);
    shown_ = order.scene;
  }
  renderer_.place(order.pose, order.camera_turn_rad);
  renderer_.render(order.exposure, slot, camera_.stride_bytes());
  std::copy(slot.begin(), slot.end(), last_.begin());
  if (order.corrupt) {
    // Packets were lost in the middle: the rest of the picture moves up and leaves old bytes at the end.
    const std::size_t third = slot.size() / 3;
    std::memmove(slot.data() + third, slot.data() + third + 4096 % third, slot.size() - third - 4096 % third);
  }
}

RenderWorker::RenderWorker(SlotPainter& painter) : painter_(painter), ready_(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  if (!ready_) throw std::system_error(errno, std::generic_category(), "eventfd");
  thread_ = std::thread([this] { work(); });
}

RenderWorker::~RenderWorker() {
  {
    const MutexLock lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

void RenderWorker::submit(const DeviceModel::RenderOrder& order) {
  {
    const MutexLock lock(mutex_);
    orders_.push_back(order);
  }
  wake_.notify_one();
}

std::vector<std::uint64_t> RenderWorker::finished() {
  std::uint64_t count = 0;
  (void)!read(ready_.get(), &count, sizeof count);
  const MutexLock lock(mutex_);
  return std::exchange(done_, {});
}

void RenderWorker::work() {
  while (true) {
    DeviceModel::RenderOrder order;
    {
      const MutexLock lock(mutex_);
      while (orders_.empty() && !stop_) wake_.wait(mutex_);
      if (stop_) return;
      order = std::move(orders_.front());
      orders_.pop_front();
    }
    painter_.paint(order);
    {
      const MutexLock lock(mutex_);
      done_.push_back(order.number);
    }
    const std::uint64_t one = 1;
    (void)!write(ready_.get(), &one, sizeof one);
  }
}

}  // namespace celadon::sim
