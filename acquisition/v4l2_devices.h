#pragma once
// What the V4L2 cameras of this computer offer. Nothing is changed on them, and no stream is started.

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/v4l2_controls.h"

namespace celadon {

struct V4l2Size {
  std::uint32_t width_px = 0, height_px = 0;
  std::vector<double> frames_per_second;  ///< fastest first; empty: the driver does not tell
};

struct V4l2Format {
  std::uint32_t fourcc = 0;
  std::string description;
  bool usable = false;          ///< frames of it can be scanned with
  std::vector<V4l2Size> sizes;  ///< as listed; of a stepwise size its smallest and its largest
};

struct V4l2Device {
  std::string path, name, driver, bus, serial;
  std::vector<V4l2Format> formats;
  std::vector<V4l2Control> controls;  ///< numbers, switches and menus
  std::string problem;                ///< why nothing else is known of it, with the remedy; empty: it was asked
};

/// The capture devices of this computer, by the number of their node. Nodes that capture no video are left out.
/// @param nodes where their names stand: video0, video1 ...
std::vector<V4l2Device> list_v4l2_devices(const std::filesystem::path& nodes = "/sys/class/video4linux");

/// The node, "/dev/video2", of the one capture device on USB with this serial number: a camera that was unplugged may
/// come back under another number. Errors say that there is none, or name those that share it.
tl::expected<std::string, CameraError> find_v4l2_device(const std::string& serial,
                                                        const std::filesystem::path& nodes = "/sys/class/video4linux");

/// How to name a listed camera to other programs: "v4l2:serial=CAM001" where no other listed one has its serial number,
/// else "v4l2:/dev/video0".
std::string address_of(const V4l2Device& device, std::span<const V4l2Device> listed);

/// The format that a camera is opened with unless another is named. Null: none can be used.
const V4l2Format* preferred_format(const V4l2Device& device);

}  // namespace celadon
