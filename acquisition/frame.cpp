#include "acquisition/frame.h"

#include "acquisition/camera_fault.h"
#include "acquisition/frame_sources.h"

namespace celadon {

const char* to_string(PixelFormat format) {
  return format == PixelFormat::grey8 ? "GREY" : "YUYV";
}

tl::expected<std::unique_ptr<FrameSource>, CameraError> open_frame_source(const std::string& url) {
  const auto after = [&](const char* scheme) { return url.substr(std::string(scheme).size()); };
  if (url.starts_with("v4l2:") && url.size() > 5) return open_v4l2_source(after("v4l2:"));
  if (url.starts_with("sim:") && url.size() > 4) return open_sim_source(after("sim:"));
  if (url.starts_with("replay:") && url.size() > 7) return open_replay_source(after("replay:"));
  return tl::unexpected(camera_fault(CameraError::Kind::unsupported, "camera \"" + url + "\"", "opening",
                                     "the address is none of v4l2:/dev/videoN, sim:FOLDER and replay:FOLDER",
                                     "give one of these with --camera"));
}

}  // namespace celadon
