// Grey pictures from other formats, against what the formats are defined to mean.
#include "acquisition/picture_decoder.h"

#include <gtest/gtest.h>
#include <linux/videodev2.h>
#include <turbojpeg.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace celadon {
namespace {

using Bytes = std::vector<std::uint8_t>;

Bytes random_bytes(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  Bytes bytes(count);
  for (std::uint8_t& b : bytes) b = static_cast<std::uint8_t>(random());
  return bytes;
}

TEST(PictureDecoder, TakesNoFormatThatIsReadInPlace) {
  for (const std::uint32_t fourcc : {V4L2_PIX_FMT_GREY, V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_NV12, V4L2_PIX_FMT_H264}) {
    EXPECT_EQ(PictureDecoder::of(fourcc, 64, 8, 64), nullptr);
  }
}

TEST(PictureDecoder, LumaOfUyvyIsEverySecondByte) {
  constexpr std::size_t kStride = 150;
  const Bytes in = random_bytes(kStride * 9, 1);
  const auto decoder = PictureDecoder::of(V4L2_PIX_FMT_UYVY, 66, 9, kStride);
  EXPECT_EQ(decoder->least_bytes(), kStride * 8 + 132);
  Bytes grey(66 * 9);
  ASSERT_TRUE(decoder->decode(std::span(in).first(decoder->least_bytes()), grey));
  for (std::size_t y = 0; y < 9; ++y) {
    for (std::size_t x = 0; x < 66; ++x) EXPECT_EQ(grey[y * 66 + x], in[y * kStride + 2 * x + 1]);
  }
}

// A driver that tells no stride has rows without padding.
TEST(PictureDecoder, NoStrideMeansRowsWithoutPadding) {
  for (const std::uint32_t fourcc : {V4L2_PIX_FMT_UYVY, V4L2_PIX_FMT_Y12, V4L2_PIX_FMT_SRGGB8}) {
    const std::size_t row_bytes = fourcc == V4L2_PIX_FMT_SRGGB8 ? 66 : 132;
    const Bytes in = random_bytes(9 * row_bytes, 7);
    Bytes told(66 * 9), untold(66 * 9);
    const auto decoder = PictureDecoder::of(fourcc, 66, 9, 0);
    EXPECT_EQ(decoder->least_bytes(), 9 * row_bytes);
    ASSERT_TRUE(decoder->decode(in, untold));
    ASSERT_TRUE(PictureDecoder::of(fourcc, 66, 9, row_bytes)->decode(in, told));
    EXPECT_EQ(untold, told);
  }
}

TEST(PictureDecoder, DeepSamplesAreRoundedToEightBits) {
  for (const auto& [fourcc, bits] : {std::pair{V4L2_PIX_FMT_Y10, 10}, {V4L2_PIX_FMT_Y12, 12}, {V4L2_PIX_FMT_Y16, 16}}) {
    const int most = (1 << bits) - 1;
    Bytes in;
    std::vector<double> wanted;
    std::mt19937 random(3);
    for (int i = 0; i < 64 * 4; ++i) {
      const int sample = i == 0 ? 0 : i == 1 ? most : std::uniform_int_distribution(0, most)(random);
      in.push_back(static_cast<std::uint8_t>(sample & 0xff));
      in.push_back(static_cast<std::uint8_t>(sample >> 8));
      wanted.push_back(std::min(255.0, sample / std::pow(2, bits - 8)));
    }
    Bytes grey(64 * 4);
    ASSERT_TRUE(PictureDecoder::of(static_cast<std::uint32_t>(fourcc), 64, 4, 128)->decode(in, grey));
    for (std::size_t i = 0; i < grey.size(); ++i) EXPECT_NEAR(grey[i], wanted[i], 0.5) << bits << " bits";
  }
}

/// Colour (0 red, 1 green, 2 blue) of a pixel of the mosaic whose first two rows begin so.
int colour_at(const char* mosaic, std::size_t x, std::size_t y) {
  const char c = mosaic[2 * (y % 2) + x % 2];
  return c == 'R' ? 0 : c == 'G' ? 1 : 2;
}

constexpr std::pair<std::uint32_t, const char*> kMosaics[] = {{V4L2_PIX_FMT_SBGGR8, "BGGR"},
                                                              {V4L2_PIX_FMT_SGBRG8, "GBRG"},
                                                              {V4L2_PIX_FMT_SGRBG8, "GRBG"},
                                                              {V4L2_PIX_FMT_SRGGB8, "RGGB"}};

TEST(PictureDecoder, AMosaicOfOneColourBecomesOneGrey) {
  for (const auto& [fourcc, mosaic] : kMosaics) {
    const int colour[] = {200, 40, 90};
    Bytes in(66 * 10), grey(66 * 10);
    for (std::size_t y = 0; y < 10; ++y) {
      for (std::size_t x = 0; x < 66; ++x) in[y * 66 + x] = static_cast<std::uint8_t>(colour[colour_at(mosaic, x, y)]);
    }
    ASSERT_TRUE(PictureDecoder::of(fourcc, 66, 10, 66)->decode(in, grey));
    for (const std::uint8_t g : grey) EXPECT_NEAR(g, (200 + 2 * 40 + 90) / 4., 0.51) << mosaic;
  }
}

// A red line on a mosaic, at any phase: its centroid must stay where it is.
TEST(PictureDecoder, AMosaicDoesNotShiftALine) {
  for (const auto& [fourcc, mosaic] : kMosaics) {
    for (double x0 = 30; x0 < 32; x0 += 0.23) {
      Bytes in(66 * 10), grey(66 * 10);
      for (std::size_t y = 0; y < 10; ++y) {
        for (std::size_t x = 0; x < 66; ++x) {
          const double off = (static_cast<double>(x) - x0) / 2.2, line = std::exp(-off * off / 2);
          const double share[] = {1, 0.3, 0.1};
          in[y * 66 + x] = static_cast<std::uint8_t>(std::lround(240 * line * share[colour_at(mosaic, x, y)]));
        }
      }
      ASSERT_TRUE(PictureDecoder::of(fourcc, 66, 10, 66)->decode(in, grey));
      for (std::size_t y = 0; y < 10; ++y) {
        double sum = 0, moment = 0;
        for (std::size_t x = 20; x < 43; ++x) {  // far from the line there is rounding only
          sum += grey[y * 66 + x];
          moment += grey[y * 66 + x] * static_cast<double>(x);
        }
        EXPECT_NEAR(moment / sum, x0, 0.015) << mosaic << ", row " << y;
      }
    }
  }
}

/// A colour picture with a bright line, as a camera compresses it, and its luma.
Bytes jpeg_of(int width, int height, Bytes& luma) {
  Bytes rgb;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const double off = (x - 0.4 * width - 0.05 * y) / 2;
      const int line = static_cast<int>(std::lround(180 * std::exp(-off * off / 2)));
      const int r = 30 + line, g = 40 + x % 7 + line / 4, b = 50 + line / 8;
      for (const int c : {r, g, b}) rgb.push_back(static_cast<std::uint8_t>(c));
      luma.push_back(static_cast<std::uint8_t>(std::lround(0.299 * r + 0.587 * g + 0.114 * b)));
    }
  }
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  const tjhandle jpeg = tjInitCompress();
  EXPECT_EQ(tjCompress2(jpeg, rgb.data(), width, 0, height, TJPF_RGB, &bytes, &size, TJSAMP_422, 97, 0), 0);
  Bytes out(bytes, bytes + size);
  tjFree(bytes);
  tjDestroy(jpeg);
  return out;
}

