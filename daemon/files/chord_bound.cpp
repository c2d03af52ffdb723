#include "daemon/files/chord_bound.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace celadon {
namespace {

/// A knot interval of one direction and the index of its knot span.
struct Interval {
  double from, to;
  int span;
};

std::vector<Interval> intervals_of(const std::vector<double>& knots) {
  std::vector<Interval> intervals;
  for (std::size_t i = 0; i + 1 < knots.size(); ++i) {
    if (knots[i] < knots[i + 1]) {
      intervals.push_back({knots[i], knots[i + 1], static_cast<int>(i)});
    }
  }
  return intervals;
}

/// Less than C1 at the border after each interval but the last.
std::vector<bool> kinks_of(const std::vector<double>& knots, const std::vector<Interval>& intervals, int degree) {
  std::vector<bool> kinks;
  for (std::size_t i = 0; i + 1 < intervals.size(); ++i) {
    const auto multiplicity = std::count(knots.begin(), knots.end(), intervals[i].to);
    kinks.push_back(degree - multiplicity < 1);
  }
  return kinks;
}

/// The coefficients active on a knot span, differentiated; row index along the direction.
Eigen::MatrixXd differentiated(const Eigen::MatrixXd& active, const std::vector<double>& knots, int degree, int order,
                               int span) {
  Eigen::MatrixXd d = active;
  for (int level = 0; level < order; ++level) {
    const int p = degree - level;
    if (p <= 0) {
      return Eigen::MatrixXd::Zero(1, active.cols());
    }
    Eigen::MatrixXd next(p, d.cols());
    for (int i = 0; i < p; ++i) {
      const auto left = static_cast<std::size_t>(span - p + 1 + i);
      const auto right = static_cast<std::size_t>(span + 1 + i);
      next.row(i) = p * (d.row(i + 1) - d.row(i)) / (knots[right] - knots[left]);
    }
    d = std::move(next);
  }
  return d;
}

/// max |r_thetatheta - r| over intervals of all that enters it.
double bend_bound(double vv_min, double vv_max, double f_v, double v1_min, double v1_max, double v2, double r_min,
                  double r_max) {
  // F_vv v'^2 + F_v v'' - F
  const double high = (vv_max > 0 ? vv_max * v1_max * v1_max : vv_max * v1_min * v1_min) + f_v * v2 - r_min;
  const double low = (vv_min < 0 ? vv_min * v1_max * v1_max : vv_min * v1_min * v1_min) - f_v * v2 - r_max;
  return std::max(std::abs(high), std::abs(low));
}

}  // namespace

void RangeBounds::widen(const RangeBounds& other) {
  r_max = std::max(r_max, other.r_max);
  bend = std::max(bend, other.bend);
  slope_max = std::max(slope_max, other.slope_max);
  r_z = std::max(r_z, other.r_z);
  r_theta_z = std::max(r_theta_z, other.r_theta_z);
  r_zz = std::max(r_zz, other.r_zz);
}

