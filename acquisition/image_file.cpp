#include "acquisition/image_file.h"

#include <png.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <memory>

namespace celadon {
namespace {

constexpr std::uint64_t kMostPixels = 256'000'000;
constexpr std::size_t kLargestFile = std::size_t{1} << 30;

tl::unexpected<ImageError> error(const std::filesystem::path& file, const std::string& what, int errno_value = 0) {
  return tl::unexpected(ImageError{"image " + file.string() + " " + what + ".", errno_value});
}

std::string errno_text(int code) {
  return std::string(std::strerror(code)) + " (errno " + std::to_string(code) + ")";
}

/// The next number of a PGM header, after white space and comments; -1 if there is none below a million.
int pgm_number(std::span<const std::uint8_t> bytes, std::size_t& at) {
  while (at < bytes.size() && (std::isspace(bytes[at]) != 0 || bytes[at] == '#')) {
    if (bytes[at] == '#') {
      while (at < bytes.size() && bytes[at] != '\n') ++at;
    } else {
      ++at;
    }
  }
  int value = -1;
  for (; at < bytes.size() && std::isdigit(bytes[at]) != 0 && value < 1'000'000; ++at) {
    value = std::max(value, 0) * 10 + (bytes[at] - '0');
  }
  return value < 1'000'000 ? value : -1;
}

tl::expected<void, ImageError> read_pgm(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                                        GreyImage& image) {
  std::size_t at = 2;
  const int width = pgm_number(bytes, at), height = pgm_number(bytes, at), maximum = pgm_number(bytes, at);
  if (width < 1 || height < 1 || width > 65535 || height > 65535) {
    return error(file, "has a broken PGM header at byte " + std::to_string(at) + "; write it again");
  }
  if (maximum != 255) {
    return error(file, "has the maximum " + std::to_string(maximum) + " and must have 255; convert it to 8 bits");
  }
  ++at;  // exactly one white space ends the header
  const std::size_t size = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  if (bytes.size() < at || bytes.size() - at < size) {
    return error(file, "ends after " + std::to_string(bytes.size()) + " bytes and its header promises " +
                           std::to_string(at + size) + "; copy it again");
  }
  image.width_px = width;
  image.height_px = height;
  image.bytes.assign(bytes.begin() + static_cast<std::ptrdiff_t>(at),
                     bytes.begin() + static_cast<std::ptrdiff_t>(at + size));
  return {};
}

/// What the callbacks of libpng share. libpng leaves by longjmp: nothing with a destructor may live in a frame it
/// skips.
struct PngInput {
  const std::uint8_t* bytes;
  std::size_t size, at;
  char message[128];
};

void png_take(png_structp png, png_bytep out, png_size_t count) {
  auto* input = static_cast<PngInput*>(png_get_io_ptr(png));
  if (count > input->size - input->at) png_error(png, "the file ends too early");
  std::memcpy(out, input->bytes + input->at, count);
  input->at += count;
}

void png_fail(png_structp png, png_const_charp message) {
  auto* input = static_cast<PngInput*>(png_get_error_ptr(png));
  std::snprintf(static_cast<char*>(input->message), sizeof input->message, "%s", message);
  png_longjmp(png, 1);
}

void png_ignore(png_structp /*png*/, png_const_charp /*message*/) {}

struct PngSize {
  png_uint_32 width, height;
  int channels;
};

/// Reads the header and, with `rows`, all rows of 1 or 3 channels of 8 bits.
bool decode_png(PngInput* input, PngSize* size, std::uint8_t* pixels, png_bytepp rows) {
  png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, input, png_fail, png_ignore);
  png_infop info = png != nullptr ? png_create_info_struct(png) : nullptr;
  if (info == nullptr) {
    png_destroy_read_struct(&png, nullptr, nullptr);
    std::snprintf(static_cast<char*>(input->message), sizeof input->message, "no memory");
    return false;
  }
  if (setjmp(png_jmpbuf(png)) != 0) {
    png_destroy_read_struct(&png, &info, nullptr);
    return false;
  }
  png_set_read_fn(png, input, png_take);
  png_set_user_limits(png, 65535, 65535);
  png_read_info(png, info);
  size->width = png_get_image_width(png, info);
  size->height = png_get_image_height(png, info);
  if (png_get_bit_depth(png, info) > 8) png_error(png, "16 bits a sample: convert it to 8");
  png_set_expand(png);
  png_set_strip_alpha(png);
  png_set_interlace_handling(png);
  png_read_update_info(png, info);
  size->channels = png_get_channels(png, info);
  if (size->channels != 1 && size->channels != 3) png_error(png, "neither grey nor colour");
  if (rows != nullptr) {
    const std::size_t row_bytes = static_cast<std::size_t>(size->width) * static_cast<std::size_t>(size->channels);
    for (png_uint_32 i = 0; i < size->height; ++i) rows[i] = pixels + i * row_bytes;
    png_read_image(png, rows);
  }
  png_destroy_read_struct(&png, &info, nullptr);
  return true;
}

tl::expected<void, ImageError> read_png(const std::filesystem::path& file, std::span<const std::uint8_t> bytes,
                                        ColourChannel channel, GreyImage& image) {
  const auto fail = [&](const PngInput& input) {
    return error(file, "is not a PNG that can be read: " + std::string(static_cast<const char*>(input.message)) +
                           " (byte " + std::to_string(input.at) + "); copy or convert it again");
  };
  PngSize size{};
  PngInput header{bytes.data(), bytes.size(), 0, {}};
  if (!decode_png(&header, &size, nullptr, nullptr)) return fail(header);
  const std::uint64_t pixels = std::uint64_t{size.width} * size.height;
  if (pixels > kMostPixels) {
    return error(file,
                 "has " + std::to_string(pixels) + " pixels and may have " + std::to_string(kMostPixels) + "; crop it");
  }
  // Deflate packs at most about 1032 bytes into one: a header that promises more lies, and no memory is taken for it.
  if (pixels * static_cast<std::uint64_t>(size.channels) / 1100 / 8 > bytes.size()) {
    return error(file, "has " + std::to_string(bytes.size()) + " bytes, too few for the " + std::to_string(size.width) +
                           " x " + std::to_string(size.height) + " pixels of its header; copy it again");
  }
  std::vector<png_bytep> rows(size.height);
  std::vector<std::uint8_t> decoded(pixels * static_cast<std::size_t>(size.channels));
  PngInput input{bytes.data(), bytes.size(), 0, {}};
  if (!decode_png(&input, &size, decoded.data(), rows.data())) return fail(input);
  image.width_px = static_cast<int>(size.width);
  image.height_px = static_cast<int>(size.height);
  if (size.channels == 1) {
    image.bytes = std::move(decoded);
    return {};
  }
  image.bytes.resize(pixels);
  const unsigned red = channel == ColourChannel::red ? 256 : channel == ColourChannel::green ? 0 : 77;
  const unsigned green = channel == ColourChannel::red ? 0 : channel == ColourChannel::green ? 256 : 150;
  const unsigned blue = 256 - red - green;
  for (std::size_t i = 0; i < pixels; ++i) {
    const std::uint8_t* rgb = &decoded[3 * i];
    image.bytes[i] = static_cast<std::uint8_t>((red * rgb[0] + green * rgb[1] + blue * rgb[2] + 128) >> 8);
  }
  return {};
}

}  // namespace

