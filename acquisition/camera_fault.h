#pragma once
// One sentence for every fault of a camera, built the same way by all sources.

#include <cstring>
#include <string>

#include "acquisition/frame.h"

namespace celadon {

/// "DEVICE: OPERATION failed: CAUSE; REMEDY."
inline CameraError camera_fault(CameraError::Kind kind, const std::string& device, const std::string& operation,
                                const std::string& cause, const std::string& remedy, int errno_value = 0) {
  return {kind, errno_value, device + ": " + operation + " failed: " + cause + "; " + remedy + "."};
}

/// The same with the system's words for an errno as the cause.
inline CameraError camera_fault(CameraError::Kind kind, const std::string& device, const std::string& operation,
                                int errno_value, const std::string& remedy) {
  return camera_fault(kind, device, operation,
                      std::string(std::strerror(errno_value)) + " (errno " + std::to_string(errno_value) + ")", remedy,
                      errno_value);
}

}  // namespace celadon
