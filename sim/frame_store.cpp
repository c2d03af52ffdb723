#include "sim/frame_store.h"

#include <fcntl.h>
#include <sys/mman.h>

#include "sim/system_text.h"

namespace celadon::sim {
namespace {

constexpr std::size_t kPage = 4096;

}  // namespace

tl::expected<std::unique_ptr<FrameStore>, std::string> FrameStore::open(DeviceModel& model, bool lock_step) {
  std::unique_ptr<FrameStore> store(new FrameStore(model));
  const CameraConfig& camera = model.config().camera;
  store->slot_bytes_ = (camera.frame_bytes() + kPage - 1) / kPage * kPage;
  const std::size_t total = store->slot_bytes_ * camera.slots;
  store->memory_.reset(memfd_create("celadon-sim frames", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (!store->memory_ || ftruncate(store->memory_.get(), static_cast<off_t>(total)) != 0 ||
      fcntl(store->memory_.get(), F_ADD_SEALS, F_SEAL_SHRINK) != 0) {
    return tl::unexpected(system_text("reserving " + std::to_string(total) + " bytes for frames"));
  }
  void* mapped = mmap(nullptr, total, PROT_READ | PROT_WRITE, MAP_SHARED, store->memory_.get(), 0);
  if (mapped == MAP_FAILED) return tl::unexpected(system_text("mapping the frames"));
  store->slots_ = {static_cast<std::uint8_t*>(mapped), total};
  store->painter_ =
      std::make_unique<SlotPainter>(model.scene(), model.config().optics, camera, store->slots_, store->slot_bytes_);
  FrameStore* self = store.get();
  if (!lock_step) self->worker_ = std::make_unique<RenderWorker>(*self->painter_);
  model.set_render([self](const DeviceModel::RenderOrder& order) {
    if (self->worker_) {
      self->worker_->submit(order);
      return false;
    }
    self->painter_->paint(order);
    return true;
  });
  return store;
}

FrameStore::~FrameStore() {
  model_.set_render({});
  worker_.reset();
  if (!slots_.empty()) munmap(slots_.data(), slots_.size());
}

void FrameStore::collect(std::vector<pollfd>& polls) {
  polls.push_back({worker_ ? worker_->ready_fd() : -1, POLLIN, 0});
}

void FrameStore::serve(const pollfd* /*polls*/, std::size_t /*count*/) {
  if (!worker_) return;
  for (const std::uint64_t number : worker_->finished()) model_.camera().mark_rendered(number);
}

bool FrameStore::start(std::uint64_t client) {
  if (streaming_ != 0 && streaming_ != client) return false;
  streaming_ = client;
  model_.camera().start(model_.now_ns());
  return true;
}

void FrameStore::stop(std::uint64_t client) {
  if (streaming_ != client) return;
  model_.camera().stop();
  streaming_ = 0;
}

}  // namespace celadon::sim
