#pragma once
// Curves r(theta) through points of a plane, as exact NURBS curves. Source: thesis chapter 2; README.md, "Curves".

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "fitting/range_fit.h"

namespace celadon {

/// Derivatives of C up to second order at one parameter (right-sided at knots unless at the end).
struct CurveDerivatives {
  Eigen::Vector2d C, C_v, C_vv;
};

/// A rational B-spline curve of the plane.
struct NurbsCurve {
  int degree = 2;
  std::vector<double> knots;        ///< clamped, over [0, arcs]
  Eigen::Matrix3Xd control_points;  ///< homogeneous: (w x, w y, w), millimetres
  bool closed = true;               ///< first and last control point coincide

  Eigen::Vector2d evaluate(double v) const;
  CurveDerivatives derivatives(double v) const;
};

struct CurveFitOptions {
  int degree = 3;                           ///< of r, 1..5, where it is not constant
  BaseArcs arcs = BaseArcs::full_circle();  ///< the whole turn, or the open range that is fitted
  double tolerance_mm = 0;                  ///< refine until the 95th percentile is below it; 0: until Cp stops falling
  std::optional<double> form_tolerance_mm{};  ///< deviation from a circle that is accepted; default 1e-9 x size
  std::optional<int> intervals_per_arc{};     ///< fixed, a power of two, instead of the data's choice
  bool robust = true, smoothing = true;
};

struct CurveFit {
  NurbsCurve curve;              ///< degree 2 of a circle or an arc, degree + 2 else
  bool circle = false;           ///< r is constant
  Eigen::VectorXd coefficients;  ///< of r(v), (2.9)
  std::vector<double> knots;     ///< of r(v); empty if it is constant
  int points = 0, rejected = 0;
  double noise_mm = 0;
  ErrorSummary radial_mm, perpendicular_mm;
  std::string decided_by;  ///< circle or not
  std::vector<std::string> warnings;
};

/// The curve about the origin that is single-valued there: r(theta) from points in any order, C2 in theta for degree 3
/// and up, times the exact circle (2.3), (2.12). It is the section of the cylinder over it, and fitted as that is:
/// knots, smoothing, outliers and the choice between a circle and a general curve follow the same rules.
/// @param points 2 x N, millimetres
/// Errors: no or too few points, points at the origin, an angular range without points: one sentence with the remedy.
tl::expected<CurveFit, FitError> fit_curve(const Eigen::Matrix2Xd& points, const CurveFitOptions& options = {});

}  // namespace celadon
