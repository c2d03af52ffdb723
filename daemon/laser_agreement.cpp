#include "daemon/laser_agreement.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

#include <Eigen/Dense>

#include "daemon/checks/error_harmonics.h"
#include "daemon/checks/spread.h"

namespace celadon {
namespace {

constexpr double kWholeTurn_rad = 2 * std::numbers::pi;
constexpr int kProfilesPerCell = 4, kFewestAround = 8, kMostAround = 180, kAlong = 64;
constexpr double kFewestOfEach = 8;    // of each laser in a cell
constexpr double kLeastSpread = 0.01;  // variance in widths of a cell, of which even samples have 1/12
constexpr std::size_t kFewestCells = 16;
constexpr double kMostScatter = 3;  // of the samples in a cell, times the median cell's: steps, edges, steep walls
constexpr double kMostOfSurface_mm = 0.5;  // what gloss makes of two lasers is less

}  // namespace

LaserAgreement::LaserAgreement(const GridSpecification& band, std::span<const int> lasers, int profiles)
    : z_start_mm_(band.z_start_mm),
      z_end_mm_(band.z_end_mm),
      around_(std::clamp(profiles / kProfilesPerCell, kFewestAround, kMostAround)),
      along_(kAlong) {
  if (lasers.size() < 2) return;
  for (const int laser : lasers) cells_[laser].resize(static_cast<std::size_t>(around_) * kAlong);
}

void LaserAgreement::add(const Profile& profile, int way) {
  const auto of_laser = cells_.find(way);
  if (of_laser == cells_.end()) return;
  for (std::size_t i = 0; i < profile.size(); ++i) {
    const double turned = profile.theta_rad[i] / kWholeTurn_rad;
    const double around = (turned - std::floor(turned)) * around_;
    const double along = (profile.z_mm[i] - z_start_mm_) / (z_end_mm_ - z_start_mm_) * along_;
    if (!(along >= 0 && along < along_) || !std::isfinite(around)) continue;
    const int column = std::min(static_cast<int>(around), around_ - 1), row = static_cast<int>(along);
    Cell& c = of_laser->second[static_cast<std::size_t>(column) * kAlong + static_cast<std::size_t>(row)];
    const double a = around - column - 0.5, h = along - row - 0.5, r = profile.r_mm[i];
    c.n += 1;
    c.a += a, c.h += h, c.r += r;
    c.aa += a * a, c.ah += a * h, c.hh += h * h;
    c.ar += a * r, c.hr += h * r, c.rr += r * r;
  }
}

std::optional<LaserAgreement::Difference> LaserAgreement::difference(const std::vector<Cell>& first,
                                                                     const std::vector<Cell>& second,
                                                                     std::size_t cell) const {
  Eigen::Matrix2d within = Eigen::Matrix2d::Zero();  // sums of squares about each laser's own mean
  Eigen::Vector2d with_r = Eigen::Vector2d::Zero();
  double square_r = 0, inverse_n = 0;
  for (const Cell& c : {first[cell], second[cell]}) {
    if (c.n < kFewestOfEach) return std::nullopt;
    const double aa = c.aa - c.a * c.a / c.n, ah = c.ah - c.a * c.h / c.n, hh = c.hh - c.h * c.h / c.n;
    if (aa < kLeastSpread * c.n || hh < kLeastSpread * c.n) return std::nullopt;
    within += (Eigen::Matrix2d() << aa, ah, ah, hh).finished();
    with_r += Eigen::Vector2d(c.ar - c.a * c.r / c.n, c.hr - c.h * c.r / c.n);
    square_r += c.rr - c.r * c.r / c.n;
    inverse_n += 1 / c.n;
  }
  if (within.determinant() < kLeastSpread * within(0, 0) * within(1, 1)) return std::nullopt;
  const Cell &p = first[cell], &q = second[cell];
  const Eigen::Matrix2d inverse = within.inverse();
  const Eigen::Vector2d slope = inverse * with_r;
  const Eigen::Vector2d apart(q.a / q.n - p.a / p.n, q.h / q.n - p.h / p.n);
  Difference d;
  d.mm = q.r / q.n - p.r / p.n - slope.dot(apart);
  d.scatter_mm2 = std::max(square_r - slope.dot(with_r), 0.) / (p.n + q.n - 4);
  d.variance_mm2 = d.scatter_mm2 * (inverse_n + apart.dot(inverse * apart));
  const std::size_t around = cell / kAlong, along = cell % kAlong;
  d.theta_rad = (static_cast<double>(around) + 0.5) / around_ * kWholeTurn_rad;
  d.height = (static_cast<double>(along) + 0.5) / along_ * 2 - 1;
  return d;
}

std::optional<AgreementError> LaserAgreement::compare(int first, int second) const {
  std::vector<Difference> seen;
  const std::vector<Cell>&p = cells_.at(first), &q = cells_.at(second);
  for (std::size_t cell = 0; cell < p.size(); ++cell) {
    if (const auto d = difference(p, q, cell)) seen.push_back(*d);
  }
  if (seen.size() < kFewestCells) return std::nullopt;
  // Where the surface is no plane within a cell, the samples say little of the lasers.
  const auto middle = seen.begin() + static_cast<std::ptrdiff_t>(seen.size() / 2);
  std::nth_element(seen.begin(), middle, seen.end(),
                   [](const Difference& a, const Difference& b) { return a.scatter_mm2 < b.scatter_mm2; });
  const double most = kMostScatter * kMostScatter * middle->scatter_mm2;
  std::erase_if(seen, [&](const Difference& d) { return d.scatter_mm2 > most; });

  AgreementError error;
  error.first = first;
  error.second = second;
  error.cells = seen.size();
  const auto n = static_cast<double>(seen.size());
  double sum = 0, squares = 0, variances = 0;
  // What it looks like over the object: the same everywhere, a shift of the object, a tilt along the axis.
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  Eigen::Vector4d right = Eigen::Vector4d::Zero();
  for (const Difference& d : seen) {
    sum += d.mm;
    squares += d.mm * d.mm;
    variances += d.variance_mm2;
    const Eigen::Vector4d shape(1, std::cos(d.theta_rad), std::sin(d.theta_rad), d.height);
    normal += shape * shape.transpose();
    right += shape * d.mm;
  }
  error.bias = sum / n;
  error.rms = std::sqrt(squares / n);
  // From the scatter of the cells themselves, which has what is common to the samples of one in it.
  error.bias_sd = std::sqrt(std::max(squares / n - error.bias * error.bias, variances / n) / n);
  error.noise = std::sqrt(variances / n);
  const Eigen::Vector4d fitted = normal.completeOrthogonalDecomposition().solve(right);
  error.shift = std::hypot(fitted(1), fitted(2));
  error.tilt = fitted(3);
  add_around(seen, error);
  return error;
}

// Cells of a field scatter by their noise and by what is the surface's: either way that is what its mean is worth.
void LaserAgreement::add_around(const std::vector<Difference>& seen, AgreementError& error) const {
  constexpr double kFewestOfField = 4;
  struct Field {
    double n = 0, sum = 0, square = 0;
  };
  std::vector<Field> fields(static_cast<std::size_t>(around_));
  for (const Difference& d : seen) {
    Field& field = fields[static_cast<std::size_t>(d.theta_rad / kWholeTurn_rad * around_)];
    ++field.n, field.sum += d.mm, field.square += d.mm * d.mm;
  }
  std::vector<std::optional<double>> means;
  std::vector<double> variances;
  for (const Field& field : fields) {
    means.emplace_back();
    if (field.n < kFewestOfField) continue;
    means.back() = field.sum / field.n;
    variances.push_back((field.square / field.n - *means.back() * *means.back()) / (field.n - 1));
  }
  if (const auto around = closed_around(means)) {
    error.around = *around;
    error.around_noise = std::sqrt(median(std::move(variances)));
  }
}

std::optional<AgreementError> LaserAgreement::result() const {
  std::optional<AgreementError> worst;
  const auto significance = [](const AgreementError& e) { return std::abs(e.bias) / e.bias_sd + e.rms / e.noise; };
  for (auto p = cells_.begin(); p != cells_.end(); ++p) {
    for (auto q = std::next(p); q != cells_.end(); ++q) {
      const auto error = compare(p->first, q->first);
      if (error && (!worst || significance(*error) > significance(*worst))) worst = error;
    }
  }
  return worst;
}

AgreementCause cause_of(const AgreementError& e) {
  // A shift s of the object changes r by s cos(theta): s / sqrt(2) RMS; a tilt t over -1 .. 1 by t / sqrt(3).
  const double plane = std::hypot(e.bias, e.tilt / std::sqrt(3.)), shift = e.shift / std::sqrt(2.);
  char text[120];
  if (shift > plane && shift > 0.5 * e.rms) {
    std::snprintf(text, sizeof text, "the object moved between the two turns, by about %.3f mm", e.shift);
    return {text, "check that it stands firmly, and scan again"};
  }
  if (plane >= shift && plane > 0.5 * e.rms) {
    std::snprintf(text, sizeof text, "the plane of laser %d or %d is no longer where it was calibrated", e.first,
                  e.second);
    return {text, "check the mounts of lasers and camera, then calibrate the machine again"};
  }
  if (e.rms > kMostOfSurface_mm) {
    return {"lasers that are swapped, or reflections that are taken for the line",
            "compare the lasers' cables with the calibration, dull the surface, and scan again"};
  }
  return {"gloss, light from below the surface or stray light, which each laser meets at another angle",
          "dull the surface, or scan with one laser"};
}

}  // namespace celadon
