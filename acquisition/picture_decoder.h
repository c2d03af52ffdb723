#pragma once
// Grey pictures from formats that the line extractor does not read in place.

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include <tl/expected.hpp>

namespace celadon {

class PictureDecoder {
 public:
  virtual ~PictureDecoder() = default;

  /// nullptr for formats that need none, and for unknown ones.
  /// MJPG: the luma of the JPEG, chroma untouched. UYVY: its luma. Y10, Y12, Y16: the upper 8 bits, rounded. Bayer
  /// mosaics (BA81, GBRG, GRBG, RGGB): (R + 2 G + B) / 4 by the binomial filter over 5 x 3 pixels, which weighs the
  /// colours alike at every pixel and shifts a line by less than 0.01 px; 3 pixels along the row would shift it by
  /// 0.04.
  /// @pre at least 5 x 2 pixels
  /// @param stride_bytes  of the driver's rows; unused for MJPG
  static std::unique_ptr<PictureDecoder> of(std::uint32_t fourcc, int width_px, int height_px,
                                            std::size_t stride_bytes);

  /// Bytes that the driver has to deliver at least.
  virtual std::size_t least_bytes() const = 0;
  /// @param grey  width x height, rows without padding
  /// @return what is wrong with the picture; grey then holds what could be read, or what it held before
  virtual tl::expected<void, std::string> decode(std::span<const std::uint8_t> bytes, std::span<std::uint8_t> grey) = 0;
};

}  // namespace celadon
