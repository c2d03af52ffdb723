#pragma once
// A button wired to this computer, across its departures and returns.

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "firmware_bridge/button_source.h"
#include "firmware_bridge/press_classifier.h"

namespace celadon {

class HostButton {
 public:
  using Open = std::function<tl::expected<std::unique_ptr<ButtonSource>, ButtonError>()>;

  HostButton(Open open, PressTiming timing) : open_(std::move(open)), presses_(timing) {}

  /// Takes what the contact did until now (CLOCK_MONOTONIC) into presses(); looks once a second for one that is gone.
  /// Never waits. @returns news for the operator, each once: why it cannot be used, or that it can again
  std::optional<std::string> look(std::int64_t now_ns);
  PressClassifier& presses() { return presses_; }
  /// Why it cannot be used; empty: it can.
  const std::string& problem() const { return problem_; }

 private:
  const Open open_;
  std::unique_ptr<ButtonSource> source_;
  std::vector<ButtonEdge> edges_;
  std::string problem_;
  std::optional<std::int64_t> next_try_ns_;
  PressClassifier presses_;
};

}  // namespace celadon
