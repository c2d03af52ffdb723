#include "daemon/cli/overlay_image.h"

#include <png.h>

#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

namespace celadon::cli {
namespace {

using Colour = std::array<std::uint8_t, 3>;
constexpr Colour kFound{0, 255, 60}, kSaturated{255, 220, 0}, kAmbiguous{255, 0, 0};

void paint(std::vector<std::uint8_t>& rgb, int width, int x, int y, Colour colour) {
  if (x < 0 || x >= width) return;
  for (std::size_t k = 0; k < 3; ++k)
    rgb[(static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)) * 3 + k] =
        colour[k];
}

}  // namespace

std::string overlay_png(const GreyImage& image, std::span<const LineRow> rows) {
  std::vector<std::uint8_t> rgb;
  rgb.reserve(image.bytes.size() * 3);
  for (const std::uint8_t grey : image.bytes) rgb.insert(rgb.end(), 3, grey);
  for (int y = 0; y < image.height_px; ++y) {
    const LineRow& row = rows[static_cast<std::size_t>(y)];
    if (row.status == RowStatus::ambiguous) {
      for (int x = 0; x < 4; ++x) paint(rgb, image.width_px, x, y, kAmbiguous);
    }
    if (row.x_px < 0) continue;
    paint(rgb, image.width_px, static_cast<int>(std::lround(row.x_px)), y,
          row.status == RowStatus::saturated ? kSaturated : kFound);
  }
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  png.width = static_cast<png_uint_32>(image.width_px);
  png.height = static_cast<png_uint_32>(image.height_px);
  png.format = PNG_FORMAT_RGB;
  png_alloc_size_t size = 0;
  if (!png_image_write_to_memory(&png, nullptr, &size, 0, rgb.data(), 0, nullptr))
    throw std::runtime_error(png.message);
  std::string bytes(size, '\0');
  if (!png_image_write_to_memory(&png, bytes.data(), &size, 0, rgb.data(), 0, nullptr))
    throw std::runtime_error(png.message);
  bytes.resize(size);
  return bytes;
}

}  // namespace celadon::cli
