#include "daemon/cli/overlay_image.h"

#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

namespace celadon::cli {
namespace {

using Colour = std::array<std::uint8_t, 3>;
constexpr Colour kFound{0, 255, 60}, kSaturated{255, 220, 0}, kAmbiguous{255, 0, 0};

/// A picture that is painted row by row, or column by column.
class Canvas {
 public:
  Canvas(const GreyImage& image, LineAlong along)
      : rows_(along == LineAlong::rows),
        width_(static_cast<std::size_t>(image.width_px)),
        length_(rows_ ? image.width_px : image.height_px) {
    rgb_.reserve(image.bytes.size() * 3);
    for (const std::uint8_t grey : image.bytes) rgb_.insert(rgb_.end(), 3, grey);
  }
  /// Paints the pixel `at` of a row (column), if there is one.
  void paint(std::size_t row, int at, Colour colour) {
    if (at < 0 || at >= length_) return;
    const auto along = static_cast<std::size_t>(at);
    const std::size_t pixel = rows_ ? row * width_ + along : along * width_ + row;
    std::copy(colour.begin(), colour.end(), rgb_.begin() + static_cast<std::ptrdiff_t>(3 * pixel));
  }
  const std::uint8_t* bytes() const { return rgb_.data(); }

 private:
  bool rows_;
  std::size_t width_;
  int length_;
  std::vector<std::uint8_t> rgb_;
};

}  // namespace

std::string overlay_png(const GreyImage& image, std::span<const LineRow> rows, LineAlong along) {
  Canvas canvas(image, along);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const LineRow& row = rows[i];
    if (row.status == RowStatus::ambiguous) {
      for (int at = 0; at < 4; ++at) canvas.paint(i, at, kAmbiguous);
    }
    if (row.x_px < 0) continue;
    canvas.paint(i, static_cast<int>(std::lround(row.x_px)), row.status == RowStatus::saturated ? kSaturated : kFound);
  }
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  png.width = static_cast<png_uint_32>(image.width_px);
  png.height = static_cast<png_uint_32>(image.height_px);
  png.format = PNG_FORMAT_RGB;
  png_alloc_size_t size = 0;
  if (!png_image_write_to_memory(&png, nullptr, &size, 0, canvas.bytes(), 0, nullptr))
    throw std::runtime_error(png.message);
  std::string bytes(size, '\0');
  if (!png_image_write_to_memory(&png, bytes.data(), &size, 0, canvas.bytes(), 0, nullptr))
    throw std::runtime_error(png.message);
  bytes.resize(size);
  return bytes;
}

}  // namespace celadon::cli
