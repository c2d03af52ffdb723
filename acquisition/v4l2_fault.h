#pragma once
// Refused V4L2 requests as one sentence, their kind by the errno.

#include <string>

#include <tl/expected.hpp>

#include "acquisition/frame.h"

namespace celadon {

constexpr const char* kConnectCameraAgain = "connect the camera and open it again";

/// @param remedy  but for a camera that is gone, where it is kConnectCameraAgain
CameraError v4l2_fault(const std::string& device, const std::string& operation, int errno_value,
                       const std::string& remedy);

/// What to do about a camera that is in use.
std::string close_other_user_of(const std::string& path);

}  // namespace celadon
