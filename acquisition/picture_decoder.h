#pragma once
// Grey pictures, and the colours beside them, from formats that the line extractor does not read in place.

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include <tl/expected.hpp>

#include "acquisition/colour_coding.h"

namespace celadon {

class PictureDecoder {
 public:
  virtual ~PictureDecoder() = default;

  /// nullptr for formats that need none, and for unknown ones.
  /// MJPG: the luma of the JPEG. UYVY: its luma. Y10, Y12, Y16: the upper 8 bits, rounded. Bayer
  /// mosaics (BA81, GBRG, GRBG, RGGB): (R + 2 G + B) / 4 by the binomial filter over 5 x 3 pixels, which weighs the
  /// colours alike at every pixel and shifts a line by less than 0.01 px; 3 pixels along the row would shift it by
  /// 0.04.
  /// @pre at least 5 x 2 pixels
  /// @param stride_bytes  of the driver's rows; unused for MJPG
  static std::unique_ptr<PictureDecoder> of(std::uint32_t fourcc, int width_px, int height_px,
                                            std::size_t stride_bytes);

  /// Bytes that the driver has to deliver at least.
  virtual std::size_t least_bytes() const = 0;
  /// Where the colours of its pictures lie, rows without padding: of MJPG and UYVY a pair for every two pixels of a
  /// row, the nearest that the picture has; of Bayer the mosaic as it is. None of deep grey formats, and of JPEGs whose
  /// width or height is odd.
  virtual ColourLayout colour_layout() const { return ColourLayout::none; }
  /// @param grey    width x height, rows without padding
  /// @param colour  width x height as well, or empty: not wanted. @pre empty without a colour_layout()
  /// @return whether `colour` has been filled, which a grey JPEG does not; or what is wrong with the picture: grey then
  /// holds what could be read, or what it held before
  virtual tl::expected<bool, std::string> decode(std::span<const std::uint8_t> bytes, std::span<std::uint8_t> grey,
                                                 std::span<std::uint8_t> colour = {}) = 0;
};

}  // namespace celadon
