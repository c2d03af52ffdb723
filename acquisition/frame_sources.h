#pragma once
// The sources behind open_frame_source(); private to acquisition and its tests.

#include <memory>
#include <string>

#include "acquisition/frame.h"

namespace celadon {

/// A client of a frame ring. `answer_limit_ns` is how long the server may stay silent beyond a declared wait before the
/// connection counts as lost.
tl::expected<std::unique_ptr<FrameSource>, CameraError> open_sim_source(const std::string& folder,
                                                                        std::int64_t answer_limit_ns = 20'000'000'000);
/// A recording (REPLAY.md).
tl::expected<std::unique_ptr<FrameSource>, CameraError> open_replay_source(const std::string& folder);
/// A V4L2 capture device: "/dev/video0?width=1280&height=1024&format=GREY".
tl::expected<std::unique_ptr<FrameSource>, CameraError> open_v4l2_source(const std::string& address);

}  // namespace celadon