tl::expected<std::vector<std::uint8_t>, ImageError> read_bytes(const std::filesystem::path& file, std::size_t largest) {
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> stream(std::fopen(file.c_str(), "rb"), &std::fclose);
  if (stream == nullptr) {
    return error(file, "cannot be opened: " + errno_text(errno) + "; check the name and the permissions", errno);
  }
  struct stat status {};
  if (::fstat(::fileno(stream.get()), &status) != 0 || !S_ISREG(status.st_mode)) {
    return error(file, "is not a regular file; give the image itself");
  }
  const auto size = static_cast<std::uint64_t>(status.st_size);
  if (size > largest) {
    return error(file, "has " + std::to_string(size) + " bytes and may have " + std::to_string(largest) +
                           "; give the right file");
  }
  std::vector<std::uint8_t> bytes(size);
  if (std::fread(bytes.data(), 1, bytes.size(), stream.get()) != bytes.size()) {
    return error(file, "cannot be read to its end: " + errno_text(errno) + "; check the disk or copy it again", errno);
  }
  return bytes;
}

tl::expected<void, ImageError> read_image(const std::filesystem::path& file, ColourChannel channel, GreyImage& image) {
  const auto bytes = read_bytes(file, kLargestFile);
  if (!bytes) return tl::unexpected(bytes.error());
  if (bytes->empty()) return error(file, "is empty; copy it again");
  if (bytes->size() >= 2 && (*bytes)[0] == 'P' && (*bytes)[1] == '5') return read_pgm(file, *bytes, image);
  if (bytes->size() >= 8 && png_sig_cmp(bytes->data(), 0, 8) == 0) return read_png(file, *bytes, channel, image);
  return error(file, "is neither a binary PGM (P5) nor a PNG; convert it");
}

tl::expected<void, ImageError> write_pgm(const std::filesystem::path& file, int width_px, int height_px,
                                         std::size_t stride_bytes, std::span<const std::uint8_t> bytes) {
  const auto width = static_cast<std::size_t>(width_px), height = static_cast<std::size_t>(height_px);
  std::FILE* stream = std::fopen(file.c_str(), "wb");
  if (stream == nullptr) return error(file, "cannot be created: " + errno_text(errno) + "; check the folder", errno);
  bool good = std::fprintf(stream, "P5\n%d %d\n255\n", width_px, height_px) > 0;
  for (std::size_t row = 0; row < height && good; ++row) {
    good = std::fwrite(bytes.data() + row * stride_bytes, 1, width, stream) == width;
  }
  const int cause = errno;
  if (std::fclose(stream) != 0 || !good) {
    const int code = good ? errno : cause;
    return error(file, "cannot be written: " + errno_text(code) + "; free some space", code);
  }
  return {};
}

}  // namespace celadon
