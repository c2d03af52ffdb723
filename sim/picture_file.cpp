#include "sim/picture_file.h"

#include <png.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <vector>

namespace celadon::sim {

tl::expected<void, std::string> write_picture(const std::filesystem::path& file, int width_px, int height_px,
                                              PixelFormat format, std::span<const std::uint8_t> bytes) {
  const std::size_t pixels = static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  const std::size_t step = bytes_per_pixel(format);
  std::vector<std::uint8_t> grey(pixels);
  for (std::size_t i = 0; i < pixels; ++i) grey[i] = bytes[i * step];
  errno = 0;  // libpng tells less than the system
  const std::filesystem::path part = file.string() + ".part";
  std::string cause;
  if (file.extension() == ".png") {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    image.width = static_cast<png_uint_32>(width_px);
    image.height = static_cast<png_uint_32>(height_px);
    image.format = PNG_FORMAT_GRAY;
    if (png_image_write_to_file(&image, part.c_str(), 0, grey.data(), width_px, nullptr) == 0) {
      cause = errno != 0 ? std::strerror(errno) : image.message;
    }
  } else {
    std::ofstream out(part, std::ios::binary | std::ios::trunc);
    out << "P5\n" << width_px << " " << height_px << "\n255\n";
    out.write(reinterpret_cast<const char*>(grey.data()), static_cast<std::streamsize>(grey.size()));
    out.close();
    if (!out) cause = std::strerror(errno);
  }
  std::error_code error;
  if (cause.empty()) {
    std::filesystem::rename(part, file, error);
    if (!error) return {};
    cause = error.message();
  }
  std::filesystem::remove(part, error);
  return tl::unexpected("writing " + file.string() + " failed: " + cause +
                        "; free some space or choose another folder");
}

}  // namespace celadon::sim
