#pragma once
// The pixels of the camera's slots, rendered as the frames are read out, and who streams: one client at a time.

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "sim/file_descriptor.h"
#include "sim/pacer.h"
#include "sim/render_worker.h"

namespace celadon::sim {

class FrameStore final : public Service {
 public:
  /// Renders in lock-step within the clock's advance, else in a thread of its own. The model has one of them.
  static tl::expected<std::unique_ptr<FrameStore>, std::string> open(DeviceModel& model, bool lock_step);
  ~FrameStore() override;
  FrameStore(const FrameStore&) = delete;
  FrameStore& operator=(const FrameStore&) = delete;

  /// Marks finished pictures.
  void collect(std::vector<pollfd>& polls) override;
  void serve(const pollfd* polls, std::size_t count) override;

  /// The memory that clients map, slot_bytes() a slot.
  int memory() const { return memory_.get(); }
  std::size_t slot_bytes() const { return slot_bytes_; }
  std::span<const std::uint8_t> slot(std::uint32_t index) const {
    return std::span<const std::uint8_t>(slots_).subspan(index * slot_bytes_, slot_bytes_);
  }

  /// Starts the camera for a client, anew if it streams already. @returns false while another one streams
  bool start(std::uint64_t client);
  /// Stops the camera if that client streams.
  void stop(std::uint64_t client);
  bool streams(std::uint64_t client) const { return streaming_ == client; }
  /// Nobody streams any more: the camera is gone.
  void forget() { streaming_ = 0; }

 private:
  explicit FrameStore(DeviceModel& model) : model_(model) {}

  DeviceModel& model_;
  FileDescriptor memory_;
  std::span<std::uint8_t> slots_;
  std::size_t slot_bytes_ = 0;
  std::unique_ptr<SlotPainter> painter_;
  std::unique_ptr<RenderWorker> worker_;
  std::uint64_t streaming_ = 0;
};

}  // namespace celadon::sim
