#include "acquisition/picture_decoder.h"

#include <linux/videodev2.h>
#include <turbojpeg.h>

#include <algorithm>
#include <array>
#include <vector>

namespace celadon {
namespace {

struct Size {
  std::size_t width, height;
};

class JpegDecoder final : public PictureDecoder {
 public:
  explicit JpegDecoder(Size size) : size_(size), jpeg_(tjInitDecompress()) {}
  ~JpegDecoder() override {
    if (jpeg_ != nullptr) tjDestroy(jpeg_);
  }
  JpegDecoder(const JpegDecoder&) = delete;
  JpegDecoder& operator=(const JpegDecoder&) = delete;

  std::size_t least_bytes() const override { return 1; }

  ColourLayout colour_layout() const override {
    return size_.width % 2 == 0 && size_.height % 2 == 0 ? ColourLayout::uv_pairs : ColourLayout::none;
  }

  tl::expected<bool, std::string> decode(std::span<const std::uint8_t> bytes, std::span<std::uint8_t> grey,
                                         std::span<std::uint8_t> colour) override {
    if (jpeg_ == nullptr) return tl::unexpected(std::string("there is no memory for the JPEG decoder"));
    int width = 0, height = 0, subsampling = 0, colours = 0;
    if (tjDecompressHeader3(jpeg_, bytes.data(), bytes.size(), &width, &height, &subsampling, &colours) != 0) {
      return tl::unexpected(std::string("it is no JPEG (") + tjGetErrorStr2(jpeg_) + ")");
    }
    if (static_cast<std::size_t>(width) != size_.width || static_cast<std::size_t>(height) != size_.height) {
      return tl::unexpected("the JPEG has " + std::to_string(width) + " x " + std::to_string(height) + " px");
    }
    const bool coloured = !colour.empty() && subsampling != TJSAMP_GRAY && colours == TJCS_YCbCr;
    const int failed =
        coloured ? decode_planes(bytes, subsampling, grey)
                 : tjDecompress2(jpeg_, bytes.data(), bytes.size(), grey.data(), width, width, height, TJPF_GRAY, 0);
    if (coloured) pair_up(subsampling, colour);
    if (failed == 0) return coloured;
    // A cut JPEG is no more than a warning to the library, and a picture with grey parts. So are bytes too many before
    // a marker, which many cameras send and which take nothing away.
    const std::string cause = tjGetErrorStr2(jpeg_);
    const bool harmless = tjGetErrorCode(jpeg_) == TJERR_WARNING && cause.find("extraneous bytes") != std::string::npos;
    if (harmless) return coloured;
    return tl::unexpected("the JPEG is damaged (" + cause + ")");
  }

 private:
  /// Luma goes where it belongs: planes of even pictures have no padding.
  int decode_planes(std::span<const std::uint8_t> bytes, int subsampling, std::span<std::uint8_t> grey) {
    const int width = static_cast<int>(size_.width), height = static_cast<int>(size_.height);
    std::array<unsigned char*, 3> planes{grey.data()};
    for (int k = 1; k < 3; ++k) {
      auto& plane = chroma_[static_cast<std::size_t>(k - 1)];
      plane.resize(tjPlaneSizeYUV(k, width, 0, height, subsampling));
      planes[static_cast<std::size_t>(k)] = plane.data();
    }
    return tjDecompressToYUVPlanes(jpeg_, bytes.data(), bytes.size(), planes.data(), width, nullptr, height, 0);
  }

  void pair_up(int subsampling, std::span<std::uint8_t> colour) const {
    const int width = static_cast<int>(size_.width), height = static_cast<int>(size_.height);
    const auto wide = static_cast<std::size_t>(tjPlaneWidth(1, width, subsampling)),
               high = static_cast<std::size_t>(tjPlaneHeight(1, height, subsampling));
    for (std::size_t y = 0; y < size_.height; ++y) {
      const std::size_t row = y * high / size_.height * wide;
      for (std::size_t x = 0; x < size_.width; x += 2) {
        const std::size_t from = row + x * wide / size_.width, to = y * size_.width + x;
        colour[to] = chroma_[0][from];
        colour[to + 1] = chroma_[1][from];
      }
    }
  }

  Size size_;
  tjhandle jpeg_;
  std::array<std::vector<std::uint8_t>, 2> chroma_;
};

/// Formats with rows at a stride.
class RowDecoder : public PictureDecoder {
 public:
  RowDecoder(Size size, std::size_t stride_bytes, std::size_t row_bytes)
      : size_(size), stride_bytes_(std::max(stride_bytes, row_bytes)), row_bytes_(row_bytes) {}
  std::size_t least_bytes() const override { return stride_bytes_ * (size_.height - 1) + row_bytes_; }

