#pragma once
#include <memory>
#include <string>

#include <tl/expected.hpp>

#include "firmware_bridge/transport.h"

namespace celadon {

/// open_transport() of a URL that begins with "usb:".
tl::expected<std::unique_ptr<Transport>, DeviceError> open_usb_transport(const std::string& url);

}  // namespace celadon
