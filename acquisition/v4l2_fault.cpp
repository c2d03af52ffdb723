#include "acquisition/v4l2_fault.h"

#include <cerrno>

#include "acquisition/camera_fault.h"
#include "acquisition/device_holder.h"

namespace celadon {
namespace {

using Kind = CameraError::Kind;

}  // namespace

CameraError v4l2_fault(const std::string& device, const std::string& operation, int errno_value,
                       const std::string& remedy) {
  const Kind kind = errno_value == ENODEV                            ? Kind::unplugged
                    : errno_value == EBUSY                           ? Kind::busy
                    : errno_value == EACCES                          ? Kind::permission
                    : errno_value == EINVAL || errno_value == ENOTTY ? Kind::unsupported
                                                                     : Kind::system;
  return camera_fault(kind, device, operation, errno_value, errno_value == ENODEV ? kConnectCameraAgain : remedy);
}

std::string close_other_user_of(const std::string& path) {
  const std::string holders = holders_of(path);
  return holders.empty() ? "another program uses the camera: close it" : "close what uses the camera: " + holders;
}

}  // namespace celadon
