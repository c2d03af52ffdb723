#pragma once
// A picture as the payload of a video format.

#include <memory>
#include <span>

#include "sim/usb_bytes.h"

namespace celadon::sim {

enum class VideoFormat : std::uint8_t { grey = 1, yuyv = 2, mjpeg = 3 };

/// Most bytes of a coded picture.
std::size_t most_bytes(VideoFormat format, int width_px, int height_px);

class PictureCoder {
 public:
  PictureCoder();
  ~PictureCoder();
  PictureCoder(const PictureCoder&) = delete;
  PictureCoder& operator=(const PictureCoder&) = delete;

  /// Appends the coded picture to `out`; uncompressed ones of as many pixels as there are. MJPEG: 4:2:2, as cameras
  /// send it; what is missing of a picture is black.
  /// @param chroma  U V for every two pixels of a row, as many bytes as luma; empty: a grey picture
  void append(VideoFormat format, std::span<const std::uint8_t> luma, std::span<const std::uint8_t> chroma,
              int width_px, int height_px, Bytes& out);

 private:
  struct Jpeg;
  std::unique_ptr<Jpeg> jpeg_;
};

}  // namespace celadon::sim
