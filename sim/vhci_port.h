#pragma once
#include <string>

#include <tl/expected.hpp>

#include "sim/file_descriptor.h"

namespace celadon::sim {

/// Plugs a high-speed USB/IP device into this machine's kernel (vhci-hcd). @returns the socket that the kernel's host
/// controller speaks USB/IP on, from the first transfer on; closing it unplugs the device. Or one sentence
tl::expected<FileDescriptor, std::string> plug_into_kernel();

}  // namespace celadon::sim
