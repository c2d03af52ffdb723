#include "sim/picture_coding.h"

#include <turbojpeg.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <string>

namespace celadon::sim {
namespace {

constexpr std::uint8_t kNoColour = 128;
constexpr int kQuality = 90;

}  // namespace

struct PictureCoder::Jpeg {
  tjhandle handle = nullptr;
  unsigned char* buffer = nullptr;
  unsigned long capacity = 0;
  Bytes luma, u, v;
  ~Jpeg() {
    if (buffer != nullptr) tjFree(buffer);
    if (handle != nullptr) tjDestroy(handle);
  }
};

PictureCoder::PictureCoder() : jpeg_(std::make_unique<Jpeg>()) {}
PictureCoder::~PictureCoder() = default;

std::size_t most_bytes(VideoFormat format, int width_px, int height_px) {
  const std::size_t pixels = static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  if (format == VideoFormat::mjpeg) return tjBufSize(width_px, height_px, TJSAMP_422);
  return format == VideoFormat::yuyv ? 2 * pixels : pixels;
}

void PictureCoder::append(VideoFormat format, std::span<const std::uint8_t> luma, std::span<const std::uint8_t> chroma,
                          int width_px, int height_px, Bytes& out) {
  if (format == VideoFormat::grey) {
    out.insert(out.end(), luma.begin(), luma.end());
    return;
  }
  if (format == VideoFormat::yuyv) {
    const std::size_t at = out.size();
    out.resize(at + 2 * luma.size(), kNoColour);
    for (std::size_t i = 0; i < luma.size(); ++i) out[at + 2 * i] = luma[i];
    for (std::size_t i = 0; i < chroma.size(); ++i) out[at + 2 * i + 1] = chroma[i];
    return;
  }
  if (jpeg_->handle == nullptr) jpeg_->handle = tjInitCompress();
  const std::size_t pixels = static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  jpeg_->luma.assign(pixels, 0);
  std::copy_n(luma.begin(), std::min(luma.size(), pixels), jpeg_->luma.begin());
  jpeg_->u.assign(pixels, kNoColour);  // more than its plane
  jpeg_->v.assign(pixels, kNoColour);
  for (std::size_t i = 0; i + 1 < std::min(chroma.size(), pixels); i += 2) {
    jpeg_->u[i / 2] = chroma[i];
    jpeg_->v[i / 2] = chroma[i + 1];
  }
  const std::array<const unsigned char*, 3> planes{jpeg_->luma.data(), jpeg_->u.data(), jpeg_->v.data()};
  unsigned long bytes = jpeg_->capacity;
  if (jpeg_->handle == nullptr ||
      tjCompressFromYUVPlanes(jpeg_->handle, const_cast<const unsigned char**>(planes.data()), width_px, nullptr,
                              height_px, TJSAMP_422, &jpeg_->buffer, &bytes, kQuality, 0) != 0)
    throw std::runtime_error("coding a JPEG picture failed: " + std::string(tjGetErrorStr2(jpeg_->handle)));
  jpeg_->capacity = std::max(jpeg_->capacity, bytes);
  out.insert(out.end(), jpeg_->buffer, jpeg_->buffer + bytes);
}

}  // namespace celadon::sim
