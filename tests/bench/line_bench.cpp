// Laser-line extraction against reading the frame and the order of operations of Horus in OpenCV.
// Everything on one core, from frames that lie in main memory, medians of interleaved runs; then
// how well it does on scenes with known truth. `line_bench SSE4|AVX2|AVX3` on another SIMD target than the best.

#include <hwy/targets.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <memory>
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
constexpr double kColumnsBar = 3;  ///< the sum, as along rows, and as much again for turning the columns

/// Copies of one frame that together do not fit any cache, each at the start of a page as a driver's buffers are; a run
/// takes the next but some.
class Ring {
 public:
  explicit Ring(const Bytes& frame)
      : size_(frame.size()), step_((size_ + kPage - 1) / kPage * kPage), count_((std::size_t{192} << 20) / step_) {
    bytes_.reset(static_cast<std::uint8_t*>(std::aligned_alloc(kPage, step_ * count_)));
    for (std::size_t i = 0; i < count_; ++i) std::memcpy(&bytes_[i * step_], frame.data(), size_);
  }
  std::span<const std::uint8_t> next() {
    at_ = (at_ + 37) % count_;
    return {&bytes_[at_ * step_], size_};
  }

 private:
  static constexpr std::size_t kPage = 4096;
  struct Free {
    void operator()(std::uint8_t* bytes) const { std::free(bytes); }
  };
  std::size_t size_, step_, count_, at_ = 0;
  std::unique_ptr<std::uint8_t[], Free> bytes_;
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

bool all_pass = true;

void line(const std::string& what, double seconds, double ratio, double bar, bool at_least = false) {
  const bool pass = at_least ? ratio >= bar : ratio <= bar;
  all_pass = all_pass && pass;
  std::printf("%-52s %8.3f ms %8.2f   %s %5.2f  %s\n", what.c_str(), seconds * 1e3, ratio, at_least ? ">=" : "<=", bar,
              pass ? "PASS" : "over");
}

void accuracy(const char* what, const char* unit, double value, double bar) {
  const bool pass = value <= bar;
  all_pass = all_pass && pass;
  std::printf("%-52s %12s %8.4f   <= %5.2f  %s\n", what, unit, value, bar, pass ? "PASS" : "over");
}

/// Errors of the rows and of the smoothed line.
struct Scores {
  synthetic::Score rows, smoothed;
};

void score(const synthetic::Picture& picture, const synthetic::Scene& scene, Scores& scores, int minimum_contrast = 7) {
  LaserLineOptions options;
  options.minimum_contrast = minimum_contrast;
  options.read_noise = static_cast<float>(scene.read_noise);
  options.electrons_per_level = static_cast<float>(scene.electrons_per_level);
  options.speckle_contrast = static_cast<float>(scene.speckle_contrast);
  options.speckle_extent_px = static_cast<float>(synthetic::kSpeckleExtentPx);
  std::vector<LineRow> rows(static_cast<std::size_t>(picture.height));
  std::vector<float> smoothed(rows.size());
  LaserLineExtractor(options).extract(synthetic::mode_of(picture.width, picture.height), picture.on, {}, rows);
  smooth_line(rows, smoothed);
  for (std::size_t y = 0; y < rows.size(); ++y) {
    scores.rows.add(picture.truth, y, static_cast<double>(rows[y].x_px));
    scores.smoothed.add(picture.truth, y, static_cast<double>(smoothed[y]));
  }
}

void print_accuracy() {
  for (const double snr : {10.0, 14.0, 20.0}) {
    const synthetic::Scene scene{
        .amplitude = 1.5 * snr, .ambient_low = 25, .speckle_contrast = 0, .electrons_per_level = 1e9};
    Scores scores;
    for (unsigned seed = 1; seed <= 8; ++seed) {
      score(synthetic::straight_line(640, 600, 200 + 7.3 * seed, 0.137, 3, scene, seed), scene, scores, 4);
    }
    const double bound = 1 / snr * std::sqrt(2 * 3 / std::sqrt(3.14159265358979));
    accuracy(("additive noise, SNR " + std::to_string(static_cast<int>(snr)) + " / Cramer-Rao bound").c_str(), "",
             scores.rows.rms() / bound, 1.25);
  }
  Scores nominal;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    score(synthetic::scan_frame(kWidth, kHeight, synthetic::nominal_scene(), seed), synthetic::nominal_scene(),
          nominal);
  }
  accuracy("nominal scene, a row", "px RMS", nominal.rows.rms(), 0.26);
  accuracy("nominal scene, smoothed", "px RMS", nominal.smoothed.rms(), 0.15);
  accuracy("nominal scene, outliers", "%", nominal.rows.outlier_percent(), 0.05);
  accuracy("nominal scene, misses", "%", nominal.rows.miss_percent(), 0.1);
  const auto bias = [](double slope, double width, const synthetic::Light& reflectance) {
    const synthetic::Scene scene = synthetic::nominal_scene();
    Scores scores;
    for (unsigned seed = 1; seed <= 24; ++seed) {
      const double start = slope < 0 ? 450 : 60;
      score(synthetic::straight_line(512, 250, start + 0.83 * seed, slope, width, scene, seed, reflectance), scene,
            scores);
    }
    return std::abs(scores.rows.mean());
  };
  for (const double slope : {-1.5, -0.5, 0.0, 0.5, 1.5}) {
    accuracy(("bias at slope " + std::to_string(slope).substr(0, 4)).c_str(), "px", bias(slope, 2, nullptr), 0.02);
  }
  for (const double width : {1.2, 3.0, 5.0}) {
    accuracy(("bias at width " + std::to_string(width).substr(0, 3)).c_str(), "px", bias(0, width, nullptr), 0.02);
  }
  for (const double contrast : {1.5, 3.0}) {
    const auto edge = [&](int x, int) { return x < 100 ? 1.0 : 1 / contrast; };  // four widths beyond the line at least
    accuracy(("bias beside an edge of reflectance " + std::to_string(contrast).substr(0, 3) + " : 1").c_str(), "px",
             bias(0, 3, edge), 0.02);
  }
}

