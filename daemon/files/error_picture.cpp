#include "daemon/files/error_picture.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <vector>

namespace celadon {
namespace {

constexpr int kLeft = 74, kTop = 62, kWidth = 720, kHeight = 300, kGap = 34, kScale = 24, kRight = 150;
constexpr double kTickRoom = 16;  // px
constexpr int kSteps = 20;        // of colour on each side of zero
constexpr double kShown = 0.98;
constexpr const char* kNoSamples = "#d9d9d9";

// White at zero, blue below, red above; linear in between, as diverging maps are.
std::string colour_of(int step) {
  constexpr std::array<int, 3> kLow = {33, 102, 172}, kHigh = {178, 24, 43};
  const auto& end = step < 0 ? kLow : kHigh;
  const double share = std::abs(step) / static_cast<double>(kSteps);
  std::array<int, 3> mixed{};
  for (std::size_t k = 0; k < 3; ++k) mixed[k] = static_cast<int>(std::lround(247 + (end[k] - 247) * share));
  char text[8];
  std::snprintf(text, sizeof text, "#%02x%02x%02x", static_cast<unsigned>(mixed[0]) & 0xffu,
                static_cast<unsigned>(mixed[1]) & 0xffu, static_cast<unsigned>(mixed[2]) & 0xffu);
  return text;
}

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '&') {
      out += "&amp;";
    } else if (c == '<') {
      out += "&lt;";
    } else if (static_cast<unsigned char>(c) >= 0x20 || c == '\t') {
      out += c;
    }
  }
  return out;
}

