#include "daemon/files/chord_bound.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace celadon {
namespace {

constexpr int least_pieces_up = 32;
constexpr int least_pieces_around = 64;

/// A piece of a knot interval: its ends, the index of its knot span, and the Bezier coefficients on it as combinations
/// of the active B-spline coefficients.
struct Piece {
  double from, to;
  int span;
  bool kink_before;
  Eigen::MatrixXd bezier;
};

/// The polar form of a spline's piece at `arguments` (as many as the degree) as weights of the active coefficients.
Eigen::VectorXd polar_form(const std::vector<double>& knots, int degree, int span,
                           const std::vector<double>& arguments) {
  Eigen::MatrixXd d = Eigen::MatrixXd::Identity(degree + 1, degree + 1);
  for (int level = 1; level <= degree; ++level) {
    const double t = arguments[static_cast<std::size_t>(level - 1)];
    for (int k = degree; k >= level; --k) {
      const double left = knots[static_cast<std::size_t>(span - degree + k)];
      const double right = knots[static_cast<std::size_t>(span + 1 + k - level)];
      const double a = (t - left) / (right - left);
      d.row(k) = (1 - a) * d.row(k - 1) + a * d.row(k);
    }
  }
  return d.row(degree);
}

/// Knot intervals, cut further until there are `least` pieces: hulls of long polynomial pieces are loose.
std::vector<Piece> pieces_of(const std::vector<double>& knots, int degree, int least) {
  std::vector<Piece> pieces;
  int intervals = 0;
  for (std::size_t i = 0; i + 1 < knots.size(); ++i) {
    intervals += knots[i] < knots[i + 1] ? 1 : 0;
  }
  const int cuts = degree == 0 || intervals == 0 ? 1 : (least + intervals - 1) / intervals;
  for (std::size_t i = 0; i + 1 < knots.size(); ++i) {
    if (!(knots[i] < knots[i + 1])) {
      continue;
    }
    const auto multiplicity = static_cast<int>(std::count(knots.begin(), knots.end(), knots[i]));
    for (int cut = 0; cut < cuts; ++cut) {
      Piece piece;
      const double width = knots[i + 1] - knots[i];
      piece.from = knots[i] + width * cut / cuts;
      piece.to = cut + 1 == cuts ? knots[i + 1] : knots[i] + width * (cut + 1) / cuts;
      piece.span = static_cast<int>(i);
      piece.kink_before = cut == 0 && degree - multiplicity < 1;
      piece.bezier.resize(degree + 1, degree + 1);
      for (int k = 0; k <= degree; ++k) {
        std::vector<double> arguments(static_cast<std::size_t>(degree - k), piece.from);
        arguments.insert(arguments.end(), static_cast<std::size_t>(k), piece.to);
        piece.bezier.row(k) = polar_form(knots, degree, piece.span, arguments);
      }
      pieces.push_back(std::move(piece));
    }
  }
  return pieces;
}

/// Bezier coefficients of the derivative; rows along the direction, on an interval of the given width.
Eigen::MatrixXd differentiated(const Eigen::MatrixXd& bezier, int order, double width) {
  Eigen::MatrixXd d = bezier;
  for (int level = 0; level < order; ++level) {
    const Eigen::Index p = d.rows() - 1;
    if (p == 0) {
      return Eigen::MatrixXd::Zero(1, bezier.cols());
    }
    d = (static_cast<double>(p) / width * (d.bottomRows(p) - d.topRows(p))).eval();
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
  r_theta = std::max(r_theta, other.r_theta);
  r_theta_theta = std::max(r_theta_theta, other.r_theta_theta);
}

BoundTable::BoundTable(const RangeFunction& range) {
  const BaseSurface& base = range.base();
  const double height = base.band_end - base.band_start;
  const int p = range.degree_u();
  const int q = range.degree_v();
  const auto u_pieces = pieces_of(range.knots_u(), p, least_pieces_up);
  const auto v_pieces = pieces_of(range.knots_v(), q, least_pieces_around);
  z_.push_back(base.band_start);
  for (const Piece& u : u_pieces) {
    z_.push_back(base.band_start + u.to * height);
    z_kink_.push_back(u.kink_before);
  }
  z_.back() = base.band_end;
  theta_.push_back(base.arcs.theta_of_v(v_pieces.front().from));
  for (const Piece& v : v_pieces) {
    theta_.push_back(base.arcs.theta_of_v(v.to));
    theta_kink_.push_back(v.kink_before);
  }

  for (const Piece& u : u_pieces) {
    for (const Piece& v : v_pieces) {
      const Eigen::MatrixXd bezier =
          u.bezier * range.coefficients().block(u.span - p, v.span - q, p + 1, q + 1) * v.bezier.transpose();
      const auto derivative = [&](int order_u, int order_v) -> Eigen::MatrixXd {
        const Eigen::MatrixXd along_u = differentiated(bezier, order_u, u.to - u.from);
        return differentiated(along_u.transpose(), order_v, v.to - v.from);
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
      bounds.r_max = largest(bezier);
      bounds.bend =
          bend_bound(f_vv.minCoeff(), f_vv.maxCoeff(), f_v, v1_min, v1_max, v2, bezier.minCoeff(), bezier.maxCoeff());
      bounds.r_theta = f_v * v1_max;
      bounds.r_theta_theta = bend_bound(f_vv.minCoeff(), f_vv.maxCoeff(), f_v, v1_min, v1_max, v2, 0, 0);
      bounds.slope_max = f_v * v1_max / std::max(bezier.minCoeff(), 1e-3 * bounds.r_max);
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

HeightBounds height_bounds(const BaseSurface& base) {
  if (!base.heights) {
    return {};
  }
  const BoundTable table(*base.heights);
  RangeBounds all;
  for (std::size_t i = 0; i + 1 < table.z_mm().size(); ++i) {
    for (std::size_t j = 0; j + 1 < table.theta_rad().size(); ++j) {
      all.widen(table.at(i, j));
    }
  }
  return {all.r_theta, all.r_theta_theta, all.r_theta_z};
}

double height_bound_mm(const HeightBounds& heights, const CellCorners& corners, double h_theta_rad, double h_along_mm) {
  // A triangle's point is a mean of its corners; so is its coordinate along, and its angle nearly: off by the
  // covariance of weights r and angles, and by what a chord's angle differs from its share.
  const auto [least, most] = std::minmax({corners.r00, corners.r10, corners.r01, corners.r11});
  const double angle = h_theta_rad * (most - least) / (4 * least) + h_theta_rad * h_theta_rad * h_theta_rad / 12;
  // Linear interpolation: half the second derivatives times the variances within the cell.
  return heights.theta * angle +
         (heights.theta_theta * h_theta_rad * h_theta_rad + 2 * heights.theta_along * h_theta_rad * h_along_mm) / 8;
}

}  // namespace celadon
