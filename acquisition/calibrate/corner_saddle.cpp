#include "acquisition/calibrate/corner_saddle.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace celadon {
namespace {

using Eigen::Vector2d;

constexpr int kUnknowns = 9;  // p (2), angles of the normals (2), s, b, c, g (2)
using Unknowns = Eigen::Matrix<double, kUnknowns, 1>;
using Normal = Eigen::Matrix<double, kUnknowns, kUnknowns>;

constexpr int kMostSteps = 25;
constexpr double kSettled_px = 1e-5, kLeastBlur_px = 0.3, kWidestBlur_px = 4;
constexpr double kLeastHalfContrast = 4;  // half the contrast: levels

struct SaddlePixel {
  double x, y, level;
};

// The model at (x, y) and its derivatives.
double saddle_model(const Unknowns& u, double x, double y, Unknowns& gradient) {
  const double dx = x - u[0], dy = y - u[1];
  const double c1 = std::cos(u[2]), s1 = std::sin(u[2]), c2 = std::cos(u[3]), s2 = std::sin(u[3]);
  const double scale = 1 / (std::numbers::sqrt2 * u[4]);
  const double a = (c1 * dx + s1 * dy) * scale, b = (c2 * dx + s2 * dy) * scale;
  const double ea = std::erf(a), eb = std::erf(b);
  const double slope = 2 / std::sqrt(std::numbers::pi);
  const double da = u[6] * slope * std::exp(-a * a) * eb, db = u[6] * slope * std::exp(-b * b) * ea;
  gradient << -(da * c1 + db * c2) * scale - u[7], -(da * s1 + db * s2) * scale - u[8],
      da * (c1 * dy - s1 * dx) * scale, db * (c2 * dy - s2 * dx) * scale, -(da * a + db * b) / u[4], 1, ea * eb, dx, dy;
  return u[5] + u[6] * ea * eb + u[7] * dx + u[8] * dy;
}

std::vector<SaddlePixel> disc(const GreyView& picture, const Vector2d& p, double radius) {
  std::vector<SaddlePixel> pixels;
  const int x0 = static_cast<int>(std::ceil(p.x() - radius)), x1 = static_cast<int>(std::floor(p.x() + radius));
  const int y0 = static_cast<int>(std::ceil(p.y() - radius)), y1 = static_cast<int>(std::floor(p.y() + radius));
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      if (std::hypot(x - p.x(), y - p.y()) <= radius) {
        pixels.push_back({static_cast<double>(x), static_cast<double>(y), picture.at(x, y)});
      }
    }
  }
  return pixels;
}

// Levenberg and Marquardt's steps from u. Returns the sum of squares, or nothing if it does not settle.
std::optional<double> settle(const std::vector<SaddlePixel>& pixels, Unknowns& u) {
  const auto sums = [&](const Unknowns& at, Normal* normal, Unknowns* right) {
    double squares = 0;
    Unknowns gradient;
    for (const SaddlePixel& pixel : pixels) {
      const double residual = pixel.level - saddle_model(at, pixel.x, pixel.y, gradient);
      squares += residual * residual;
      if (normal == nullptr) continue;
      normal->noalias() += gradient * gradient.transpose();
      right->noalias() += gradient * residual;
    }
    return squares;
  };
  double damping = 1e-3, squares = sums(u, nullptr, nullptr);
  for (int step = 0; step < kMostSteps; ++step) {
    Normal normal = Normal::Zero();
    Unknowns right = Unknowns::Zero();
    sums(u, &normal, &right);
    bool better = false;
    double moved = 0;
    for (int attempt = 0; attempt < 6 && !better; ++attempt) {
      Normal damped = normal;
      damped.diagonal() *= 1 + damping;
      const Unknowns by = damped.ldlt().solve(right);
      if (!by.allFinite()) return std::nullopt;
      Unknowns next = u + by;
      next[4] = std::clamp(next[4], kLeastBlur_px, 2 * kWidestBlur_px);
      const double after = sums(next, nullptr, nullptr);
      better = after <= squares;
      if (!better) {
        damping *= 10;
        continue;
      }
      damping = std::max(1e-9, damping * 0.1);
      moved = (next - u).head<2>().norm();
      u = next;
      squares = after;
    }
    if (!better || moved < kSettled_px) return squares;
  }
  return std::nullopt;
}

}  // namespace

std::optional<Saddle> fit_saddle(const GreyView& picture, const PictureNoise& noise, const SaddleGuess& guess) {
  Vector2d centre = guess.p_px;
  Unknowns u;
  // Pixels are those about the guess first, then those about what was found.
  for (int round = 0; round < 2; ++round) {
    if (!picture.holds(centre, guess.radius_px + 1)) return std::nullopt;
    const std::vector<SaddlePixel> pixels = disc(picture, centre, guess.radius_px);
    if (pixels.size() < 3 * kUnknowns) return std::nullopt;
    if (round == 0) {
      double mean = 0, contrast = 0;
      const Vector2d n1(-guess.along_row.y(), guess.along_row.x()), n2(guess.along_column.y(), -guess.along_column.x());
      for (const SaddlePixel& pixel : pixels) mean += pixel.level / static_cast<double>(pixels.size());
      for (const SaddlePixel& pixel : pixels) {
        const Vector2d d = Vector2d(pixel.x, pixel.y) - centre;
        contrast += (n1.dot(d) > 0) == (n2.dot(d) > 0) ? pixel.level - mean : mean - pixel.level;
      }
      u << centre, std::atan2(n1.y(), n1.x()), std::atan2(n2.y(), n2.x()), 1.2, mean,
          contrast / static_cast<double>(pixels.size()), 0, 0;
    }
    const auto squares = settle(pixels, u);
    if (!squares || (u.head<2>() - guess.p_px).norm() > guess.radius_px) return std::nullopt;
    centre = u.head<2>();
    if (round == 0) continue;
    const double rms = std::sqrt(*squares / static_cast<double>(pixels.size()));
    if (u[4] > kWidestBlur_px || std::abs(u[6]) < std::max(kLeastHalfContrast, 4 * rms)) return std::nullopt;
    Normal normal = Normal::Zero(), spread = Normal::Zero();
    Unknowns gradient;
    for (const SaddlePixel& pixel : pixels) {
      const double level = saddle_model(u, pixel.x, pixel.y, gradient);
      const double sigma = noise.sigma(level);
      normal.noalias() += gradient * gradient.transpose();
      spread.noalias() += sigma * sigma * gradient * gradient.transpose();
    }
    const Normal inverse = normal.ldlt().solve(Normal::Identity());
    const Normal covariance = inverse * spread * inverse;
    const double variance = 0.5 * (covariance(0, 0) + covariance(1, 1));
    if (!(variance > 0)) return std::nullopt;
    return Saddle{centre, std::sqrt(variance), u[4], u[6], rms};
  }
  return std::nullopt;
}

}  // namespace celadon
