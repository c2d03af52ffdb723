#include "acquisition/calibrate/outliers.h"

#include <algorithm>
#include <cmath>

namespace celadon::calibrate {
namespace {

// A sound corner of 10^5 is beyond the first limit once in 40 calibrations, a sound point of 10^5 beyond the second
// once in 17.
constexpr double kCornerLimit = 5.5, kPointLimit = 5.0;
/// More than this share of a view's corners or of a line's points off: the whole of it is something else.
constexpr double kLargestShareOff = 0.3;
/// A group whose root mean square residual is beyond this is off as a whole: 140 coordinates of sound corners have
/// 1 +- 0.06.
constexpr double kGroupLimit = 2.5;
constexpr std::size_t kFewestLeft = 8, kFewestPointsLeft = 5;

double median(std::vector<double>& values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Weight of a residual in units of its limit.
double geman_mcclure(double share) {
  const double root = 1 / (1 + share * share);
  return root * root;
}

class WeightSetter {
 public:
  WeightSetter(Observations& observations, Weighting weighting) : observations_(observations), weighting_(weighting) {
    std::vector<double> corners, points;
    for (const ViewObservation& view : observations.views) {
      if (!view.used) continue;
      for (const CornerObservation& corner : view.corners) corners.push_back(corner.residual.squaredNorm());
      for (const LineObservation& line : view.lines) {
        if (line.plane < 0) continue;
        for (const PointObservation& point : line.points) points.push_back(std::abs(point.residual));
      }
    }
    // Medians of a chi-square of two degrees of freedom and of a half normal.
    corner_unit_ = std::max(1.0, std::sqrt(median(corners) / 1.3863));
    point_unit_ = std::max(1.0, median(points) / 0.6745);
  }

  bool run() {
    for (ViewObservation& view : observations_.views) {
      set_view(view);
      for (LineObservation& line : view.lines) {
        if (line.plane >= 0) set_line(line, point_unit_);
      }
    }
    for (LineObservation& line : observations_.platter) {
      if (line.plane >= 0) set_line(line, point_unit_);
    }
    return changed_ || weighting_ == Weighting::soft;
  }

 private:
  /// Sets a weight and tells whether the observation is off.
  bool off(double& weight, double residual, double limit) {
    const double before = weight;
    const bool is_off = !(residual <= limit);
    weight = weighting_ == Weighting::hard ? (is_off ? 0.0 : 1.0) : geman_mcclure(residual / limit);
    changed_ = changed_ || weight != before;
    return is_off;
  }

  void use(bool& used, bool now) {
    if (weighting_ == Weighting::soft) return;
    changed_ = changed_ || used != now;
    used = now;
  }

  void set_view(ViewObservation& view) {
    if (!view.used && !view.turned()) return;
    std::size_t count_off = 0;
    double squares = 0;
    for (CornerObservation& corner : view.corners) {
      if (off(corner.weight, corner.residual.norm(), kCornerLimit * corner_unit_)) {
        ++count_off;
      } else {
        squares += 0.5 * corner.residual.squaredNorm();
      }
    }
    const std::size_t total = view.corners.size(), left = total - count_off;
    use(view.used, left >= kFewestLeft &&
                       static_cast<double>(count_off) <= kLargestShareOff * static_cast<double>(total) &&
                       std::sqrt(squares / static_cast<double>(left)) <= kGroupLimit * corner_unit_);
  }

  void set_line(LineObservation& line, double unit) {
    std::size_t count_off = 0;
    double squares = 0;
    for (PointObservation& point : line.points) {
      if (off(point.weight, std::abs(point.residual), kPointLimit * unit)) {
        ++count_off;
      } else {
        squares += point.residual * point.residual;
      }
    }
    const std::size_t total = line.points.size(), left = total - count_off;
    use(line.used, left >= kFewestPointsLeft &&
                       static_cast<double>(count_off) <= kLargestShareOff * static_cast<double>(total) &&
                       std::sqrt(squares / static_cast<double>(left)) <= kGroupLimit * unit);
  }

  Observations& observations_;
  Weighting weighting_;
  double corner_unit_ = 1, point_unit_ = 1;
  bool changed_ = false;
};

}  // namespace

bool set_weights(Observations& observations, Weighting weighting) {
  return WeightSetter(observations, weighting).run();
}

}  // namespace celadon::calibrate