 protected:
  const Size size_;
  const std::size_t stride_bytes_, row_bytes_;
};

class UyvyDecoder final : public RowDecoder {
 public:
  UyvyDecoder(Size size, std::size_t stride_bytes) : RowDecoder(size, stride_bytes, 2 * size.width) {}
  ColourLayout colour_layout() const override { return ColourLayout::uv_pairs; }
  tl::expected<bool, std::string> decode(std::span<const std::uint8_t> bytes, std::span<std::uint8_t> grey,
                                         std::span<std::uint8_t> colour) override {
    for (std::size_t y = 0; y < size_.height; ++y) {
      const std::uint8_t* const in = bytes.data() + y * stride_bytes_;
      std::uint8_t* const out = grey.data() + y * size_.width;
      for (std::size_t x = 0; x < size_.width; ++x) out[x] = in[2 * x + 1];
      if (colour.empty()) continue;
      std::uint8_t* const beside = colour.data() + y * size_.width;
      for (std::size_t x = 0; x < size_.width; ++x) beside[x] = in[2 * x];
    }
    return !colour.empty();
  }
};

/// Little-endian 16-bit words, the sample in their lower bits.
class DeepDecoder final : public RowDecoder {
 public:
  DeepDecoder(Size size, std::size_t stride_bytes, unsigned bits)
      : RowDecoder(size, stride_bytes, 2 * size.width), shift_(bits - 8) {}
  tl::expected<bool, std::string> decode(std::span<const std::uint8_t> bytes, std::span<std::uint8_t> grey,
                                         std::span<std::uint8_t> /*colour*/) override {
    const std::uint32_t half = 1u << (shift_ - 1);
    for (std::size_t y = 0; y < size_.height; ++y) {
      const std::uint8_t* const in = bytes.data() + y * stride_bytes_;
      std::uint8_t* const out = grey.data() + y * size_.width;
      for (std::size_t x = 0; x < size_.width; ++x) {
        const std::uint32_t sample = in[2 * x] + 256u * in[2 * x + 1];
        out[x] = static_cast<std::uint8_t>(std::min((sample + half) >> shift_, 255u));
      }
    }
    return false;
  }

 private:
  const unsigned shift_;
};

class BayerDecoder final : public RowDecoder {
 public:
  BayerDecoder(Size size, std::size_t stride_bytes, ColourLayout mosaic)
      : RowDecoder(size, stride_bytes, size.width), mosaic_(mosaic), sums_(size.width) {}
  ColourLayout colour_layout() const override { return mosaic_; }
  tl::expected<bool, std::string> decode(std::span<const std::uint8_t> bytes, std::span<std::uint8_t> grey,
                                         std::span<std::uint8_t> colour) override {
    const std::size_t w = size_.width, h = size_.height;
    for (std::size_t y = 0; y < h; ++y) {
      // Mirrored at the border: the neighbour there has the colour of the one beyond it.
      const auto row = [&](std::size_t k) { return bytes.data() + k * stride_bytes_; };
      const std::uint8_t* const here = row(y);
      const std::uint8_t* const above = row(y == 0 ? 1 : y - 1);
      const std::uint8_t* const below = row(y + 1 == h ? h - 2 : y + 1);
      for (std::size_t x = 0; x < w; ++x) sums_[x] = static_cast<std::uint16_t>(above[x] + 2 * here[x] + below[x]);
      std::uint8_t* const out = grey.data() + y * w;
      const auto put = [&](std::size_t x, std::size_t left2, std::size_t left, std::size_t right, std::size_t right2) {
        const int sum = sums_[left2] + sums_[right2] + 4 * (sums_[left] + sums_[right]) + 6 * sums_[x];
        out[x] = static_cast<std::uint8_t>((sum + 32) >> 6);
      };
      put(0, 2, 1, 1, 2);
      put(1, 1, 0, 2, 3);
      for (std::size_t x = 2; x + 2 < w; ++x) put(x, x - 2, x - 1, x + 1, x + 2);
      put(w - 2, w - 4, w - 3, w - 1, w - 2);
      put(w - 1, w - 3, w - 2, w - 2, w - 3);
      if (!colour.empty()) std::copy_n(here, w, colour.data() + y * w);
    }
    return !colour.empty();
  }

 private:
  const ColourLayout mosaic_;
  std::vector<std::uint16_t> sums_;
};

}  // namespace

std::unique_ptr<PictureDecoder> PictureDecoder::of(std::uint32_t fourcc, int width_px, int height_px,
                                                   std::size_t stride_bytes) {
  const Size size{static_cast<std::size_t>(width_px), static_cast<std::size_t>(height_px)};
  switch (fourcc) {
    case V4L2_PIX_FMT_MJPEG:
    case V4L2_PIX_FMT_JPEG:
      return std::make_unique<JpegDecoder>(size);
    case V4L2_PIX_FMT_UYVY:
      return std::make_unique<UyvyDecoder>(size, stride_bytes);
    case V4L2_PIX_FMT_Y10:
      return std::make_unique<DeepDecoder>(size, stride_bytes, 10u);
    case V4L2_PIX_FMT_Y12:
      return std::make_unique<DeepDecoder>(size, stride_bytes, 12u);
    case V4L2_PIX_FMT_Y16:
      return std::make_unique<DeepDecoder>(size, stride_bytes, 16u);
    case V4L2_PIX_FMT_SBGGR8:
      return std::make_unique<BayerDecoder>(size, stride_bytes, ColourLayout::bggr);
    case V4L2_PIX_FMT_SGBRG8:
      return std::make_unique<BayerDecoder>(size, stride_bytes, ColourLayout::gbrg);
    case V4L2_PIX_FMT_SGRBG8:
      return std::make_unique<BayerDecoder>(size, stride_bytes, ColourLayout::grbg);
    case V4L2_PIX_FMT_SRGGB8:
      return std::make_unique<BayerDecoder>(size, stride_bytes, ColourLayout::rggb);
    default:
      return nullptr;
  }
}

}  // namespace celadon