template <class... Values>
std::string print(const char* format, Values... values) {
  char text[256];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

std::string label(double x, double y, const char* anchor, const std::string& text, int size = 13) {
  return print("<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\" font-size=\"%d\">", x, y, anchor, size) + escaped(text) +
         "</text>\n";
}

// 1, 2 or 5 times a power of ten, not below.
double round_up(double value) {
  const double power = std::pow(10, std::floor(std::log10(value)));
  for (const double factor : {1.0, 2.0, 5.0}) {
    if (value <= factor * power * (1 + 1e-12)) return factor * power;
  }
  return 10 * power;
}

// The end of the colour scale: all but a few fields lie within.
double limit_of(std::span<const PieceErrors> pieces) {
  std::vector<double> sizes;
  for (const PieceErrors& piece : pieces) {
    for (int i = 0; i < ErrorMap::kAlong; ++i) {
      for (int j = 0; j < ErrorMap::kAround; ++j) {
        if (const auto mean = piece.map.mean_mm(i, j)) sizes.push_back(std::abs(*mean));
      }
    }
  }
  if (sizes.empty()) return 1;
  const auto at = sizes.begin() + static_cast<std::ptrdiff_t>(kShown * static_cast<double>(sizes.size() - 1));
  std::nth_element(sizes.begin(), at, sizes.end());
  return round_up(std::max(*at, 1e-12));
}

std::string length(double mm) {
  return std::abs(mm) < 0.1 ? print("%.3g um", mm * 1e3) : print("%.3g mm", mm);
}

// Multiples of a step.
std::vector<double> ticks(double low, double high, double step) {
  std::vector<double> at;
  const int first = static_cast<int>(std::ceil(low / step - 1e-9)),
            last = static_cast<int>(std::floor(high / step + 1e-9));
  at.reserve(static_cast<std::size_t>(std::max(0, last - first + 1)));
  for (int k = first; k <= last; ++k) at.push_back(k * step);
  return at;
}

// One path a colour: small files, and one thing to take hold of in an editor.
std::string fields(const PieceErrors& piece, double limit, double top, double height) {
  constexpr int kNothing = kSteps + 1;
  const double field_height = height / ErrorMap::kAlong, field_width = static_cast<double>(kWidth) / ErrorMap::kAround;
  std::array<std::string, 2 * kSteps + 2> paths;
  for (int i = 0; i < ErrorMap::kAlong; ++i) {
    // Heights grow upward; on a sphere the coordinate along grows downward.
    const double y = piece.base.spherical() ? top + i * field_height : top + height - (i + 1) * field_height;
    for (int j = 0; j < ErrorMap::kAround;) {
      const auto step_of = [&](int column) {
        const auto mean = piece.map.mean_mm(i, column);
        return mean ? std::clamp(static_cast<int>(std::lround(*mean / limit * kSteps)), -kSteps, kSteps) : kNothing;
      };
      const int step = step_of(j);
      int end = j + 1;
      while (end < ErrorMap::kAround && step_of(end) == step) ++end;
      const double width = (end - j) * field_width;
      paths[static_cast<std::size_t>(step + kSteps)] +=
          print("M%g %.4gh%gv%.4gh-%gz", kLeft + j * field_width, y, width, field_height, width);
      j = end;
    }
  }
  std::string svg;
  for (int step = -kSteps; step <= kNothing; ++step) {
    const std::string& path = paths[static_cast<std::size_t>(step + kSteps)];
    if (path.empty()) continue;
    svg +=
        "<path fill=\"" + (step == kNothing ? std::string(kNoSamples) : colour_of(step)) + "\" d=\"" + path + "\"/>\n";
  }
  return svg;
}

std::string axes(const PieceErrors& piece, double top, double height) {
  constexpr double kDegrees = 180 / std::numbers::pi;
  const BaseSurface& base = piece.base;
  std::string svg = print("<rect x=\"%d\" y=\"%.1f\" width=\"%d\" height=\"%.1f\" fill=\"none\" stroke=\"#333\"/>\n",
                          kLeft, top, kWidth, height);
  // Rows are equal shares of w on a sphere: polar angles are placed by it.
  const auto& meridian = BaseSurface::meridian();
  const double low = base.spherical() ? meridian.theta_of_v(base.band_start) * kDegrees : base.band_start,
               high = base.spherical() ? meridian.theta_of_v(base.band_end) * kDegrees : base.band_end;
  const double most = std::clamp(std::floor(height / kTickRoom), 2.0, 9.0);  // labels do not run into each other
  for (const double t : ticks(low, high, round_up((high - low) / most))) {
    const double along = base.spherical() ? meridian.v_of_theta(std::min(t / kDegrees, std::numbers::pi)) : t;
    const double share = (along - base.band_start) / (base.band_end - base.band_start);
    const double y = base.spherical() ? top + share * height : top + (1 - share) * height;
    svg += print("<path d=\"M%d %.1fh-5\" stroke=\"#333\"/>\n", kLeft, y) +
           label(kLeft - 8, y + 4.5, "end", print("%g", t));
  }
  const double start = base.arcs.start_rad() * kDegrees, range = base.arcs.count() * base.arcs.arc_rad() * kDegrees;
  for (const double t : ticks(start, start + range, range > 180 ? 45 : round_up(range / 9))) {
    const double x = kLeft + (t - start) / range * kWidth;
    svg += print("<path d=\"M%.1f %.1fv5\" stroke=\"#333\"/>\n", x, top + height) +
           label(x, top + height + 18, "middle", print("%g", t), 12);
  }
  const std::string name = base.spherical() ? "polar angle, degrees"
                           : base.heights   ? "height, mm, rims drawn level"
                                            : "height, mm";
  svg += print("<g transform=\"translate(20 %.1f) rotate(-90)\">", top + height / 2) + label(0, 0, "middle", name) +
         "</g>\n";
  return svg;
}

std::string scale(double limit) {
  const double x = kLeft + kWidth + 24, step = static_cast<double>(kHeight) / (2 * kSteps + 1);
  std::string svg;
  for (int k = -kSteps; k <= kSteps; ++k) {
    svg += print("<rect x=\"%.1f\" y=\"%.2f\" width=\"%d\" height=\"%.2f\" fill=\"%s\"/>\n", x,
                 kTop + (kSteps - k) * step, kScale, step + 0.05, colour_of(k).c_str());
  }
  for (const double share : {-1.0, -0.5, 0.0, 0.5, 1.0}) {
    svg += label(x + kScale + 6, kTop + (1 - share) * kHeight / 2 + 4.5, "start",
                 print("%s%s", share > 0 ? "+" : "", length(share * limit).c_str()));
  }
  svg += print("<rect x=\"%.1f\" y=\"%d\" width=\"%d\" height=\"16\" fill=\"%s\"/>\n", x, kTop + kHeight + 16, kScale,
               kNoSamples) +
         label(x + kScale + 6, kTop + kHeight + 29, "start", "no samples", 12);
  return svg;
}

}  // namespace

std::string error_picture(std::span<const PieceErrors> pieces, const std::string& title, const std::string& caption) {
  const double limit = limit_of(pieces);
  const auto count = static_cast<double>(pieces.size());
  const double height = std::max(60.0, (kHeight - kGap * (count - 1)) / count);
  const double bottom = kTop + count * height + (count - 1) * kGap;
  const int width = kLeft + kWidth + kRight, total = static_cast<int>(std::max(bottom, kTop + kHeight + 20.0)) + 50;
  std::string svg = print(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"%d\" viewBox=\"0 0 %d %d\" "
      "font-family=\"sans-serif\" fill=\"#222\">\n",
      width, total, width, total);
  svg += print("<rect width=\"%d\" height=\"%d\" fill=\"white\"/>\n", width, total);
  svg += label(kLeft, 24, "start", title, 17) + label(kLeft, 46, "start", caption);
  for (std::size_t k = 0; k < pieces.size(); ++k) {
    const PieceErrors& piece = pieces[pieces.size() - 1 - k];  // the uppermost on top
    const double top = kTop + static_cast<double>(k) * (height + kGap);
    svg += "<g shape-rendering=\"crispEdges\">\n" + fields(piece, limit, top, height) + "</g>\n" +
           axes(piece, top, height);
  }
  svg += label(kLeft + kWidth / 2.0, bottom + 38, "middle", "angle, degrees") + scale(limit);
  return svg + "</svg>\n";
}

}  // namespace celadon
