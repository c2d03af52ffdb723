#pragma once
// One-dimensional spaces of range functions: splines over breaks with an extraction matrix E from their free
// coefficients to clamped B-spline coefficients. Everything that constrains a space (periodicity, curvature continuity
// across the arc joints, later poles and constraints) is in E. Source: README.md, "Range space"; thesis (2.9).

#include <Eigen/SparseCore>
#include <span>
#include <vector>

#include "fitting/base_arcs.h"

namespace celadon {

/// How spaces over arcs pass their joints.
enum class JointContinuity {
  curvature,  ///< r(theta) is C2 across every joint (degrees 3 and up)
  thesis      ///< simple knots: C(q-1) in v, hence only C1 in theta at the joints
};

class RangeSpace {
 public:
  /// Constants over [breaks.front(), breaks.back()]: one free function, degree 0, one interval per break interval.
  static RangeSpace constant(std::vector<double> breaks);
  /// Clamped splines of the given degree with simple interior knots at the breaks. @pre degree 1..5, breaks ascending
  static RangeSpace open(int degree, std::vector<double> breaks);
  /// Splines over base arcs, uniform `intervals_per_arc` in v on each: closed around the full circle and over periodic
  /// sectors, clamped at the ends of an open range, with r'(theta) = 0 there if these are mirrored (degree 2 and up).
  /// Degrees 1 and 2, and JointContinuity::thesis, have simple knots; otherwise multiplicity degree - 1 at each joint
  /// and the condition F''(v+) - F''(v-) = 4(1 - w) F'(v). @pre degree 1..5
  static RangeSpace over(int degree, const BaseArcs& arcs, int intervals_per_arc,
                         JointContinuity continuity = JointContinuity::curvature);
  /// The same over any breaks: ascending from 0 to arcs.count(), or between two parameters of open arcs, every joint
  /// between them among them.
  static RangeSpace over(int degree, const BaseArcs& arcs, std::vector<double> breaks, JointContinuity continuity);

  int degree() const { return degree_; }
  bool periodic() const { return periodic_; }
  /// Distinct knots; intervals() + 1 of them.
  const std::vector<double>& breaks() const { return breaks_; }
  int intervals() const { return static_cast<int>(breaks_.size()) - 1; }
  /// Number of free functions, ordered along the parameter (cyclically when periodic).
  int free_count() const { return static_cast<int>(extraction_.cols()); }
  /// Clamped knot vector of the B-spline form.
  const std::vector<double>& knots() const { return knots_; }
  /// E: B-spline coefficients = E * free coefficients. Rows sum to 1.
  const Eigen::SparseMatrix<double>& extraction() const { return extraction_; }

  /// The functions that do not vanish on an interval: degree() + 1 indices of free functions (fewer only if the space
  /// has fewer), ascending along the parameter, cyclically.
  std::span<const int> active(int interval) const;
  /// Power-basis coefficients on an interval of its a-th active function, in the local coordinate s in [-1, 1]
  /// (s = 2 (t - lo)/(hi - lo) - 1): degree() + 1 numbers, constant first.
  std::span<const double> polynomial(int interval, int a) const;

 private:
  RangeSpace() = default;
  void extract_simple_periodic();
  void extract_curvature_continuous(const BaseArcs& arcs);
  void level_at_ends();
  void tabulate();
  int degree_ = 0;
  bool periodic_ = false;
  std::vector<double> breaks_, knots_;
  Eigen::SparseMatrix<double> extraction_;
  std::vector<int> active_first_;  // prefix sums into active_
  std::vector<int> active_;
  std::vector<double> polynomial_;  // (degree + 1) per active function, interval by interval
};

}  // namespace celadon
