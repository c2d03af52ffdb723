// Laser-line extraction against reading the frame, a JPEG decoder, and the order of operations of Horus in OpenCV.
// Everything on one core, from frames that lie in main memory, medians of interleaved runs.

#include <hwy/targets.h>
#include <turbojpeg.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "acquisition/laser_line.h"
#include "tests/acquisition/synthetic_line.h"
#include "tests/bench/frame_sum.h"

namespace {

using namespace celadon;
using Bytes = std::vector<std::uint8_t>;

constexpr int kWidth = 1280, kHeight = 1024;

/// Copies of one frame that together do not fit any cache; a run takes the next but some.
class Ring {
 public:
  explicit Ring(const Bytes& frame) : size_(frame.size()), count_((std::size_t{192} << 20) / frame.size()) {
    bytes_.resize(size_ * count_);
    for (std::size_t i = 0; i < count_; ++i) std::memcpy(&bytes_[i * size_], frame.data(), size_);
  }
  std::span<const std::uint8_t> next() {
    at_ = (at_ + 37) % count_;
    return {&bytes_[at_ * size_], size_};
  }

 private:
  std::size_t size_, count_, at_ = 0;
  Bytes bytes_;
};

/// Median seconds of each task, run in turn.
std::vector<double> medians(int rounds, const std::vector<std::function<void()>>& tasks) {
  std::vector<std::vector<double>> seconds(tasks.size());
  for (int round = 0; round < rounds; ++round) {
    for (std::size_t i = 0; i < tasks.size(); ++i) {
      const auto begin = std::chrono::steady_clock::now();
      tasks[i]();
      seconds[i].push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    }
  }
  std::vector<double> result;
  for (auto& s : seconds) {
    std::nth_element(s.begin(), s.begin() + static_cast<std::ptrdiff_t>(s.size() / 2), s.end());
    result.push_back(s[s.size() / 2]);
  }
  return result;
}

/// The peer: difference of colour images, red channel, threshold, blur, threshold, window about the row's maximum,
/// centre of gravity by row, Savitzky-Golay (quadratic over 9 rows), as Horus orders them.
void horus_order(const cv::Mat& on, const cv::Mat& off, std::vector<float>& x) {
  constexpr double kThreshold = 50;
  cv::Mat difference, red, blurred;
  cv::subtract(on, off, difference);
  cv::extractChannel(difference, red, 0);
  cv::threshold(red, red, kThreshold, 255, cv::THRESH_TOZERO);
  cv::blur(red, blurred, {5, 5});
  cv::threshold(blurred, red, kThreshold, 255, cv::THRESH_TOZERO);
  cv::Mat mask = cv::Mat::zeros(red.size(), CV_8U);
  for (int y = 0; y < red.rows; ++y) {
    cv::Point peak;
    cv::minMaxLoc(red.row(y), nullptr, nullptr, nullptr, &peak);
    mask.row(y).colRange(std::max(0, peak.x - 8), std::min(red.cols, peak.x + 9)).setTo(255);
  }
  cv::Mat windowed;
  red.copyTo(windowed, mask);
  cv::Mat values, sum, moment, weights(1, red.cols, CV_32F);
  for (int i = 0; i < red.cols; ++i) weights.at<float>(i) = static_cast<float>(i);
  windowed.convertTo(values, CV_32F);
  cv::reduce(values, sum, 1, cv::REDUCE_SUM);
  cv::gemm(values, weights, 1, cv::noArray(), 0, moment, cv::GEMM_2_T);
  x.assign(static_cast<std::size_t>(red.rows), -1.f);
  for (int y = 0; y < red.rows; ++y) {
    if (sum.at<float>(y) > 0) x[static_cast<std::size_t>(y)] = moment.at<float>(y) / sum.at<float>(y);
  }
  static const float taps[9] = {-21, 14, 39, 54, 59, 54, 39, 14, -21};
  const std::vector<float> raw = x;
  for (std::size_t y = 4; y + 4 < raw.size(); ++y) {
    float smooth = 0;
    bool whole = true;
    for (std::size_t k = 0; k < 9; ++k) {
      whole = whole && raw[y + k - 4] >= 0;
      smooth += taps[k] / 231 * raw[y + k - 4];
    }
    if (whole) x[y] = smooth;
  }
}

Bytes yuyv_red(const Bytes& grey) {
  Bytes yuyv(grey.size() * 2);
  for (std::size_t i = 0; i < grey.size(); i += 2) {
    const int red = (grey[i] + grey[i + 1]) / 2;
    yuyv[2 * i] = static_cast<std::uint8_t>(30 + 3 * grey[i] / 10);
    yuyv[2 * i + 2] = static_cast<std::uint8_t>(30 + 3 * grey[i + 1] / 10);
    yuyv[2 * i + 1] = 128;
    yuyv[2 * i + 3] = static_cast<std::uint8_t>(std::clamp(128 + (red - 30 - 3 * red / 10) * 10 / 14, 0, 255));
  }
  return yuyv;
}

Bytes grey_jpeg(const Bytes& grey) {
  tjhandle encoder = tjInitCompress();
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  if (encoder == nullptr || tjCompress2(encoder, grey.data(), kWidth, 0, kHeight, TJPF_GRAY, &bytes, &size, TJSAMP_GRAY,
                                        90, TJFLAG_FASTDCT) != 0) {
    std::fprintf(stderr, "line_bench: JPEG encoding failed: %s\n", tjGetErrorStr2(encoder));
    std::exit(4);
  }
  Bytes jpeg(bytes, bytes + size);
  tjFree(bytes);
  tjDestroy(encoder);
  return jpeg;
}

bool all_pass = true;

void line(const std::string& what, double seconds, double ratio, double bar, bool at_least = false) {
  const bool pass = at_least ? ratio >= bar : ratio <= bar;
  all_pass = all_pass && pass;
  std::printf("%-52s %8.3f ms %8.2f   %s %5.2f  %s\n", what.c_str(), seconds * 1e3, ratio, at_least ? ">=" : "<=", bar,
              pass ? "PASS" : "over");
}

}  // namespace

