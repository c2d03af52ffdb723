#pragma once
// Position samples as a controller on USB sends them, decoded and kept until somebody takes them.

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "firmware_bridge/transport.h"

namespace celadon {

/// The newest trace samples, oldest first.
class UsbTrace {
 public:
  static constexpr std::size_t kKept = 4096;  ///< 4 s at 1 kHz; whoever wants them takes them at every poll

  UsbTrace() : samples_(kKept) {}
  /// One transfer; bytes that make no whole sample are left out.
  void receive(std::span<const std::uint8_t> bytes);
  std::size_t take(std::span<TraceSample> to);

 private:
  std::vector<TraceSample> samples_;
  std::size_t first_ = 0, count_ = 0;
};

}  // namespace celadon