/// All that follows runs on the named target of Highway's.
bool choose_target(const std::string& name) {
  for (std::int64_t rest = hwy::SupportedTargets(); rest != 0; rest &= rest - 1) {
    hwy::SetSupportedTargetsForTest(rest & -rest);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    if (name == laser_line_simd_target()) return true;
  }
  return false;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc > 1 && !choose_target(argv[1])) {
    std::fprintf(stderr, "line_bench: this processor or program has no SIMD target '%s'; SSE4, AVX2 or AVX3\n",
                 argv[1]);
    return 2;
  }
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
  options = {};
  options.along = LineAlong::columns;
  LaserLineExtractor columns(options);
  volatile std::uint64_t sink = 0;
  const auto sum = [&](std::span<const std::uint8_t> bytes) {
    sink = sink + bench::sum_of_bytes(bytes.data(), bytes.size());
  };

  const auto colour = [](const Bytes& grey) {
    cv::Mat red_plane(kHeight, kWidth, CV_8U, const_cast<std::uint8_t*>(grey.data())), dark, merged;
    red_plane.convertTo(dark, -1, 0.15);
    cv::merge(std::vector<cv::Mat>{red_plane, dark, dark}, merged);
    return merged;
  };
  const cv::Mat on_colour = colour(picture.on), off_colour = colour(picture.off);
  std::vector<float> peer;

  // The same light with the camera on its side: as many bytes, the line along the columns.
  const CameraMode lying_mode = synthetic::mode_of(kHeight, kWidth);
  const auto lying = [](const Bytes& grey) {
    cv::Mat upright(kHeight, kWidth, CV_8U, const_cast<std::uint8_t*>(grey.data())), transposed;
    cv::transpose(upright, transposed);
    return Bytes(transposed.data, transposed.data + grey.size());
  };
  Ring lying_on(lying(picture.on)), lying_off(lying(picture.off));
  cv::Mat copy;
  std::vector<LineRow> of_copy(kHeight);
  const auto by_a_copy = [&](std::span<const std::uint8_t> frame) {
    cv::transpose(cv::Mat(kWidth, kHeight, CV_8U, const_cast<std::uint8_t*>(frame.data())), copy);
    quasi_ml.extract(grey_mode, {copy.data, frame.size()}, {}, of_copy);
  };

  const auto t = medians(101, {[&] { sum(on.next()); }, [&] { zero_crossing.extract(grey_mode, on.next(), {}, rows); },
                               [&] { quasi_ml.extract(grey_mode, on.next(), {}, rows); },
                               [&] {
                                 sum(on.next());
                                 sum(off.next());
                               },
                               [&] { zero_crossing.extract(grey_mode, on.next(), off.next(), rows); },
                               [&] { quasi_ml.extract(grey_mode, on.next(), off.next(), rows); },
                               [&] { sum(yuyv.next()); }, [&] { red.extract(yuyv_mode, yuyv.next(), {}, rows); },
                               [&] { columns.extract(lying_mode, lying_on.next(), {}, rows); },
                               [&] { columns.extract(lying_mode, lying_on.next(), lying_off.next(), rows); },
                               [&] { by_a_copy(lying_on.next()); }});
  const auto h = medians(15, {[&] { horus_order(on_colour, off_colour, peer); },
                              [&] { quasi_ml.extract(grey_mode, on.next(), off.next(), rows); }});

  const auto c =
      medians(101, {[&] { sum(picture.on); }, [&] { zero_crossing.extract(grey_mode, picture.on, {}, rows); },
                    [&] { quasi_ml.extract(grey_mode, picture.on, {}, rows); }});

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
  line("grey along columns, quasi-ML / sum", t[8], t[8] / t[0], kColumnsBar);
  line("on - off along columns, quasi-ML / sum of both", t[9], t[9] / t[3], kColumnsBar);
  std::printf("%-52s %8.3f ms %8.2f\n", "grey transposed by OpenCV, then rows / sum", t[10] * 1e3, t[10] / t[0]);
  std::printf("%-52s %8.3f ms %8.3f ms %8.3f ms\n", "grey from cache: sum, zero crossing, quasi-ML", c[0] * 1e3,
              c[1] * 1e3, c[2] * 1e3);
  line("Horus's order in OpenCV / grey on - off, quasi-ML", h[0], h[0] / h[1], 35, true);
  print_accuracy();
  return all_pass ? 0 : 1;
}