TEST(PictureDecoder, LumaOfAJpegIsThatOfThePictureThatWasCompressed) {
  Bytes luma;
  const Bytes jpeg = jpeg_of(320, 200, luma);
  const auto decoder = PictureDecoder::of(V4L2_PIX_FMT_MJPEG, 320, 200, 0);
  Bytes grey(luma.size());
  Bytes padded = jpeg;
  padded.resize(jpeg.size() + 1000);  // drivers deliver the whole buffer now and then
  for (const Bytes& in : {jpeg, padded}) {
    std::fill(grey.begin(), grey.end(), std::uint8_t{0});
    ASSERT_TRUE(decoder->decode(in, grey));
    double squares = 0;
    for (std::size_t i = 0; i < grey.size(); ++i) squares += std::pow(grey[i] - luma[i], 2);
    EXPECT_LT(std::sqrt(squares / static_cast<double>(grey.size())), 1.5);
  }
}

// Many cameras send some bytes too many at the end of a picture; nothing of it is missing.
TEST(PictureDecoder, BytesTooManyBeforeTheEndOfAJpegDoNoHarm) {
  Bytes luma;
  Bytes jpeg = jpeg_of(320, 200, luma);
  Bytes whole(luma.size()), grey(luma.size());
  ASSERT_TRUE(PictureDecoder::of(V4L2_PIX_FMT_MJPEG, 320, 200, 0)->decode(jpeg, whole));
  ASSERT_EQ(jpeg[jpeg.size() - 2], 0xff);  // the marker of its end
  jpeg.insert(jpeg.end() - 2, {0x12, 0x34, 0x56, 0x78, 0x12, 0x34, 0x56, 0x78});
  const auto decoded = PictureDecoder::of(V4L2_PIX_FMT_MJPEG, 320, 200, 0)->decode(jpeg, grey);
  ASSERT_TRUE(decoded) << decoded.error();
  EXPECT_EQ(grey, whole);
}

TEST(PictureDecoder, ChromaOfUyvyStaysInItsPairs) {
  constexpr std::size_t kStride = 150;
  const Bytes in = random_bytes(kStride * 9, 11);
  const auto decoder = PictureDecoder::of(V4L2_PIX_FMT_UYVY, 66, 9, kStride);
  EXPECT_EQ(decoder->colour_layout(), ColourLayout::uv_pairs);
  Bytes grey(66 * 9), colour(66 * 9), alone(66 * 9);
  EXPECT_EQ(decoder->decode(in, grey, colour), true);
  EXPECT_EQ(decoder->decode(in, alone), false) << "not wanted";
  EXPECT_EQ(grey, alone);
  for (std::size_t y = 0; y < 9; ++y) {
    for (std::size_t x = 0; x < 66; ++x) EXPECT_EQ(colour[y * 66 + x], in[y * kStride + 2 * x]);
  }
}

