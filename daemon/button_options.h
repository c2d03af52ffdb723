#pragma once
// What presses of the button are for.

#include <cstdint>

#include "firmware_bridge/host_button.h"

namespace celadon {

enum class PressMeaning : std::uint8_t { nothing, scan, self_test };

struct ButtonOptions {
  HostButton::Open open;  ///< a button at the computer besides the machine's own; empty: none
  PressTiming timing;     ///< the machine's own button is debounced by its controller
  PressMeaning brief = PressMeaning::scan, lasting = PressMeaning::self_test;
};

}  // namespace celadon