int main() {
  cv::setNumThreads(1);
  const auto picture = synthetic::scan_frame(kWidth, kHeight, synthetic::nominal_scene(), 3);
  const CameraMode grey_mode = synthetic::mode_of(kWidth, kHeight);
  const CameraMode yuyv_mode = synthetic::mode_of(kWidth, kHeight, PixelFormat::yuyv);
  Ring on(picture.on), off(picture.off), yuyv(yuyv_red(picture.on));
  std::vector<LineRow> rows(kHeight);
  LaserLineOptions options;
  LaserLineExtractor quasi_ml(options);
  options.refinement = LineRefinement::zero_crossing;
  LaserLineExtractor zero_crossing(options);
  options.channel = LineChannel::red;
  LaserLineExtractor red(options);
  volatile std::uint64_t sink = 0;
  const auto sum = [&](std::span<const std::uint8_t> bytes) {
    sink = sink + bench::sum_of_bytes(bytes.data(), bytes.size());
  };

  const Bytes jpeg = grey_jpeg(picture.on);
  tjhandle decoder = tjInitDecompress();
  Bytes decoded(picture.on.size());
  const auto decode = [&] {
    if (tjDecompress2(decoder, jpeg.data(), jpeg.size(), decoded.data(), kWidth, 0, kHeight, TJPF_GRAY, 0) != 0) {
      std::fprintf(stderr, "line_bench: JPEG decoding failed: %s\n", tjGetErrorStr2(decoder));
      std::exit(4);
    }
  };

  const auto colour = [](const Bytes& grey) {
    cv::Mat red_plane(kHeight, kWidth, CV_8U, const_cast<std::uint8_t*>(grey.data())), dark, merged;
    red_plane.convertTo(dark, -1, 0.15);
    cv::merge(std::vector<cv::Mat>{red_plane, dark, dark}, merged);
    return merged;
  };
  const cv::Mat on_colour = colour(picture.on), off_colour = colour(picture.off);
  std::vector<float> peer;

  const auto t = medians(101, {[&] { sum(on.next()); }, [&] { zero_crossing.extract(grey_mode, on.next(), {}, rows); },
                               [&] { quasi_ml.extract(grey_mode, on.next(), {}, rows); },
                               [&] {
                                 sum(on.next());
                                 sum(off.next());
                               },
                               [&] { zero_crossing.extract(grey_mode, on.next(), off.next(), rows); },
                               [&] { quasi_ml.extract(grey_mode, on.next(), off.next(), rows); },
                               [&] { sum(yuyv.next()); }, [&] { red.extract(yuyv_mode, yuyv.next(), {}, rows); }});
  const auto j = medians(31, {decode, [&] {
                                decode();
                                quasi_ml.extract(grey_mode, decoded, {}, rows);
                              }});
  const auto h = medians(15, {[&] { horus_order(on_colour, off_colour, peer); },
                              [&] { quasi_ml.extract(grey_mode, on.next(), off.next(), rows); }});
  tjDestroy(decoder);

  const std::string target = laser_line_simd_target();
  const double zero_crossing_bar = target.rfind("AVX3", 0) == 0 ? 1.15 : 1.5;
  std::printf("%dx%d, SIMD target %s\n%-52s %11s %8s\n", kWidth, kHeight, target.c_str(), "", "median", "ratio");
  std::printf("%-52s %8.3f ms %8.2f\n", "sum of a grey frame (the limit)", t[0] * 1e3, 1.0);
  line("grey, zero crossing / sum", t[1], t[1] / t[0], zero_crossing_bar);
  line("grey, quasi-maximum likelihood / sum", t[2], t[2] / t[0], 2);
  std::printf("%-52s %8.3f ms %8.2f\n", "sum of two grey frames (the limit)", t[3] * 1e3, 1.0);
  line("grey on - off, zero crossing / sum of both", t[4], t[4] / t[3], zero_crossing_bar);
  line("grey on - off, quasi-maximum likelihood / sum of both", t[5], t[5] / t[3], 2);
  std::printf("%-52s %8.3f ms %8.2f\n", "sum of a YUYV frame (the limit)", t[6] * 1e3, 1.0);
  line("YUYV red, zero crossing / sum", t[7], t[7] / t[6], 1.5);
  std::printf("%-52s %8.3f ms %8.2f\n", "JPEG decoded to grey (turbojpeg)", j[0] * 1e3, 1.0);
  line("the same and quasi-maximum likelihood / decoding", j[1], j[1] / j[0], 1.1);
  line("Horus's order in OpenCV / grey on - off, quasi-ML", h[0], h[0] / h[1], 35, true);
  return all_pass ? 0 : 1;
}