TEST(PictureDecoder, AMosaicStaysBesideItsGrey) {
  for (const auto& [fourcc, mosaic] : kMosaics) {
    const Bytes in = random_bytes(70 * 10, 12);
    const auto decoder = PictureDecoder::of(fourcc, 66, 10, 70);
    Bytes grey(66 * 10), colour(66 * 10);
    EXPECT_EQ(decoder->decode(in, grey, colour), true);
    for (std::size_t y = 0; y < 10; ++y) {
      for (std::size_t x = 0; x < 66; ++x) EXPECT_EQ(colour[y * 66 + x], in[y * 70 + x]);
    }
    EXPECT_TRUE(is_mosaic(decoder->colour_layout())) << mosaic;
  }
}

// Wide fields of colour in every subsampling, against the colours that turbojpeg makes of the same bytes; the luma is
// the one without colours, to the last bit.
TEST(PictureDecoder, ColoursOfAJpegAreThoseThatOthersDecode) {
  constexpr int kWide = 96, kHigh = 64;
  Bytes rgb;
  for (int y = 0; y < kHigh; ++y) {
    for (int x = 0; x < kWide; ++x) {
      const int field = 3 * (y / 32) + x / 32;
      for (const int c : {40 + 30 * field, 200 - 25 * field, field % 2 == 0 ? 60 : 170})
        rgb.push_back(static_cast<std::uint8_t>(c));
    }
  }
  for (const int subsampling : {TJSAMP_444, TJSAMP_422, TJSAMP_420, TJSAMP_440, TJSAMP_411, TJSAMP_GRAY}) {
    unsigned char* bytes = nullptr;
    unsigned long size = 0;
    const tjhandle coder = tjInitCompress(), other = tjInitDecompress();
    ASSERT_EQ(tjCompress2(coder, rgb.data(), kWide, 0, kHigh, TJPF_RGB, &bytes, &size, subsampling, 95, 0), 0);
    const std::span<const std::uint8_t> in(bytes, size);
    const auto decoder = PictureDecoder::of(V4L2_PIX_FMT_MJPEG, kWide, kHigh, 0);
    Bytes grey(kWide * kHigh), alone(kWide * kHigh), colour(kWide * kHigh), truth(3 * kWide * kHigh);
    const auto decoded = decoder->decode(in, grey, colour);
    ASSERT_TRUE(decoded) << decoded.error();
    EXPECT_EQ(*decoded, subsampling != TJSAMP_GRAY);
    ASSERT_TRUE(decoder->decode(in, alone));
    EXPECT_EQ(grey, alone) << subsampling;
    ASSERT_EQ(tjDecompress2(other, bytes, size, truth.data(), kWide, 0, kHigh, TJPF_RGB, 0), 0);
    tjFree(bytes);
    tjDestroy(coder);
    tjDestroy(other);
    if (!*decoded) continue;
    for (std::size_t y = 8; y < kHigh; y += 16) {
      for (std::size_t x = 8; x < kWide; x += 16) {  // off the edges of fields
        const std::size_t at = y * kWide + x;
        const LinearColour c = colour_of({}, grey[at], colour[at], colour[at + 1]);
        EXPECT_NEAR(c.red, truth[3 * at], 2.5) << subsampling << ", " << x << ", " << y;
        EXPECT_NEAR(c.green, truth[3 * at + 1], 2.5);
        EXPECT_NEAR(c.blue, truth[3 * at + 2], 2.5);
      }
    }
  }
}

TEST(PictureDecoder, SaysWhatIsWrongWithAJpeg) {
  Bytes luma;
  const Bytes jpeg = jpeg_of(320, 200, luma);
  Bytes grey(320 * 200), colour(320 * 200);
  const auto told = [&](const Bytes& in) {
    const auto decoded = PictureDecoder::of(V4L2_PIX_FMT_MJPEG, 320, 200, 0)->decode(in, grey, colour);
    return decoded ? std::string("good") : decoded.error();
  };
  EXPECT_NE(told(Bytes(jpeg.begin(), jpeg.begin() + static_cast<std::ptrdiff_t>(jpeg.size() / 2))).find("damaged"),
            std::string::npos);
  EXPECT_NE(told(random_bytes(5000, 5)).find("no JPEG"), std::string::npos);
  EXPECT_NE(told({}).find("no JPEG"), std::string::npos);
  Bytes other_luma;
  EXPECT_NE(told(jpeg_of(64, 48, other_luma)).find("64 x 48"), std::string::npos);
  // Whatever the bytes, the picture's memory is not left.
  for (unsigned seed = 0; seed < 300; ++seed) {
    Bytes damaged = jpeg;
    const Bytes noise = random_bytes(40, seed);
    for (std::size_t i = 0; i < 20; ++i) damaged[(noise[2 * i] * 256u + noise[2 * i + 1]) % damaged.size()] ^= noise[i];
    static_cast<void>(told(damaged));
  }
}

}  // namespace
}  // namespace celadon