BoundTable::BoundTable(const RangeFunction& range) {
  const BaseCylinder& base = range.base();
  const double height = base.z_end_mm - base.z_start_mm;
  const int p = range.degree_u();
  const int q = range.degree_v();
  const auto u_intervals = intervals_of(range.knots_u());
  const auto v_intervals = intervals_of(range.knots_v());
  z_.push_back(base.z_start_mm);
  for (const Interval& u : u_intervals) {
    z_.push_back(base.z_start_mm + u.to * height);
  }
  z_.back() = base.z_end_mm;
  theta_.push_back(base.arcs.theta_of_v(v_intervals.front().from));
  for (const Interval& v : v_intervals) {
    theta_.push_back(base.arcs.theta_of_v(v.to));
  }
  z_kink_ = kinks_of(range.knots_u(), u_intervals, p);
  theta_kink_ = kinks_of(range.knots_v(), v_intervals, q);

  for (const Interval& u : u_intervals) {
    for (const Interval& v : v_intervals) {
      const Eigen::MatrixXd active = range.coefficients().block(u.span - p, v.span - q, p + 1, q + 1);
      const auto derivative = [&](int order_u, int order_v) -> Eigen::MatrixXd {
        const Eigen::MatrixXd along_u = differentiated(active, range.knots_u(), p, order_u, u.span);
        return differentiated(along_u.transpose(), range.knots_v(), q, order_v, v.span);
      };
      const auto largest = [](const Eigen::MatrixXd& net) { return net.cwiseAbs().maxCoeff(); };
      // v' falls towards the middle of an arc and rises again, |v''| is largest at the ends (README.md, "Meshes"): both
      // take their extremes on an interval at its ends, but for the least v' of one that holds the middle.
      double v1_min = std::numeric_limits<double>::infinity();
      double v1_max = 0;
      double v2 = 0;
      const int arc = std::min(static_cast<int>(v.from), base.arcs.count() - 1);
      for (const double place : {v.from, v.to, std::clamp(arc + 0.5, v.from, v.to)}) {
        double theta_v = 0;
        double theta_vv = 0;
        base.arcs.theta_derivatives(place, theta_v, theta_vv);
        v1_min = std::min(v1_min, 1 / theta_v);
        v1_max = std::max(v1_max, 1 / theta_v);
        v2 = std::max(v2, std::abs(theta_vv) / (theta_v * theta_v * theta_v));
      }
      // An interval over several arcs (a function constant in v) holds all of what an arc holds.
      if (v.to > arc + 1 + 1e-12) {
        for (const double place : {static_cast<double>(arc), arc + 0.5}) {
          double theta_v = 0;
          double theta_vv = 0;
          base.arcs.theta_derivatives(place, theta_v, theta_vv);
          v1_min = std::min(v1_min, 1 / theta_v);
          v1_max = std::max(v1_max, 1 / theta_v);
          v2 = std::max(v2, std::abs(theta_vv) / (theta_v * theta_v * theta_v));
        }
      }
      const double f_v = largest(derivative(0, 1));
      const Eigen::MatrixXd f_vv = derivative(0, 2);
      RangeBounds bounds;
      bounds.r_max = largest(active);
      bounds.bend =
          bend_bound(f_vv.minCoeff(), f_vv.maxCoeff(), f_v, v1_min, v1_max, v2, active.minCoeff(), active.maxCoeff());
      bounds.slope_max = f_v * v1_max / std::max(active.minCoeff(), 1e-3 * bounds.r_max);
      bounds.r_z = largest(derivative(1, 0)) / height;
      bounds.r_theta_z = largest(derivative(1, 1)) * v1_max / height;
      bounds.r_zz = largest(derivative(2, 0)) / (height * height);
      bounds_.push_back(bounds);
    }
  }
}

double chord_bound_mm(const RangeBounds& bounds, const CellCorners& corners, double h_theta_rad, double h_z_mm) {
  const double sine = std::sin(h_theta_rad);
  const double cotangent = std::cos(h_theta_rad) / sine;
  double worst = 0;
  // The lower triangle has its level edge at z0 and its upright one at theta1, the upper one the other way round.
  for (const bool lower : {true, false}) {
    const double a = lower ? corners.r00 : corners.r01;
    const double b = lower ? corners.r10 : corners.r11;
    if (!(a > 0) || !(b > 0)) {
      return std::numeric_limits<double>::infinity();
    }
    // rho_theta / rho of the triangle's plane is the tangent of an angle that grows over the cell.
    const double tangent = std::max(std::abs(cotangent - a / (b * sine)), std::abs(cotangent - b / (a * sine)));
    const double rise = lower ? corners.r11 - corners.r10 : corners.r01 - corners.r00;
    const double slope = std::abs(rise) / h_z_mm * std::sqrt(1 + tangent * tangent);
    const double level = h_theta_rad * h_theta_rad / 8;
    const double share = 1 - level * (1 + 2 * tangent * tangent);
    if (share < 0.25) {
      return std::numeric_limits<double>::infinity();
    }
    const double bound = level * (bounds.bend + 2 * tangent * tangent * bounds.r_max) +
                         h_z_mm * h_z_mm / 8 * bounds.r_zz +
                         h_theta_rad * h_z_mm * (bounds.r_theta_z + slope * tangent);
    worst = std::max(worst, bound / share);
  }
  return worst;
}

}  // namespace celadon
